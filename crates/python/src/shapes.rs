//! Analyses the shapes of models.

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2};
use pyo3::prelude::*;
use serde_json::json;
use spharm::harmonics::{Coefficients, Directions};
use spharm::shape::{
    Descriptors, HeatKernel, Library, LocalGeometry, MeasureParams, Metric, even_sphere, local_geometry, measure, tails,
};
use spharm::{Error, ModelError};

use crate::arrays::{Faces, Positions, PositionsOut, SphereArrays, positions, rows};
use crate::errors::Failure;
use crate::models::Model;
use crate::run::{run, run_owned};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(shape_measure, module)?)?;
    module.add_function(wrap_pyfunction!(shape_geometry, module)?)?;
    module.add_function(wrap_pyfunction!(shape_smooth, module)?)?;
    module.add_function(wrap_pyfunction!(shape_describe, module)?)?;
    module.add_function(wrap_pyfunction!(shape_match, module)?)?;
    module.add_function(wrap_pyfunction!(shape_tails, module)?)?;
    module.add_function(wrap_pyfunction!(shape_even, module)?)?;
    module.add_function(wrap_pyfunction!(crate::morphs::shape_morph, module)?)?;
    module.add_function(wrap_pyfunction!(crate::poses::shape_rotate, module)?)?;
    module.add_function(wrap_pyfunction!(crate::poses::shape_align, module)?)?;
    module.add_function(wrap_pyfunction!(crate::poses::shape_procrustes, module)?)?;
    module.add_function(wrap_pyfunction!(crate::checks::shape_check, module)?)?;
    module.add_function(wrap_pyfunction!(crate::groups::shape_mean, module)?)?;
    module.add_function(wrap_pyfunction!(crate::modes::shape_pca, module)?)?;
    module.add_function(wrap_pyfunction!(crate::studies::shape_measure_group, module)?)?;
    module.add_function(wrap_pyfunction!(crate::studies::shape_test, module)?)?;
    Ok(())
}

/// Returns the coefficients of a model up to a degree.
fn to_degree(model: &Model, degree: usize) -> Result<Coefficients, Failure> {
    let (own, max_degree) = (&model.inner.coefficients, model.inner.coefficients.max_degree());
    if degree > max_degree {
        return Err(Error::from(ModelError::DegreeTooHigh { degree, max_degree }).into());
    }
    Ok(Coefficients::new(own.up_to(degree).to_owned())?)
}

/// Returns the measures of a model's surface, such as area and volume, as JSON. Also returns warnings.
#[pyfunction]
#[pyo3(signature = (model, degree, *, tolerance, threads = None, progress = None))]
fn shape_measure(
    py: Python<'_>,
    model: PyRef<'_, Model>,
    degree: usize,
    tolerance: f64,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(String, Vec<String>)> {
    let inner = Model { inner: model.inner.clone() };
    let found = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let params = MeasureParams { tolerance, ..MeasureParams::default() };
        Ok(measure(&to_degree(&inner, degree)?, &params, monitor)?)
    })?;
    let figures = json!({
        "area": found.area, "volume": found.volume, "centroid": found.centroid, "sphericity": found.sphericity,
        "area_change": found.area_change, "squeezed": found.squeezed, "inwards": found.inwards,
    });
    Ok((figures.to_string(), found.warnings.iter().map(ToString::to_string).collect()))
}

/// Returns positions and normals, (n, 3) each, and an array (n, 7) with the columns area element, mean curvature H,
/// Gaussian curvature K, principal curvatures k1 and k2, shape index and curvedness.
#[pyfunction]
#[pyo3(signature = (model, directions, degree, *, threads = None, progress = None))]
fn shape_geometry<'py>(
    py: Python<'py>,
    model: PyRef<'py, Model>,
    directions: Option<Positions<'py>>,
    degree: usize,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(PositionsOut<'py>, PositionsOut<'py>, Bound<'py, PyArray2<f64>>)> {
    let directions = directions.map(|directions| rows("directions", directions.as_array())).transpose()?;
    let inner = Model { inner: model.inner.clone() };
    let points = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let directions = match directions {
            Some(directions) => Directions::from_vertices(&directions).map_err(Error::from)?,
            None => inner.inner.own_sphere().map_err(Error::from)?.directions.clone(),
        };
        Ok(local_geometry(&to_degree(&inner, degree)?, &directions, monitor)?)
    })?;
    let scalars = |point: &LocalGeometry| {
        let [k1, k2] = point.principal;
        let (mean, gaussian) = (point.mean_curvature(), point.gaussian_curvature());
        [point.area_element, mean, gaussian, k1, k2, point.shape_index(), point.curvedness()]
    };
    let columns: Vec<[f64; 7]> = points.iter().map(scalars).collect();
    let columns = Array2::from_shape_fn((columns.len(), 7), |(row, column)| columns[row][column]);
    let positions_out = positions(py, points.iter().map(|point| point.position).collect());
    let normals = positions(py, points.iter().map(|point| point.normal).collect());
    Ok((positions_out, normals, columns.into_pyarray(py)))
}

