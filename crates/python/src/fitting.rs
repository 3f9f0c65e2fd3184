//! Fits one target, or many targets over the same sphere.

use std::path::PathBuf;
use std::str::FromStr;
use std::sync::OnceLock;

use ndarray::ArrayView2;
use numpy::{IntoPyArray, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde_json::{Value, json};
use spharm::parametrize::Input;
use spharm::solver::lsq::LsqWarning;
use spharm::{
    BatchReport, Fit, FitParams, FitReport, FitWarning, Kind, ManyReport, Mesh, MeshFit, Model as Inner, Monitor,
    Objective, Smoothness, Sphere, Target, Weights,
};

use crate::arrays::{Faces, Positions, SeamIn, SphereArrays, mesh};
use crate::errors::Failure;
use crate::metadata::{Metadata, with_metadata};
use crate::methods::{Streamed, method};
use crate::models::Model;
use crate::repairs::{Changes, map_report};
use crate::run::run;
use crate::stores::scalar;
use crate::targets::{doubts, doubts_of_mask, masked, refuse_doubtful, target};
use crate::transforms::Transform;

/// Keyword arguments of `spharm_rs.fit`. Their types are checked in Python.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Settings<'py> {
    max_degree: usize,
    method: String,
    passes: usize,
    granularity: usize,
    start_degree: usize,
    accelerate: bool,
    objective: Option<String>,
    surface_distance: bool,
    smoothness: Option<String>,
    denoise: bool,
    weights: WeightsGiven<'py>,
    mask: Option<PyReadonlyArray1<'py, bool>>,
    /// Path of the mask's file, whose name may indicate the hemisphere.
    mask_path: Option<PathBuf>,
    hold_out: Option<f64>,
    standard_errors: bool,
    tolerance: f64,
    max_iterations: usize,
    preconditioner: String,
    strict: bool,
    store: Option<PathBuf>,
    dtype: Option<String>,
    memory: Option<usize>,
    pub(crate) threads: Option<usize>,
}

#[derive(FromPyObject)]
enum WeightsGiven<'py> {
    Named(String),
    Values(PyReadonlyArray1<'py, f64>),
}

pub(crate) fn parsed<T: FromStr<Err = String>>(what: &str, text: &str) -> PyResult<T> {
    text.parse().map_err(|expected| PyValueError::new_err(format!("{what}: {expected}; found {text}")))
}

impl Settings<'_> {
    /// Returns the mask of the vertices to read; `None` if no mask was given.
    pub(crate) fn mask(&self) -> Option<Vec<bool>> {
        self.mask.as_ref().map(|mask| mask.as_array().to_vec())
    }

    /// Converts the keyword arguments to the library's settings, except for the mask, which needs the sphere.
    ///
    /// # Errors
    ///
    /// `ValueError` if the value of a setting is an unknown name, or if the method doesn't have the setting.
    pub(crate) fn params(&self) -> PyResult<FitParams> {
        let &Self { passes, granularity, start_degree, accelerate, .. } = self;
        let method = method(&self.method, Streamed { passes, granularity, start_degree, accelerate })?;
        let weights = match &self.weights {
            WeightsGiven::Named(name) if name == "uniform" => Weights::Uniform,
            WeightsGiven::Named(name) if name == "area" => Weights::Area,
            WeightsGiven::Named(found) => {
                return Err(PyValueError::new_err(format!(
                    "weights: expected uniform, area or an array; found {found}"
                )));
            }
            WeightsGiven::Values(values) => {
                Weights::Values { name: "weights".to_owned(), values: values.as_array().to_vec() }
            }
        };
        let objective = self.objective.as_deref().map_or(Ok(Objective::Default), |text| parsed("objective", text))?;
        let smoothness =
            self.smoothness.as_deref().map_or(Ok(Smoothness::Default), |text| parsed("smoothness", text))?;
        Ok(FitParams::lsq(self.max_degree)
            .with_method(method)
            .with_objective(objective)
            .with_surface_distance(self.surface_distance)
            .with_weights(weights)
            .with_smoothness(smoothness)
            .with_denoise(self.denoise)
            .with_hold_out(self.hold_out)
            .with_standard_errors(self.standard_errors)
            .with_tolerance(self.tolerance)
            .with_max_iterations(self.max_iterations)
            .with_preconditioner(parsed("preconditioner", &self.preconditioner)?)
            .with_strict(self.strict)
            .with_store(self.store.clone())
            .with_scalar(self.dtype.as_deref().map(scalar).transpose()?)
            .with_memory(self.memory))
    }
}

