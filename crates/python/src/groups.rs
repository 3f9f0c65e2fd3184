//! Groups of models: to one degree, and their mean.

use pyo3::prelude::*;
use serde_json::json;
use spharm::Kind;
use spharm::harmonics::Coefficients;
use spharm::model::made;
use spharm::shape::{CommonDegree, PosesDiffer, equal_members, mean, rmsd, to_common_degree};

use crate::errors::Failure;
use crate::models::Model;
use crate::run::run_owned;

/// A group's coefficients, to one degree.
pub(crate) struct Group {
    pub(crate) members: Vec<Coefficients>,
    pub(crate) degree: usize,
    pub(crate) warnings: Vec<String>,
}

/// The coefficients of models, each to its own degree.
pub(crate) fn coefficients(models: &[Py<Model>]) -> Vec<(Kind, Coefficients)> {
    models.iter().map(|model| &model.get().inner).map(|model| (model.kind(), model.coefficients.clone())).collect()
}

/// Takes surfaces, or signals of one channel, to `degree`, else to the lowest degree of them.
pub(crate) fn group(models: &[(Kind, Coefficients)], kind: Kind, degree: Option<usize>) -> Result<Group, Failure> {
    for (index, (found, coefficients)) in models.iter().enumerate() {
        let channels = coefficients.channels();
        let (expected, needed) = match kind {
            Kind::Surface => ("a surface of 3 channels", 3),
            Kind::Signal => ("a signal of one channel", 1),
        };
        if *found != kind || channels != needed {
            let found = if *found == Kind::Surface { "a surface" } else { "a signal" };
            let found = format!("{found} of {channels}");
            return Err(Failure::Argument(format!("models[{index}]: expected a model of {expected}, found {found}")));
        }
    }
    let members: Vec<Coefficients> = models.iter().map(|(_, model)| model.clone()).collect();
    let CommonDegree { members, degree, warning } =
        to_common_degree(&members, degree).map_err(|error| Failure::Argument(format!("degree: {error}")))?;
    let mut warnings: Vec<String> = warning.iter().map(ToString::to_string).collect();
    let poses = if kind == Kind::Surface { PosesDiffer::of(&members) } else { None };
    warnings.extend(poses.map(|poses| format!("{poses} (shape.procrustes)")));
    warnings.extend(equal_members(&members).into_iter().map(|equal| {
        let names: Vec<String> = equal.into_iter().map(|index| format!("models[{index}]")).collect();
        format!("{} are equal", names.join(", "))
    }));
    Ok(Group { members, degree, warnings })
}

/// The mean of surfaces, their distances from it, and warnings.
#[pyfunction]
#[pyo3(signature = (models, degree, *, names, threads = None))]
pub(crate) fn shape_mean(
    py: Python<'_>,
    models: Vec<Py<Model>>,
    degree: Option<usize>,
    names: Vec<String>,
    threads: Option<usize>,
) -> PyResult<(Model, Vec<f64>, Vec<String>)> {
    let models = coefficients(&models);
    let (inner, distances, warnings) = run_owned(py, threads, None, move |_| {
        if models.len() < 2 {
            return Err(Failure::Argument(format!("models: a mean is of 2 models or more, found {}", models.len())));
        }
        let group = group(&models, Kind::Surface, degree)?;
        let mean = mean(&group.members)?;
        let distances: Result<Vec<f64>, _> = group.members.iter().map(|member| rmsd(member, &mean)).collect();
        let mut model = made(mean, Kind::Surface, "shape mean");
        model.provenance.other.insert("members".to_owned(), json!(names));
        Ok((model, distances?, group.warnings))
    })?;
    Ok((Model { inner }, distances, warnings))
}
