//! Rotates models, and aligns surfaces.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use rayon::prelude::*;
use serde_json::{Value, json};
use spharm::harmonics::Coefficients;
use spharm::model::{made, signed};
use spharm::shape::{AlignParams, Method, ProcrustesParams, Rotation, Similarity, Transform, align, procrustes};
use spharm::{Error, Kind, Model as Inner, Monitor, Silent};

use crate::errors::{Failure, exception};
use crate::groups::axes_differ;
use crate::models::Model;
use crate::run::run_owned;

/// Keyword arguments of `spharm_rs.shape.align` and `spharm_rs.shape.procrustes`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Settings {
    method: String,
    scale: bool,
    mirror: bool,
    degree: Option<usize>,
    starts: Option<usize>,
    templates: Option<usize>,
}

impl Settings {
    fn params(&self, starts: usize) -> PyResult<AlignParams> {
        let method = match self.method.as_str() {
            "joint" => Method::Joint,
            "fixed" => Method::FixedParameters,
            "foe" => Method::FirstOrderEllipsoid,
            "surfaces" => Method::Surfaces,
            found => {
                return Err(PyValueError::new_err(format!("method: expected joint, fixed or foe; found {found}")));
            }
        };
        let (max_degree, starts) = (self.degree, self.starts.unwrap_or(starts));
        let &Self { scale, mirror, .. } = self;
        Ok(AlignParams { method, max_degree, scale, mirror, starts, ..AlignParams::default() })
    }
}

/// Returns the rotation given by 3 Euler angles in degrees, by the 4 components of a quaternion, or by the 9 elements
/// of a matrix, row by row.
fn rotation(what: &str, numbers: &[f64]) -> Result<Rotation, Failure> {
    let found = match *numbers {
        // The identity matrix gives the exact identity, so that a model stays bit-identical if no rotation is
        // requested.
        [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0] => Ok(Rotation::IDENTITY),
        [alpha, beta, gamma] => {
            let [alpha, beta, gamma] = [alpha, beta, gamma].map(f64::to_radians);
            Rotation::from_euler(alpha, beta, gamma)
        }
        [w, x, y, z] => Rotation::from_quaternion([w, x, y, z]),
        [a, b, c, d, e, f, g, h, i] => Rotation::from_matrix([[a, b, c], [d, e, f], [g, h, i]]),
        _ => return Err(Failure::Argument(format!("{what}: expected 3, 4 or 9 numbers, found {}", numbers.len()))),
    };
    found.map_err(|error| Failure::Argument(format!("{what}: {error}")))
}

/// A transformation of a model, as passed from Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Asked {
    parameters: Vec<f64>,
    /// Whether directions are replaced by their opposites.
    antipodal: bool,
    object: Vec<f64>,
    /// Whether the orthogonal matrix `object` is a reflection.
    mirrored: bool,
    scale: f64,
    translation: [f64; 3],
}

impl Asked {
    fn transform(&self) -> Result<Transform, Failure> {
        let Self { scale, translation, antipodal, .. } = *self;
        if !(scale > 0.0 && scale.is_finite()) {
            return Err(Failure::Argument(format!("scale: expected a number above zero, found {scale}")));
        }
        if let Some(found) = translation.iter().find(|value| !value.is_finite()) {
            return Err(Failure::Argument(format!("translation: expected finite numbers, found {found}")));
        }
        let sign = if self.mirrored { -1.0 } else { 1.0 };
        let object: Vec<f64> = self.object.iter().map(|value| sign * value).collect();
        let orthogonal = rotation("object", &object)?.matrix().map(|row| row.map(|value| sign * value));
        let rotation = rotation("parameters", &self.parameters)?;
        Ok(Transform { rotation, antipodal, similarity: Similarity { orthogonal, scale, translation } })
    }
}

