//! Compares the subjects of a group, for quality control.

use pyo3::prelude::*;
use rayon::prelude::*;
use spharm::parametrize::volume::steps_of_labels;
use spharm::shape::{ShapeError, rmsd};
use spharm::{Model as Inner, Stage};
use spharm_cohort::check::{Checked, Facts, Measure, check, incomplete};
use spharm_monitor::OnlyCancel;

use crate::errors::Failure;
use crate::models::Model;
use crate::run::run;

/// A subject as returned to Python. The fields are: the measures; their robust z-scores, in the order of
/// [`Measure::ALL`] like the measures; the mode along which the subject is farthest from the others (counted from 1)
/// and the robust z-score there; the flags; and the severity.
type Subject = (Vec<Option<f64>>, Vec<Option<f64>>, Option<(usize, f64)>, Vec<String>, f64);

/// Compares the subjects of a group. `aligned` has the models in one pose, and their mean; `scores` has the scores of
/// each subject. Returns the subjects, and warnings about the group.
#[pyfunction]
#[pyo3(signature = (models, names, *, aligned, scores, threads = None, progress = None))]
pub(crate) fn shape_check(
    py: Python<'_>,
    models: Vec<Py<Model>>,
    names: Vec<String>,
    aligned: Option<(Vec<Py<Model>>, Py<Model>)>,
    scores: Option<Vec<Vec<f64>>>,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(Vec<Subject>, Vec<String>)> {
    let members = inner(&models);
    let aligned = aligned.as_ref().map(|(models, mean)| (inner(models), &mean.get().inner));
    run(py, threads, progress.as_ref(), |monitor| {
        let find = |index: usize| -> Result<Facts, Failure> {
            let name = &names[index];
            let of = |error: ShapeError| Failure::Member { name: name.clone(), error: Box::new(error.into()) };
            let mut facts = Facts::of(name, members[index], &OnlyCancel(monitor)).map_err(of)?;
            if let Some((aligned, mean)) = &aligned {
                facts.measures[Measure::Distance as usize] =
                    match rmsd(&aligned[index].coefficients, &mean.coefficients) {
                        Ok(distance) => Some(distance),
                        // A model whose degree differs from that of the mean has no distance from the mean.
                        Err(ShapeError::Differ { .. }) => None,
                        Err(error) => return Err(of(error)),
                    };
            }
            facts.scores = scores.as_ref().map_or(Vec::new(), |scores| scores[index].clone());
            monitor.step(1);
            Ok(facts)
        };
        monitor.begin(Stage::counted("check", "models"), members.len() as u64);
        let facts = (0..members.len()).into_par_iter().map(find).collect::<Result<Vec<Facts>, Failure>>()?;
        monitor.end();
        let steps: Vec<_> = facts.iter().filter_map(|facts| Some((facts.id.clone(), facts.steps?))).collect();
        let warnings = incomplete(&facts).into_iter().chain(steps_of_labels(&steps)).collect();
        Ok((facts.iter().zip(&check(&facts)).map(subject).collect(), warnings))
    })
}

fn inner(models: &[Py<Model>]) -> Vec<&Inner> {
    models.iter().map(|model| &model.get().inner).collect()
}

fn subject((facts, checked): (&Facts, &Checked)) -> Subject {
    let flags = checked.flags.iter().map(ToString::to_string).collect();
    (facts.measures.to_vec(), checked.z.to_vec(), checked.mode, flags, checked.severity())
}
