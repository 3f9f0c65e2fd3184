//! Tests runs through the Rust interface: events, failures and resumption.

use std::path::Path;
use std::sync::Mutex;

use spharm::generate::{Cortex, cortex, icosphere};
use spharm::io::{WriteOptions, write_mesh};
use spharm::{FitParams, Model, Silent, fit_mesh};
use spharm_cohort::rerun::IfExists;
use spharm_cohort::run::{Cohort, Event, Observer, Outcome, RunParams, preview, run};
use spharm_cohort::{Merged, Row, State};

/// An observer that records the outcomes of rows in the order of reporting: id, state, and whether the surface was
/// mapped.
#[derive(Default)]
struct Outcomes(Mutex<Vec<(String, State, bool)>>);

impl Observer for Outcomes {
    fn event(&self, event: &Event<'_>) {
        if let Event::Finished { entry, outcome, .. } = event {
            let mapped = matches!(outcome, Outcome::Done(fit) if fit.mapped.is_some());
            self.0.lock().unwrap().push((entry.id.clone(), entry.state, mapped));
        }
    }
}

impl Outcomes {
    fn take(&self) -> Vec<(String, State, bool)> {
        std::mem::take(&mut self.0.lock().unwrap())
    }
}

/// Returns three rows: two with an existing surface, and between them one whose file is missing.
fn rows(folder: &Path) -> Vec<Row> {
    let row = |(name, variant): (&str, Option<u64>)| {
        let surface = folder.join(format!("{name}.ply"));
        if let Some(variant) = variant {
            let mesh = cortex(&Cortex { subdivisions: 2, variant }).0;
            write_mesh(&surface, &mesh, &WriteOptions { double: true, ..WriteOptions::default() }).unwrap();
        }
        Row { id: name.to_owned(), surface, ..Row::default() }
    };
    [("a", Some(0)), ("gone", None), ("b", Some(1))].map(row).to_vec()
}

#[test]
fn rows_after_a_failure_are_fitted_and_a_second_run_keeps_them() {
    let folder = tempfile::tempdir().unwrap();
    let (status, outcomes) = (folder.path().join("status.tsv"), Outcomes::default());
    let cohort = Cohort::new(rows(folder.path()), folder.path());
    let mut params = RunParams::new(FitParams::lsq(4));
    params.status = Some(status.clone());
    run(&cohort, &params, &outcomes, &Silent).unwrap();
    // Rows are processed at the same time, so they finish in any order.
    let expected = [("a", State::Done, true), ("b", State::Done, true), ("gone", State::Failed, false)];
    let mut found = outcomes.take();
    found.sort();
    assert_eq!(found, expected.map(|(id, state, mapped)| (id.to_owned(), state, mapped)));
    let merged = Merged::read([&status]).unwrap();
    assert!(merged.entry("gone").unwrap().error.contains("gone.ply"));
    assert!(merged.entry("a").unwrap().msd.unwrap() > 0.0);

    params.if_exists = IfExists::Skip;
    let found = preview(&cohort, &params, &outcomes, &Silent).unwrap();
    assert_eq!((found.rows, found.exist, found.kept, found.missing), (3, 2, 2, 1));
    assert_eq!(found.failed.iter().map(|(number, _)| *number).collect::<Vec<_>>(), [1]);
    outcomes.take();
    run(&cohort, &params, &outcomes, &Silent).unwrap();
    let mut states: Vec<State> = outcomes.take().into_iter().map(|(_, state, _)| state).collect();
    states.sort();
    assert_eq!(states, [State::Skipped, State::Skipped, State::Failed]);
}

#[test]
fn a_failure_ends_a_run_that_does_not_keep_going() {
    let folder = tempfile::tempdir().unwrap();
    let (cohort, outcomes) = (Cohort::new(rows(folder.path()), folder.path()), Outcomes::default());
    let mut params = RunParams::new(FitParams::lsq(4));
    params.keep_going = false;
    let error = run(&cohort, &params, &outcomes, &Silent).unwrap_err();
    assert!(error.line().contains("gone.ply") && !error.is_interrupted() && !error.concerns_all(), "{error}");
    assert_eq!(outcomes.take().len(), 2);
    assert!(!folder.path().join("b.spharm.npz").exists());
}

/// Returns the rows over a common sphere.
fn over_sphere(folder: &Path, rows: Vec<Row>) -> Vec<Row> {
    let sphere = folder.join("sphere.ply");
    write_mesh(&sphere, &icosphere(2), &WriteOptions { double: true, ..WriteOptions::default() }).unwrap();
    rows.into_iter().map(|row| Row { sphere: Some(sphere.clone()), ..row }).collect()
}

