//! Warns about models in a table: models of labels that may be cut off, models with a doubtful volume, and models from
//! an earlier run.

use std::collections::HashSet;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use spharm_cli::output::{counted, first_of};
use spharm_monitor::number;

use super::table::{Outcome, Row};

/// Largest number of labels and models named in a warning.
const NAMED: usize = 3;
/// Largest relative change of a model's volume, caused by cutting handles, that gives no warning.
const CUT: f64 = 0.05;
/// Largest relative error of the volume of a model that gives no warning, if the label was neither repaired nor cut.
const INEXACT: f64 = 0.02;

/// Returns a warning about models of labels that touch the border of their volume; `None` if no label touches it.
pub(super) fn cut_off(rows: &[Row]) -> Option<String> {
    let at_border = |row: &&Row| row.border == Some(true) && matches!(row.outcome, Outcome::Model(_));
    warning_of_cut(&rows.iter().filter(at_border).map(Row::name).collect::<Vec<_>>())
}

/// Returns a warning that names the first few of the labels that may be cut off.
fn warning_of_cut(labels: &[String]) -> Option<String> {
    const REMEDY: &str = "--skip-border leaves out such labels";
    match labels {
        [] => None,
        [only] => {
            Some(format!("{only} touches the border of the volume, which may have cut off a part of it; {REMEDY}"))
        }
        labels => Some(format!(
            "{} labels touch the border of their volume, which may have cut off parts of them: {}; {REMEDY}",
            labels.len(),
            first_of(labels.iter().map(String::as_str), NAMED)
        )),
    }
}

/// Returns the warnings about models whose volume differs from the volume of their label's voxels. Other warnings
/// report the repairs of labels, and the models that resolve the steps between voxels.
pub(super) fn of_volumes(rows: &[Row]) -> Vec<String> {
    let (mut warnings, mut inexact, mut largest) = (Vec::new(), Vec::new(), 0.0_f64);
    for row in rows {
        let (Outcome::Model(model), Some(label)) = (&row.outcome, row.volume) else { continue };
        let change = model.measures.volume.abs() / label - 1.0;
        if model.cut && change.abs() > CUT {
            warnings.push(format!(
                "{}: the model has a volume of {}, but before its handles were cut, the label's surface had a volume \
                 of {} ({:+.1} %)",
                row.name(),
                number(model.measures.volume),
                number(label),
                100.0 * change
            ));
        } else if model.repair.is_empty() && model.steps.is_none() && change.abs() > INEXACT {
            inexact.push(row.name());
            largest = largest.max(change.abs());
        }
    }
    if !inexact.is_empty() {
        warnings.push(format!(
            "the volume of {} differs from that of the label's voxels by up to {:.1} % ({}): the label is too small \
             for a shape model, or the degree is too low for the label's shape; --min-voxels N leaves out small labels",
            counted(inexact.len(), "model"),
            100.0 * largest,
            first_of(inexact.iter().map(String::as_str), NAMED)
        ));
    }
    warnings
}

/// Returns a warning about models in the folder that aren't among `models`, because analyses of the folder would
/// include these models of an earlier run. Returns `None` if the folder has no such models.
pub(super) fn of_earlier_runs(folder: &Path, table: &Path, models: &HashSet<OsString>) -> Option<String> {
    const NAMED: usize = 10;
    let names = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.file_name()));
    let is_model = |name: &OsString| name.to_string_lossy().ends_with(".spharm.npz");
    let mut others: Vec<PathBuf> =
        names.filter(|name| is_model(name) && !models.contains(name)).map(PathBuf::from).collect();
    spharm_cli::paths::natural_order(&mut others);
    let others: Vec<String> = others.iter().map(|name| name.display().to_string()).collect();
    let count = others.len();
    let (them, they) = if count == 1 { ("it", "it doesn't") } else { ("them", "they don't") };
    (count > 0).then(|| {
        format!(
            "{}: {} {} not in {} ({}), perhaps from an earlier run; commands that read the folder use {them}, too: if \
             {they} belong here, delete {them}, or give another --output",
            folder.display(),
            counted(count, "model"),
            if count == 1 { "is" } else { "are" },
            table.display(),
            first_of(others.iter().map(String::as_str), NAMED)
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volumes::table::tests::fitted;

    #[test]
    fn labels_that_may_be_cut_off_are_counted_and_named() {
        let names = ["a 1", "a 2", "b 1", "b 7", "c 3"].map(str::to_owned);
        let found = |count: usize| warning_of_cut(&names[..count]).unwrap_or_default();
        assert_eq!(found(0), "");
        assert!(found(1).starts_with("a 1 touches the border") && found(1).contains("--skip-border"), "{}", found(1));
        assert!(found(3).starts_with("3 labels touch") && found(3).contains("them: a 1, a 2, b 1; "), "{}", found(3));
        assert!(found(5).contains("a 1, a 2, b 1 and 2 more; --skip-border"), "{}", found(5));
        let failed = Row { border: Some(true), outcome: Outcome::default(), ..fitted(1, None) };
        assert_eq!(cut_off(std::slice::from_ref(&failed)), None);
        let rows = [fitted(2, Some(true)), fitted(3, Some(false)), fitted(4, None), failed];
        let warning = cut_off(&rows).unwrap_or_default();
        assert!(warning.starts_with("a label 2 touches the border"), "{warning}");
    }

    #[test]
    fn volumes_far_from_those_of_the_labels_are_named() {
        let of = |label, volume: f64, cut, repair: &str| {
            let mut row = Row { volume: Some(volume), ..fitted(label, None) };
            if let Outcome::Model(model) = &mut row.outcome {
                (model.cut, model.repair) = (cut, repair.to_owned());
            }
            row
        };
        // The models have a volume of 1.
        let exact = [of(1, 1.01, false, ""), of(2, 1.04, true, "1 handle cut"), of(3, 2.0, false, "1 cavity filled")];
        assert_eq!(of_volumes(&exact), Vec::<String>::new());
        let cut = of_volumes(&[of(4, 1.25, true, "1 handle cut")]);
        assert!(cut.len() == 1 && cut[0].starts_with("a label 4: ") && cut[0].ends_with("1.250 (-20.0 %)"), "{cut:?}");
        let small = of_volumes(&[of(5, 1.25, false, ""), of(6, 0.9, false, "")]);
        assert!(small.len() == 1 && small[0].contains("of 2 models") && small[0].contains("20.0 %"), "{small:?}");
        assert!(small[0].contains("(a label 5, a label 6)"), "{small:?}");
    }
}