/// A fit as returned to Python: model, standard errors, report as JSON, and warnings as pairs of class and text.
pub(crate) type Fitted<'py> = (Model, Option<Bound<'py, PyArray2<f64>>>, String, Vec<(&'static str, String)>);

/// Fits one surface or signal. A surface without a sphere is mapped to a sphere first. `metadata` contains the metadata
/// of the file of the surface or signal, and of the sphere's file.
#[pyfunction]
#[pyo3(signature = (
    values, faces, sphere, sphere_faces, *, metadata, surface, parametrized, seam, changes, settings, progress = None
))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
pub(crate) fn fit<'py>(
    py: Python<'py>,
    values: PyReadonlyArray2<'py, f64>,
    faces: Option<Faces<'py>>,
    sphere: Option<Positions<'py>>,
    sphere_faces: Option<Faces<'py>>,
    metadata: (Option<Metadata>, Option<Metadata>),
    surface: bool,
    parametrized: bool,
    seam: Option<SeamIn>,
    changes: Changes,
    settings: Settings<'py>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Fitted<'py>> {
    let (params, mask, mask_path) = (settings.params()?, settings.mask(), settings.mask_path.clone());
    let (metadata, of_sphere) = metadata;
    let given = match (&sphere, &faces) {
        (Some(sphere), _) => {
            let sphere = SphereArrays::new(sphere, sphere_faces.as_ref(), parametrized)?;
            Given::Sphere(Box::new(sphere.with_seam(seam).with_metadata(of_sphere)))
        }
        (None, Some(faces)) => Given::Bare(Box::new(with_metadata(mesh("surface", &values, faces)?, metadata.clone()))),
        (None, None) => {
            return Err(PyValueError::new_err("sphere: required for signals and surfaces without triangles"));
        }
    };
    let triangles = faces.map(|faces| crate::arrays::rows("faces", faces.as_array())).transpose()?;
    let view = values.as_array();
    let (sphere, fit, many, mapped, doubts) = run(py, settings.threads, progress.as_ref(), |monitor| match given {
        Given::Sphere(sphere) => {
            let sphere = sphere.check()?;
            let mut target = target(view, triangles.as_deref(), surface, &sphere, metadata)?;
            if let Some(mask) = &mask_path {
                target.check_mask(mask, &sphere);
            }
            refuse_doubtful(&sphere, &params)?;
            let doubts = doubts(&target, &params)?;
            let params = masked(params, mask.as_deref(), &sphere)?;
            let (fit, many) = spharm::fit_target(&sphere, target, &params, monitor)?;
            Ok((sphere, fit, many, None, doubts))
        }
        Given::Bare(mesh) => {
            let (input, keep) = (Input::Mesh(*mesh), mask.as_deref());
            let doubts = doubts_of_mask(metadata.as_ref(), mask_path.as_deref(), &params)?;
            let MeshFit { surface, fit, many } =
                spharm::fit_mesh_masked(input, changes.into(), keep, &params, monitor)?;
            Ok((surface.parametrized.sphere.clone(), fit, many, Some(surface), doubts))
        }
    })?;
    let map = mapped.as_ref().map(map_report);
    let mut found = fitted(py, sphere, fit, &many, map, surface);
    found.3.extend(doubts.into_iter().map(|text| ("SpharmWarning", text)));
    if let Some(mapped) = mapped {
        let changes = mapped.mesh_repair.map(|repair| repair.to_string());
        let cuts = mapped.handles.as_ref().map(ToString::to_string);
        let of_map = mapped.parametrized.map.report.warnings.iter().map(ToString::to_string);
        found.3.extend(changes.into_iter().chain(cuts).chain(of_map).map(|text| ("SpharmWarning", text)));
        mapped.record(&mut found.0.inner.provenance);
    }
    Ok(found)
}

