//! Builds, lists and verifies basis stores.

use std::path::PathBuf;

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde_json::{Value, json};
use spharm::factor::{FactorSettings, PlannedFactor};
use spharm::store::{BuildParams, Scalar, build, catalog};

use crate::arrays::{Faces, Positions, SphereArrays};
use crate::run::{run, run_owned};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(store_build, module)?)?;
    module.add_function(wrap_pyfunction!(store_factor, module)?)?;
    module.add_function(wrap_pyfunction!(store_schemes, module)?)?;
    module.add_function(wrap_pyfunction!(store_verify, module)?)?;
    Ok(())
}

/// Returns the scalar type with a given name.
///
/// # Errors
///
/// `ValueError` for any other name.
pub(crate) fn scalar(name: &str) -> PyResult<Scalar> {
    match name {
        "f64" => Ok(Scalar::F64),
        "f32" => Ok(Scalar::F32),
        found => Err(PyValueError::new_err(format!("dtype: expected f64 or f32; found {found}"))),
    }
}

/// Builds the basis of a sphere in a store. Returns the report as JSON.
#[pyfunction]
#[pyo3(signature = (store, sphere, faces, max_degree, *, dtype, memory, allow_large, threads = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
fn store_build<'py>(
    py: Python<'py>,
    store: PathBuf,
    sphere: Positions<'py>,
    faces: Option<Faces<'py>>,
    max_degree: usize,
    dtype: &str,
    memory: usize,
    allow_large: bool,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<String> {
    let sphere = SphereArrays::new(&sphere, faces.as_ref(), false)?.owned();
    let params = BuildParams { max_degree, scalar: scalar(dtype)?, memory, allow_large, ..BuildParams::default() };
    let report = run_owned(py, threads, progress.as_ref(), move |monitor| {
        // The work already runs on a pool of the requested number of threads: use all of them.
        let params = BuildParams { threads: rayon::current_num_threads(), ..params };
        let sphere = sphere.check()?;
        let report = build(&store, &sphere.directions, &params, monitor)?;
        Ok(json!({
            "scheme_key": report.key.to_string(), "degrees_built": report.built, "degrees_present": report.present,
            "bytes": report.bytes,
        }))
    })?;
    Ok(report.to_string())
}

/// Computes the Cholesky factor of the normal equations, and writes it to a store. Returns the report as JSON.
#[pyfunction]
#[pyo3(signature = (
    store, sphere, faces, max_degree, *, dtype, basis_dtype, smoothness, memory, allow_large, threads = None, progress = None
))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
fn store_factor<'py>(
    py: Python<'py>,
    store: PathBuf,
    sphere: Positions<'py>,
    faces: Option<Faces<'py>>,
    max_degree: usize,
    dtype: &str,
    basis_dtype: &str,
    smoothness: f64,
    memory: usize,
    allow_large: bool,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<String> {
    if !(smoothness.is_finite() && smoothness >= 0.0) {
        return Err(PyValueError::new_err(format!("smoothness: expected a number of at least 0, found {smoothness}")));
    }
    let sphere = SphereArrays::new(&sphere, faces.as_ref(), false)?.owned();
    let (scalar, basis_scalar) = (scalar(dtype)?, scalar(basis_dtype)?);
    let report = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let threads = rayon::current_num_threads();
        let sphere = sphere.check()?;
        let settings = FactorSettings { max_degree, basis_scalar, scalar, smoothness, memory, threads, allow_large };
        let report = PlannedFactor::new(&store, &sphere, &settings)?.build(monitor)?;
        let condition = 1.0 / report.file.header().condition.reciprocal;
        Ok(json!({ "present": report.present, "condition": condition, "bytes": report.file.file_len() }))
    })?;
    Ok(report.to_string())
}

/// Returns a summary of each scheme in a store, as JSON.
#[pyfunction]
fn store_schemes(py: Python<'_>, store: PathBuf) -> PyResult<String> {
    let found = run(py, Some(1), None, move |_| {
        let keys = catalog::schemes(&store)?;
        let one = |key| -> Result<Value, spharm::Error> {
            let summary = catalog::summarize(&store, key)?;
            Ok(json!({
                "scheme_key": key.to_string(), "directions": summary.rows, "max_degree": summary.complete_to,
                "dtype": summary.scalar.map(Scalar::name), "factors": summary.factors, "damaged": summary.damaged,
                "bytes": summary.bytes,
            }))
        };
        Ok(keys.into_iter().map(one).collect::<Result<Vec<Value>, _>>()?)
    })?;
    Ok(Value::from(found).to_string())
}

/// Verifies all files of a store against their hashes. Returns the error messages about damaged files.
#[pyfunction]
#[pyo3(signature = (store, *, threads = None, progress = None))]
fn store_verify(
    py: Python<'_>,
    store: PathBuf,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Vec<String>> {
    run_owned(py, threads, progress.as_ref(), move |monitor| {
        let keys = catalog::schemes(&store)?;
        let found = catalog::verify(&store, &keys, monitor)?;
        Ok(found.damaged.iter().map(ToString::to_string).collect())
    })
}
