use std::sync::atomic::{AtomicUsize, Ordering};

use spharm_monitor::{Monitor, Silent};

use super::*;
use crate::procrustes::{Procrustes, procrustes, procrustes_with};
use crate::samples::{blob, posed, some_pose};

/// A monitor that interrupts the work after a given number of steps.
struct Until {
    left: AtomicUsize,
}

impl Monitor for Until {
    fn step(&self, steps: u64) {
        let _ = self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| {
            Some(left.saturating_sub(usize::try_from(steps).unwrap_or(usize::MAX)))
        });
    }

    fn cancelled(&self) -> bool {
        self.left.load(Ordering::Relaxed) == 0
    }
}

fn members() -> Vec<Coefficients> {
    let perturbed = |n: usize| {
        let mut values = blob(5, 2).values().clone();
        values.iter_mut().enumerate().for_each(|(k, v)| *v += 0.05 * ((k * (n + 3)) as f64 * 0.91).sin());
        posed(&Coefficients::new(values).unwrap(), &some_pose(n))
    };
    (0..5).map(perturbed).collect()
}

fn run(path: &Path, monitor: &dyn Monitor) -> Result<(Procrustes, usize), ShapeError> {
    let (members, params) = (members(), ProcrustesParams::default());
    let mut journal = Journal::open(path, &members, &params)?;
    let found = journal.found();
    Ok((procrustes_with(&members, &params, Some(&mut journal), monitor)?, found))
}

#[test]
fn a_run_that_is_ended_anywhere_goes_on_to_the_same_bits() {
    let expected = procrustes(&members(), &ProcrustesParams::default(), &Silent).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let whole = folder.path().join("whole");
    assert_eq!(run(&whole, &Silent).unwrap(), (expected.clone(), 0));
    let bytes = std::fs::read(&whole).unwrap();
    let records = (bytes.len() - HEADER) / RECORD;
    assert_eq!(bytes.len(), HEADER + RECORD * records);
    // Tries files that end within the header or within a record, are damaged, or have a block that was never written.
    let path = folder.path().join("state");
    let damaged = |at: usize| {
        let mut bytes = bytes.clone();
        bytes[at] ^= 1;
        bytes
    };
    let with_gap = [&bytes[..HEADER + 7 * RECORD], &vec![0; 3 * RECORD][..], &bytes[HEADER + 10 * RECORD..]].concat();
    let ends = [
        (Vec::new(), 0),
        (bytes[..40].to_vec(), 0),
        (bytes[..HEADER].to_vec(), 0),
        (bytes[..HEADER + 5 * RECORD + 17].to_vec(), 5),
        (bytes[..bytes.len() - 1].to_vec(), records - 1),
        (damaged(HEADER + 6 * RECORD + 3), 6),
        (with_gap, 7),
    ];
    for (start, found) in ends {
        std::fs::write(&path, start).unwrap();
        assert_eq!(run(&path, &Silent).unwrap(), (expected.clone(), found));
        assert!(std::fs::read(&path).unwrap() == bytes, "the file is that of an uninterrupted run");
    }
    // The run is interrupted repeatedly, and makes progress each time.
    std::fs::remove_file(&path).unwrap();
    let (mut last, mut runs) = (0, 0);
    loop {
        match run(&path, &Until { left: AtomicUsize::new(last + 12) }) {
            Ok((found, before)) => {
                assert!(found == expected && before == last, "{before} {last}");
                break;
            }
            Err(error) => assert!(matches!(error, ShapeError::Interrupted(_)), "{error}"),
        }
        let kept = (std::fs::metadata(&path).unwrap().len() as usize - HEADER) / RECORD;
        assert!(kept > last, "{kept} {last}");
        (last, runs) = (kept, runs + 1);
    }
    assert!(runs > 3, "{runs}");
}

#[test]
fn files_of_others_are_refused_and_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("state");
    let open = |members: &[Coefficients], params: &ProcrustesParams| Journal::open(&path, members, params);
    for foreign in [&b"a model of somebody"[..], &[0; 300]] {
        std::fs::write(&path, foreign).unwrap();
        let error = open(&members(), &ProcrustesParams::default()).unwrap_err();
        assert!(matches!(error, ShapeError::OtherJournal { is_one: false, .. }), "{error}");
        assert_eq!(std::fs::read(&path).unwrap(), foreign);
    }
    std::fs::remove_file(&path).unwrap();
    run(&path, &Silent).unwrap();
    let (mut others, mut params) = (members(), ProcrustesParams::default());
    others.swap(0, 1);
    let error = open(&others, &params).unwrap_err().to_string();
    assert!(error.contains("state: expected the state of an alignment of these models"), "{error}");
    params.align.scale = true;
    assert!(matches!(open(&members(), &params), Err(ShapeError::OtherJournal { is_one: true, .. })));
    let held = open(&members(), &ProcrustesParams::default()).unwrap();
    assert!(held.found() > 0);
    let second = open(&members(), &ProcrustesParams::default());
    assert!(matches!(second, Err(ShapeError::JournalInUse { .. })), "{second:?}");
}