/// Chooses the lowest degree with at most the requested error. Returns the degree, its error, and the requested error.
#[pyfunction]
#[pyo3(signature = (vertices, faces, sphere, sphere_faces, *, accuracy, settings, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
pub(crate) fn choose_degree(
    py: Python<'_>,
    vertices: PyReadonlyArray2<'_, f64>,
    faces: Faces<'_>,
    sphere: Option<Positions<'_>>,
    sphere_faces: Option<Faces<'_>>,
    accuracy: &str,
    settings: Settings<'_>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(usize, f64, f64)> {
    let (params, accuracy) = (settings.params()?, parsed("accuracy", accuracy)?);
    let mesh = mesh("surface", &vertices, &faces)?;
    let sphere = sphere.as_ref();
    let sphere = sphere.map(|sphere| SphereArrays::new(sphere, sphere_faces.as_ref(), false)).transpose()?;
    let chosen = run(py, settings.threads, progress.as_ref(), |monitor| match sphere {
        Some(sphere) => Ok(spharm::choose_degree_over(&sphere.check()?, &mesh, accuracy, &params, monitor)?),
        None => Ok(spharm::choose_degree(&Input::Mesh(mesh), accuracy, &params, monitor)?),
    })?;
    Ok((chosen.degree, chosen.rms, chosen.wanted))
}

enum Given<'a> {
    Sphere(Box<SphereArrays<'a>>),
    Bare(Box<Mesh>),
}