/// Rotates a model on its sphere and in space, and scales and translates it.
#[pyfunction]
#[pyo3(signature = (model, asked, *, threads = None, progress = None))]
pub(crate) fn shape_rotate(
    py: Python<'_>,
    model: PyRef<'_, Model>,
    asked: Asked,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Model> {
    let inner = model.inner.clone();
    let inner = run_owned(py, threads, progress.as_ref(), move |monitor| {
        Ok(signed(asked.transform()?.apply_model(&inner, monitor)?, "shape rotate"))
    })?;
    Ok(Model { inner })
}

pub(crate) fn refuse_signals(what: &str, models: &[Inner]) -> Result<(), Failure> {
    match models.iter().position(|model| model.kind() != Kind::Surface) {
        Some(_) if models.len() == 1 => {
            Err(Failure::Argument(format!("{what}: expected a model of a surface, found a signal")))
        }
        Some(index) => {
            Err(Failure::Argument(format!("{what}[{index}]: expected a model of a surface, found a signal")))
        }
        None => Ok(()),
    }
}

/// Aligns a model with another model. Also returns the transform and the report, as JSON.
#[pyfunction]
#[pyo3(signature = (model, target, settings, *, threads = None, progress = None))]
pub(crate) fn shape_align(
    py: Python<'_>,
    model: PyRef<'_, Model>,
    target: PyRef<'_, Model>,
    settings: Settings,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(Model, String)> {
    let params = settings.params(AlignParams::default().starts)?;
    let (moving, target) = (model.inner.clone(), target.inner.clone());
    let (inner, report) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        refuse_signals("model", std::slice::from_ref(&moving))?;
        refuse_signals("target", std::slice::from_ref(&target))?;
        let report = align(&moving.coefficients, &target.coefficients, &params, monitor)?.report;
        let moved = report.transform.apply_model(&moving, &Silent)?;
        Ok((signed(moved, "shape align"), report))
    })?;
    let warnings: Vec<String> = report.warnings.iter().map(ToString::to_string).collect();
    let report = json!({
        "transform": report.transform.to_json(),
        "degree": report.degree,
        "rmsd_before": report.rmsd_before,
        "rmsd_after": report.rmsd_after,
        "mirrored": report.mirrored,
        "ends": report.ends,
        "surface_distance": report.surface_distance,
        "warnings": warnings,
    });
    Ok((Model { inner }, report.to_string()))
}

/// Aligns a group of models. Returns the aligned models and their mean, and, as JSON, the transforms and the report.
#[pyfunction]
#[pyo3(signature = (models, settings, *, threads = None, progress = None))]
pub(crate) fn shape_procrustes(
    py: Python<'_>,
    models: Vec<Py<Model>>,
    settings: Settings,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(Vec<Model>, Model, String)> {
    let default = ProcrustesParams::default();
    if settings.method == "foe" {
        let text = "method: expected joint or fixed for a group, found foe";
        return Err(exception(py, Failure::Argument(text.to_owned())));
    }
    let params =
        ProcrustesParams { align: settings.params(default.align.starts)?, templates: settings.templates, ..default };
    let models: Vec<Inner> = models.iter().map(|model| model.get().inner.clone()).collect();
    let axes = axes_differ(models.iter().map(|model| model.provenance.axes()));
    let (moved, found) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        refuse_signals("models", &models)?;
        let members: Vec<Coefficients> = models.iter().map(|model| model.coefficients.clone()).collect();
        let found = procrustes(&members, &params, monitor)?;
        let apply = |(model, transform): (&Inner, &Transform)| -> Result<Inner, Failure> {
            Monitor::check(monitor).map_err(Error::from)?;
            Ok(signed(transform.apply_model(model, &Silent)?, "shape align"))
        };
        // Transform all models before returning an error, so that the first error in order is returned, regardless of
        // the timing of the threads.
        let moved: Vec<Result<Inner, Failure>> = models.par_iter().zip(&found.transforms).map(apply).collect();
        Ok((moved.into_iter().collect::<Result<Vec<_>, _>>()?, found))
    })?;
    let report = &found.report;
    let end = |end: &spharm::shape::TemplateEnd| -> Value {
        json!({ "template": end.template, "spread": end.spread, "rounds": end.rounds })
    };
    let text = json!({
        "transforms": found.transforms.iter().map(Transform::to_json).collect::<Vec<_>>(),
        "degree": report.degree,
        "spread_before": report.spread_before,
        "spread_after": report.spread_after,
        "rmsd": report.rmsd,
        "templates": report.ends.iter().map(end).collect::<Vec<_>>(),
        "warnings": report.warnings.iter().map(ToString::to_string).chain(axes).collect::<Vec<_>>(),
    });
    let moved = moved.into_iter().map(|inner| Model { inner }).collect();
    let mean = Model { inner: made(found.mean, Kind::Surface, "shape align") };
    Ok((moved, mean, text.to_string()))
}
