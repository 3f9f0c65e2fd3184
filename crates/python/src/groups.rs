//! Brings groups of models to a common degree, and computes their mean.

use pyo3::prelude::*;
use serde_json::json;
use spharm::harmonics::Coefficients;
use spharm::model::made;
use spharm::shape::places::one_key;
use spharm::shape::{
    CommonDegree, PosesDiffer, Smoothing, SmoothingDiffers, equal_members, mean, other_units, places_differ, rmsd,
    to_common_degree,
};
use spharm::{Kind, Monitor};
use spharm_surface::AxesDiffer;
use spharm_surface::io::landmarks::Frame;

use crate::errors::Failure;
use crate::models::Model;
use crate::run::run_owned;

/// The coefficients of a group's models, all of the same degree.
pub(crate) struct Group {
    pub(crate) members: Vec<Coefficients>,
    pub(crate) degree: usize,
    pub(crate) warnings: Vec<String>,
}

/// Kind and coefficients of a model, the key of its sphere's sampling scheme, its smoothing, and the axes that the
/// surface's file stated.
pub(crate) type Given = (Kind, Coefficients, Option<String>, Smoothing, Option<Frame>);

/// Returns kind, coefficients, scheme key, smoothing and axes of each model. The models may have different degrees.
pub(crate) fn coefficients(models: &[Py<Model>]) -> Vec<Given> {
    let given = |model: &spharm::Model| {
        let smoothing = Smoothing::of(&model.provenance);
        (model.kind(), model.coefficients.clone(), model.scheme_key.clone(), smoothing, model.provenance.axes())
    };
    models.iter().map(|model| given(&model.get().inner)).collect()
}

/// Returns a warning if the files of a group's surfaces stated different axes. `stated` has the axes of each model.
pub(crate) fn axes_differ(stated: impl Iterator<Item = Option<Frame>>) -> Option<String> {
    AxesDiffer::of(&stated.collect::<Vec<_>>()).map(|axes| axes.with_names(|index| format!("models[{index}]")))
}

/// Truncates or pads the coefficients of surfaces, or of signals with one channel, to `degree`. By default, `degree` is
/// the lowest degree of the models.
pub(crate) fn group(
    models: &[Given],
    kind: Kind,
    degree: Option<usize>,
    monitor: &dyn Monitor,
) -> Result<Group, Failure> {
    for (index, (found, coefficients, ..)) in models.iter().enumerate() {
        let channels = coefficients.channels();
        let (expected, needed) = match kind {
            Kind::Surface => ("a surface with 3 channels", 3),
            Kind::Signal => ("a signal with one channel", 1),
        };
        if *found != kind || channels != needed {
            let found = if *found == Kind::Surface { "a surface" } else { "a signal" };
            let found = format!("{found} of {channels}");
            return Err(Failure::Argument(format!("models[{index}]: expected a model of {expected}, found {found}")));
        }
    }
    let members: Vec<Coefficients> = models.iter().map(|(_, model, ..)| model.clone()).collect();
    let CommonDegree { members, degree, warning } =
        to_common_degree(&members, degree).map_err(|error| Failure::Argument(format!("degree: {error}")))?;
    let mut warnings: Vec<String> = warning.iter().map(ToString::to_string).collect();
    let smoothing: Vec<Smoothing> = models.iter().map(|(_, _, _, smoothing, _)| *smoothing).collect();
    let smoothing = SmoothingDiffers::of(&smoothing);
    warnings.extend(smoothing.map(|differs| differs.with_names(|index| format!("models[{index}]"))));
    if kind == Kind::Surface {
        let units = other_units(&members);
        warnings.extend(units.iter().map(|of| format!("models[{}]: {}", of.member, of.of_member())));
        warnings.extend(axes_differ(models.iter().map(|(.., axes)| *axes)));
    }
    let poses = if kind == Kind::Surface { PosesDiffer::of(&members) } else { None };
    // If the poses differ, skip the check that the models' parameters correspond, since they never do in different
    // poses.
    if kind == Kind::Surface && poses.is_none() && !one_key(models.iter().map(|(_, _, key, ..)| key.as_deref())) {
        warnings.extend(places_differ(&members, monitor)?.map(|places| places.to_string()));
    }
    warnings.extend(poses.map(|poses| format!("{poses} (shape.procrustes)")));
    warnings.extend(equal_members(&members).into_iter().map(|equal| {
        let names: Vec<String> = equal.into_iter().map(|index| format!("models[{index}]")).collect();
        format!("{} are equal", names.join(", "))
    }));
    Ok(Group { members, degree, warnings })
}

/// Returns the mean of surfaces, the distance of each surface from the mean, and warnings.
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
    let (inner, distances, warnings) = run_owned(py, threads, None, move |monitor| {
        if models.len() < 2 {
            return Err(Failure::Argument(format!("models: expected at least 2 for a mean, found {}", models.len())));
        }
        let group = group(&models, Kind::Surface, degree, monitor)?;
        let mean = mean(&group.members)?;
        let distances: Result<Vec<f64>, _> = group.members.iter().map(|member| rmsd(member, &mean)).collect();
        let mut model = made(mean, Kind::Surface, "shape mean");
        model.provenance.other.insert("members".to_owned(), json!(names));
        Ok((model, distances?, group.warnings))
    })?;
    Ok((Model { inner }, distances, warnings))
}