#[test]
fn a_failure_of_all_rows_is_recorded_for_each() {
    let folder = tempfile::tempdir().unwrap();
    let (status, outcomes) = (folder.path().join("status.tsv"), Outcomes::default());
    let mut rows = over_sphere(folder.path(), rows(folder.path()));
    rows.remove(1);
    let cohort = Cohort::new(rows, folder.path());
    let mut params = RunParams::new(FitParams::irf(4, folder.path().join("no store")));
    (params.keep_going, params.status) = (false, Some(status.clone()));
    run(&cohort, &params, &outcomes, &Silent).unwrap_err();
    let merged = Merged::read([&status]).unwrap();
    for id in ["a", "b"] {
        let entry = merged.entry(id).unwrap();
        assert!(entry.state == State::Failed && entry.error.contains("no store"), "{entry:?}");
    }
    assert_eq!(outcomes.take().len(), 2);
}

#[test]
fn a_row_that_another_failure_interrupts_names_the_failure() {
    let folder = tempfile::tempdir().unwrap();
    let status = folder.path().join("status.tsv");
    let cohort = Cohort::new(over_sphere(folder.path(), rows(folder.path())), folder.path());
    let mut params = RunParams::new(FitParams::lsq(4));
    (params.keep_going, params.status) = (false, Some(status.clone()));
    run(&cohort, &params, &Outcomes::default(), &Silent).unwrap_err();
    let merged = Merged::read([&status]).unwrap();
    assert_eq!(merged.entry("gone").unwrap().state, State::Failed);
    let entry = merged.entry("a").unwrap();
    assert!(entry.state == State::Interrupted && entry.error.contains("gone.ply"), "{entry:?}");
}

#[test]
fn a_row_has_the_coefficients_of_its_surface_alone() {
    let folder = tempfile::tempdir().unwrap();
    let cohort = Cohort::new(rows(folder.path()), folder.path().join("models"));
    run(&cohort, &RunParams::new(FitParams::lsq(4)), &Outcomes::default(), &Silent).unwrap();
    let found = Model::read(folder.path().join("models/b.spharm.npz")).unwrap();
    let alone = fit_mesh(&spharm::io::read_mesh(folder.path().join("b.ply")).unwrap(), &FitParams::lsq(4)).unwrap();
    assert_eq!(found.coefficients, alone.fit.coefficients);
}

#[test]
fn an_interrupted_run_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let (cohort, stop) = (Cohort::new(rows(folder.path()), folder.path()), std::sync::atomic::AtomicBool::new(true));
    let error = run(&cohort, &RunParams::new(FitParams::lsq(4)), &Outcomes::default(), &stop).unwrap_err();
    assert!(error.is_interrupted());
}

#[test]
fn an_output_with_the_name_of_an_input_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let mut rows = rows(folder.path());
    let model = folder.path().join("a.npz");
    std::fs::rename(&rows[0].surface, &model).unwrap();
    (rows[0].surface, rows[0].output) = (model.clone(), Some(model.clone()));
    let before = std::fs::read(&model).unwrap();
    let mut params = RunParams::new(FitParams::lsq(4));
    params.if_exists = IfExists::Replace;
    run(&Cohort::new(rows, folder.path()), &params, &Outcomes::default(), &Silent).unwrap();
    assert_eq!(std::fs::read(&model).unwrap(), before);
}

/// The file that replaces an input may have a name that the user didn't give.
#[test]
fn the_file_that_would_replace_an_input_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let surface = folder.path().join("v.csv");
    std::fs::write(&surface, "1\n").unwrap();
    let row = Row { id: "v".to_owned(), surface, output: Some(folder.path().join("v.npz")), ..Row::default() };
    let mut params = RunParams::new(FitParams::lsq(4));
    (params.coefficients_csv, params.status) = (true, Some(folder.path().join("status.tsv")));
    run(&Cohort::new(vec![row], folder.path()), &params, &Outcomes::default(), &Silent).unwrap();
    let merged = Merged::read([folder.path().join("status.tsv")]).unwrap();
    let error = &merged.entry("v").unwrap().error;
    assert!(error.contains("v.csv: this file is an input, but the table of coefficients"), "{error}");
}

/// A model's path that isn't UTF-8 can't be written exactly to the table of outcomes, but the event has the exact
/// path.
#[cfg(unix)]
#[test]
fn a_model_is_found_by_a_name_that_is_no_text() {
    use std::ffi::OsStr;
    use std::os::unix::ffi::OsStrExt;

    struct Models(Mutex<Vec<std::path::PathBuf>>);
    impl Observer for Models {
        fn event(&self, event: &Event<'_>) {
            if let Event::Finished { model, .. } = event {
                self.0.lock().unwrap().push(model.to_path_buf());
            }
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let mut rows = rows(folder.path());
    rows.truncate(1);
    rows[0].output = Some(OsStr::from_bytes(b"a\xff.npz").into());
    let models = Models(Mutex::default());
    let mut params = RunParams::new(FitParams::lsq(4));
    for if_exists in [IfExists::Refuse, IfExists::Skip] {
        params.if_exists = if_exists;
        run(&Cohort::new(rows.clone(), folder.path()), &params, &models, &Silent).unwrap();
    }
    let expected = folder.path().join(OsStr::from_bytes(b"a\xff.npz"));
    assert_eq!(models.0.into_inner().unwrap(), [expected.clone(), expected.clone()]);
    assert!(Model::read(expected).is_ok());
}