/// Returns a model smoothed by a heat kernel. The kernel is given by `time` or, if that is `None`, by `width` in
/// radians.
#[pyfunction]
#[pyo3(signature = (model, *, time, width))]
fn shape_smooth(py: Python<'_>, model: PyRef<'_, Model>, time: Option<f64>, width: f64) -> PyResult<Model> {
    let inner = &model.inner;
    let inner = run(py, Some(1), None, move |_| {
        let kernel = time.map_or_else(|| HeatKernel::of_width(width), HeatKernel::after)?;
        let step = json!({ "heat_kernel": { "s": kernel.time(), "fwhm_degrees": kernel.width().to_degrees() } });
        let coefficients = kernel.smooth(&inner.coefficients)?;
        Ok(spharm::model::transformed(inner, coefficients, "shape smooth", step))
    })?;
    Ok(Model { inner })
}

fn described(model: &spharm::Model) -> Result<Descriptors, Failure> {
    Ok(spharm::shape::descriptors(&model.coefficients)?)
}

/// For each degree from 1 to L: power, (L), and singular values, (L, c), of the coefficients of a model with c
/// channels.
type Described<'py> = (Bound<'py, PyArray1<f64>>, Bound<'py, PyArray2<f64>>);

/// Returns the power and the singular values of the coefficients for each degree from 1 to L.
#[pyfunction]
fn shape_describe<'py>(py: Python<'py>, model: PyRef<'py, Model>) -> PyResult<Described<'py>> {
    let inner = &model.inner;
    let found = run(py, Some(1), None, move |_| described(inner))?;
    let (degrees, channels) = (found.max_degree(), found.channels);
    let values = Array2::from_shape_fn((degrees, channels), |(l, k)| found.singular_values[l * channels + k]);
    Ok((found.power.into_pyarray(py), values.into_pyarray(py)))
}

/// Returns the indices, distances and scores of the models nearest to `query`, the nearest first.
#[pyfunction]
#[pyo3(signature = (query, among, *, count, unit_size, standardized, threads = None))]
fn shape_match(
    py: Python<'_>,
    query: PyRef<'_, Model>,
    among: Vec<Py<Model>>,
    count: usize,
    unit_size: bool,
    standardized: bool,
    threads: Option<usize>,
) -> PyResult<Vec<(usize, f64, f64)>> {
    let query = &query.inner;
    let among: Vec<&spharm::Model> = among.iter().map(|model| &model.get().inner).collect();
    run(py, threads, None, move |monitor| {
        let query = described(query)?;
        let mut of_library = Vec::with_capacity(among.len());
        for model in among {
            monitor.check().map_err(Error::from)?;
            of_library.push(described(model)?.up_to(query.max_degree()));
        }
        let metric = if standardized { Metric::Standardized } else { Metric::Distance };
        let found = Library::new(&of_library, unit_size)?.nearest(&query, count, metric)?;
        Ok(found.into_iter().map(|found| (found.index, found.bound, found.score)).collect())
    })
}

/// Returns the root mean square distance between a model and its truncation to each degree from 0 to L, as L + 1
/// values.
#[pyfunction]
fn shape_tails<'py>(py: Python<'py>, model: PyRef<'py, Model>) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let coefficients = &model.inner.coefficients;
    Ok(run(py, Some(1), None, move |_| Ok(tails(coefficients)?))?.into_pyarray(py))
}

/// Relocates the directions of a sphere so that the triangles of the model's surface have nearly equal areas. Returns
/// the directions, the spread of the areas before and after, and the number of flipped triangles.
#[pyfunction]
#[pyo3(signature = (model, sphere, faces, degree, *, steps, threads = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
fn shape_even<'py>(
    py: Python<'py>,
    model: PyRef<'py, Model>,
    sphere: Positions<'py>,
    faces: Faces<'py>,
    degree: usize,
    steps: usize,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(PositionsOut<'py>, f64, f64, usize)> {
    let sphere = SphereArrays::new(&sphere, Some(&faces), false)?.owned();
    let inner = Model { inner: model.inner.clone() };
    let found = run_owned(py, threads, progress.as_ref(), move |monitor| {
        Ok(even_sphere(&to_degree(&inner, degree)?, &sphere.check()?, steps, monitor)?)
    })?;
    let directions = found.sphere.directions.as_slice().to_vec();
    Ok((positions(py, directions), found.before, found.after, found.folded))
}
