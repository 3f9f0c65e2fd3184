//! Fuzzes the reader of the journal of a group's alignment.

use std::fs;
use std::path::Path;

use ndarray::Array2;
use spharm_harmonics::Coefficients;
use spharm_monitor::Silent;
use spharm_shape::procrustes::{Journal, ProcrustesParams, procrustes_with};

use super::{choice, file, mend};

/// Number of bytes of a record, including its check sum.
const RECORD: usize = 196;

/// Number of kinds of inputs. Only the journals of the last two kinds are used for an alignment, because an alignment
/// takes ten milliseconds and reading takes microseconds.
const KINDS: usize = 64;

/// The input is a complete file, or only the numbers of its records, to which a valid header and check sums are added.
/// Such records hold poses that no alignment has computed. An alignment that resumes from them must still end.
pub(super) fn journals(folder: &Path, input: &[u8]) {
    let Some((kind, bytes)) = choice(input, KINDS) else { return };
    let (members, params) = (members(), ProcrustesParams::default());
    let path = folder.join("group.journal");
    let _ = fs::remove_file(&path);
    let bytes = if kind.is_multiple_of(2) {
        bytes.to_vec()
    } else {
        drop(Journal::open(&path, &members, &params).expect("a new file"));
        mend::journal(&fs::read(&path).expect("its start"), bytes)
    };
    let path = file(folder, "group.journal", &bytes);
    let Ok(mut journal) = Journal::open(&path, &members, &params) else {
        assert_eq!(fs::read(&path).expect("the file"), bytes, "what is no file of this group is left alone");
        return;
    };
    assert!(journal.found() <= bytes.len() / RECORD, "poses are in the file");
    if kind < KINDS - 2 {
        return;
    }
    if let Ok(found) = procrustes_with(&members, &params, Some(&mut journal), &Silent) {
        assert!(found.mean.values().iter().all(|x| x.is_finite()), "the mean is finite");
    }
}

/// Ellipsoids of degree 1, each a little different.
fn members() -> Vec<Coefficients> {
    let member = |number: usize| {
        let mut values = Array2::zeros((4, 3));
        for (row, column, length) in [(3, 0, 3.0), (1, 1, 2.0), (2, 2, 1.0)] {
            values[[row, column]] = length + 0.1 * number as f64;
        }
        Coefficients::new(values).expect("finite coefficients")
    };
    (0..3).map(member).collect()
}