/// A solution as returned to Python: coefficients (one row per basis function, one column per channel), report as JSON,
/// and warnings as pairs of kind and text.
type Solution<'py> =
    (Bound<'py, PyArray2<f64>>, Option<Bound<'py, PyArray2<f64>>>, String, Vec<(&'static str, String)>);

/// Directions of samples.
#[derive(FromPyObject)]
pub(crate) enum At<'py> {
    /// Directions of a planned transform.
    Transform(Bound<'py, Transform>),
    Directions(Positions<'py>),
}

/// Fits a signal that is sampled at the given directions.
#[pyfunction]
#[pyo3(signature = (at, values, *, settings, progress = None))]
pub(crate) fn solve<'py>(
    py: Python<'py>,
    at: At<'py>,
    values: PyReadonlyArray2<'py, f64>,
    settings: Settings<'py>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Solution<'py>> {
    let (params, mask) = (settings.params()?, settings.mask());
    let view = values.as_array();
    let checked = |sphere: &Sphere, params: FitParams| -> Result<_, Failure> {
        refuse_doubtful(sphere, &params)?;
        Ok((target(view, None, false, sphere, None)?, masked(params, mask.as_deref(), sphere)?))
    };
    let (fit, many, warnings) = match &at {
        At::Transform(transform) => {
            let planned = &transform.get().planned;
            let (fit, many) = run(py, settings.threads, progress.as_ref(), |monitor| {
                let (target, params) = checked(planned.sphere(), params)?;
                Ok(planned.fit(target, &params, monitor)?)
            })?;
            let warnings = warnings(planned.sphere(), &fit);
            (fit, many, warnings)
        }
        At::Directions(directions) => {
            let sphere = SphereArrays::new(directions, None, false)?;
            run(py, settings.threads, progress.as_ref(), |monitor| {
                let sphere = sphere.check()?;
                let (target, params) = checked(&sphere, params)?;
                let (fit, many) = spharm::fit_target(&sphere, target, &params, monitor)?;
                let warnings = warnings(&sphere, &fit);
                Ok((fit, many, warnings))
            })?
        }
    };
    let report = report_of_call(&fit, &many, None);
    let errors = fit.standard_errors.map(|errors| errors.into_pyarray(py));
    Ok((fit.coefficients.values().to_owned().into_pyarray(py), errors, report.to_string(), warnings))
}

/// Fits several targets over one sphere. Each array in `values` has one row per vertex of the sphere. `metadata`
/// contains the metadata of each target's file and of the sphere's file.
#[pyfunction]
#[pyo3(signature = (values, sphere, sphere_faces, *, metadata, surface, parametrized, seam, settings, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
pub(crate) fn fit_many<'py>(
    py: Python<'py>,
    values: Vec<PyReadonlyArray2<'py, f64>>,
    sphere: Positions<'py>,
    sphere_faces: Option<Faces<'py>>,
    metadata: (Vec<Option<Metadata>>, Option<Metadata>),
    surface: bool,
    parametrized: bool,
    seam: Option<SeamIn>,
    settings: Settings<'py>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Vec<Fitted<'py>>> {
    let (params, mask, mask_path) = (settings.params()?, settings.mask(), settings.mask_path.clone());
    let (metadata, of_sphere) = metadata;
    let sphere = SphereArrays::new(&sphere, sphere_faces.as_ref(), parametrized)?;
    let sphere = sphere.with_seam(seam).with_metadata(of_sphere);
    let views: Vec<ArrayView2<'_, f64>> = values.iter().map(|values| values.as_array()).collect();
    let doubtful: Vec<OnceLock<Vec<String>>> = views.iter().map(|_| OnceLock::new()).collect();
    let (sphere, fits, report) = run(py, settings.threads, progress.as_ref(), |monitor: &dyn Monitor| {
        let sphere = sphere.check()?;
        refuse_doubtful(&sphere, &params)?;
        let params = masked(params, mask.as_deref(), &sphere)?;
        let read = |number: usize| -> Result<Target, Failure> {
            let metadata = metadata.get(number).cloned().flatten();
            let mut target = target(views[number], None, surface, &sphere, metadata)?;
            if let Some(mask) = &mask_path {
                target.check_mask(mask, &sphere);
            }
            let found = doubts(&target, &params)?;
            drop(doubtful[number].set(found));
            Ok(target)
        };
        let (fits, report) = spharm::fit_many(&sphere, views.len(), &read, &params, &|_, fit| Ok(fit), monitor)?;
        Ok((sphere, fits, report))
    })?;
    let each = fits.into_iter().zip(doubtful).map(|(fit, doubts)| {
        let mut found = fitted(py, sphere.clone(), fit, &report, None, surface);
        found.3.extend(doubts.into_inner().unwrap_or_default().into_iter().map(|text| ("SpharmWarning", text)));
        found
    });
    Ok(each.collect())
}

/// Returns the report of a fit as JSON, including the distances at the vertices.
pub(crate) fn report_of(report: &FitReport) -> Value {
    let (msd, xsd) = (json!(report.msd), json!(report.xsd));
    let mut report = json!(report);
    if let Some(report) = report.as_object_mut() {
        report.extend([("msd".to_owned(), msd), ("xsd".to_owned(), xsd)]);
    }
    report
}

/// Returns the report of a fit as JSON. It includes the report of the call and, for a surface without a sphere, the
/// report of the map.
fn report_of_call(fit: &Fit, many: &ManyReport, map: Option<Value>) -> Value {
    let mut report = report_of(&fit.report);
    let (scheme, seconds) = (many.scheme.to_string(), many.seconds);
    if let Some(report) = report.as_object_mut() {
        report.insert("smoothness".to_owned(), json!(fit.report.smoothness));
        report.insert("scheme_key".to_owned(), json!(scheme));
        report.insert("seconds".to_owned(), json!(seconds));
        report.insert("parametrization".to_owned(), map.unwrap_or(Value::Null));
        if let [BatchReport::LeastSquares { report: solver, .. }] = &many.batches[..] {
            report.insert("solver".to_owned(), json!(solver));
        }
    }
    report
}

/// Returns the warnings of a sphere and of a fit over it, each with its class.
fn warnings(sphere: &Sphere, fit: &Fit) -> Vec<(&'static str, String)> {
    let doubts = sphere.warnings.iter().map(|warning| ("SpharmWarning", format!("the sphere: {warning}")));
    let warnings = fit.report.warnings.iter().map(|warning| (category(warning), warning.to_string()));
    doubts.chain(warnings).collect()
}

fn fitted<'py>(
    py: Python<'py>,
    sphere: Sphere,
    fit: Fit,
    many: &ManyReport,
    map: Option<Value>,
    surface: bool,
) -> Fitted<'py> {
    let (report, warnings) = (report_of_call(&fit, many, map), warnings(&sphere, &fit));
    let errors = fit.standard_errors.clone().map(|errors| errors.into_pyarray(py));
    let kind = if surface { Kind::Surface } else { Kind::Signal };
    (Model { inner: Inner::new(sphere, fit, kind) }, errors, report.to_string(), warnings)
}

/// Returns the name of a warning's class in `spharm_rs.errors`.
pub(crate) fn category(warning: &FitWarning) -> &'static str {
    match warning {
        FitWarning::Oscillation { .. } => "Oscillation",
        FitWarning::Singular { .. }
        | FitWarning::FewVertices { .. }
        | FitWarning::RankDeficient { .. }
        | FitWarning::Amplified { .. }
        | FitWarning::NoiseOfGaps { .. }
        | FitWarning::UnevenWeights { .. }
        | FitWarning::Gap { .. } => "NotDetermined",
        FitWarning::Solver(LsqWarning::Underdetermined { .. }) => "NotDetermined",
        FitWarning::NotConverged { .. } | FitWarning::StillFalling { .. } => "NotConverged",
        _ => "SpharmWarning",
    }
}
