//! Reads, writes, maps, resamples and compares surfaces.

use std::path::{Path, PathBuf};

use numpy::ndarray::Array2;
use numpy::{IntoPyArray, PyArray1, PyArray2, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde_json::{Value, json};
use spharm::generate::{Cortex, cortex};
use spharm::io::{
    CoarseNumbers, WriteOptions, is_named_mesh, read_mesh, read_mesh_with_gaps, read_signal, read_signal_with_gaps,
    write_mesh, write_signal,
};
use spharm::machine::available_memory;
use spharm::metrics::{
    SurfaceDistanceParams, Unpaired, compare_at, distances_to_surface, surface_distance_at, vertex_distances,
};
use spharm::parametrize::quality::Quality;
use spharm::parametrize::{
    CaldParams, ConformalParams, DeformParams, EqualAreaParams, Input, Method, Parametrization, StretchParams,
    resample as resample_mesh,
};
use spharm::{Mesh, Monitor, Place, Preparation, Seam, Signal, Sphere};
use spharm_cohort::files::ModelFiles;
use spharm_cohort::{file_stem, is_model};
use spharm_surface::geometry::sub;

use crate::arrays::{Faces, FacesOut, Positions, PositionsOut, SeamOut, mesh, mesh_arrays, positions, rows, seam_out};
use crate::errors::Failure;
use crate::memory::{check_distance, check_mapping, check_resampling};
use crate::metadata::{Metadata, with_metadata};
use crate::repairs::Changes;
use crate::run::{run, run_owned};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(is_mesh_name, module)?)?;
    module.add_function(wrap_pyfunction!(stem, module)?)?;
    module.add_function(wrap_pyfunction!(read_surface, module)?)?;
    module.add_function(wrap_pyfunction!(write_surface, module)?)?;
    module.add_function(wrap_pyfunction!(read_values, module)?)?;
    module.add_function(wrap_pyfunction!(values_at, module)?)?;
    module.add_function(wrap_pyfunction!(write_values, module)?)?;
    module.add_function(wrap_pyfunction!(icosphere, module)?)?;
    module.add_function(wrap_pyfunction!(example_surface, module)?)?;
    module.add_function(wrap_pyfunction!(parametrize, module)?)?;
    module.add_function(wrap_pyfunction!(resample, module)?)?;
    module.add_function(wrap_pyfunction!(read_mask, module)?)?;
    module.add_function(wrap_pyfunction!(quality, module)?)?;
    module.add_function(wrap_pyfunction!(compare, module)?)?;
    module.add_function(wrap_pyfunction!(surface_distance, module)?)?;
    Ok(())
}

/// Returns whether a file's name has the extension of a format for meshes or GIfTI. Of the extensions of FreeSurfer's
/// surfaces, only `.pial` and `.white` are recognised, because the others are common words.
#[pyfunction]
fn is_mesh_name(path: PathBuf) -> bool {
    let name = path.to_string_lossy().to_ascii_lowercase();
    let named = [".pial", ".white", ".gii", ".gii.gz"].iter().any(|ending| name.ends_with(ending));
    named || is_named_mesh(&path)
}

/// Returns the name of a surface's or model's file, without the folder and the format's extension.
#[pyfunction]
fn stem(path: PathBuf) -> String {
    match is_model(&path) {
        true => ModelFiles { model: path }.name(),
        false => file_stem(&path).to_string_lossy().into_owned(),
    }
}

/// A surface as returned to Python: vertices, triangles, and the metadata of its file.
pub(crate) type SurfaceOut<'py> = (PositionsOut<'py>, FacesOut<'py>, Option<Metadata>);

/// Returns a mesh and its metadata for Python. `path` is the file from which the mesh was read.
pub(crate) fn surface_out<'py>(py: Python<'py>, mut mesh: Mesh, path: Option<&Path>) -> SurfaceOut<'py> {
    let metadata = Metadata::of(std::mem::take(&mut mesh.meta), path);
    let (vertices, faces) = mesh_arrays(py, mesh);
    (vertices, faces, metadata)
}

/// Reads a surface. If `gaps` is set, positions may be NaN or infinite.
#[pyfunction]
#[pyo3(signature = (path, *, gaps = false))]
fn read_surface(py: Python<'_>, path: PathBuf, gaps: bool) -> PyResult<SurfaceOut<'_>> {
    let read = |_: &dyn Monitor| Ok(if gaps { read_mesh_with_gaps(&path)? } else { read_mesh(&path)? });
    let mesh = run(py, Some(1), None, read)?;
    Ok(surface_out(py, mesh, Some(&path)))
}

#[pyfunction]
#[pyo3(signature = (path, vertices, faces, metadata, *, overwrite, double))]
fn write_surface(
    py: Python<'_>,
    path: PathBuf,
    vertices: Positions<'_>,
    faces: Faces<'_>,
    metadata: Option<Metadata>,
    overwrite: bool,
    double: bool,
) -> PyResult<Option<String>> {
    let mesh = with_metadata(mesh("surface", &vertices, &faces)?, metadata);
    run(py, Some(1), None, move |_| {
        let options = WriteOptions { overwrite, double };
        write_mesh(&path, &mesh, &options)?;
        Ok(CoarseNumbers::of(&path, &mesh, &options)?.map(|coarse| coarse.with_option(Some("give double=True"))))
    })
}

/// Reads a signal. If `gaps` is set, values may be NaN.
#[pyfunction]
#[pyo3(signature = (path, *, gaps = false))]
fn read_values(py: Python<'_>, path: PathBuf, gaps: bool) -> PyResult<Bound<'_, PyArray2<f64>>> {
    let values = run(py, Some(1), None, move |_| {
        let signal = if gaps { read_signal_with_gaps(path)? } else { read_signal(path)? };
        let Signal { values, vertices, channels } = signal;
        Array2::from_shape_vec((vertices, channels), values).map_err(|_| Failure::Panic)
    })?;
    Ok(values.into_pyarray(py))
}

/// Values at points, and the points' distances from the surface.
type ValuesOut<'py> = (Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>);

/// Returns a surface's values at its points nearest to the given points, and the given points' distances from it.
/// Within triangles, values are interpolated linearly or, with `labels`, taken from the nearest corner.
#[pyfunction]
#[pyo3(signature = (vertices, faces, values, points, *, labels))]
fn values_at<'py>(
    py: Python<'py>,
    vertices: Positions<'py>,
    faces: Faces<'py>,
    values: PyReadonlyArray2<'py, f64>,
    points: Positions<'py>,
    labels: bool,
) -> PyResult<ValuesOut<'py>> {
    let (mesh, points) = (mesh("surface", &vertices, &faces)?, rows("points", points.as_array())?);
    let values = values.as_array().as_standard_layout().into_owned();
    let (found, off) = run(py, Some(1), None, |_| {
        let places = Place::nearest(&mesh, &points).ok_or_else(|| {
            Failure::Argument("surface, points: expected at least one triangle and finite coordinates".into())
        })?;
        let width = values.ncols();
        let (rows, _) = values.into_raw_vec_and_offset();
        let value = if labels { Place::largest_row } else { Place::row };
        let found = places.iter().flat_map(|place| value(place, &rows, width)).collect();
        let off = places.iter().zip(points.iter()).map(|(place, point)| sub(place.of(&mesh.vertices), *point));
        let off = off.map(|vector| vector.into_iter().fold(0.0, f64::hypot));
        Ok((Array2::from_shape_vec((places.len(), width), found).map_err(|_| Failure::Panic)?, off.collect::<Vec<_>>()))
    })?;
    Ok((found.into_pyarray(py), off.into_pyarray(py)))
}

#[pyfunction]
fn read_mask(py: Python<'_>, path: PathBuf, vertices: usize) -> PyResult<Bound<'_, PyArray1<bool>>> {
    let keep = run(py, Some(1), None, move |_| Ok(spharm::io::read_mask(path, vertices)?))?;
    Ok(keep.into_pyarray(py))
}

#[pyfunction]
#[pyo3(signature = (path, values, *, overwrite, double))]
fn write_values(
    py: Python<'_>,
    path: PathBuf,
    values: PyReadonlyArray2<'_, f64>,
    overwrite: bool,
    double: bool,
) -> PyResult<()> {
    let view = values.as_array();
    let (vertices, channels) = view.dim();
    let signal = Signal::new(view.iter().copied().collect(), vertices, channels);
    run(py, Some(1), None, move |_| Ok(write_signal(path, &signal, &WriteOptions { overwrite, double })?))
}

#[pyfunction]
fn icosphere(py: Python<'_>, level: u32) -> PyResult<(PositionsOut<'_>, FacesOut<'_>)> {
    /// Highest level of subdivision. The icosphere of this level has 167,772,162 vertices. The command-line program has
    /// the same limit.
    const FINEST: u32 = 12;
    if level > FINEST {
        return Err(PyValueError::new_err(format!("level: expected 0 to {FINEST}, found {level}")));
    }
    Ok(mesh_arrays(py, py.detach(|| Sphere::icosphere(level).to_mesh())))
}

#[pyfunction]
fn example_surface(
    py: Python<'_>,
    level: u32,
    variant: u64,
) -> PyResult<(PositionsOut<'_>, FacesOut<'_>, PositionsOut<'_>)> {
    if level > 8 {
        return Err(PyValueError::new_err(format!("level: expected 0 to 8, found {level}")));
    }
    let (surface, sphere) = py.detach(|| cortex(&Cortex { subdivisions: level, variant }));
    let (vertices, faces) = mesh_arrays(py, surface);
    Ok((vertices, faces, positions(py, sphere.vertices)))
}

/// A mapped surface as returned to Python: vertices, triangles, vertices of the sphere, report as JSON, warnings, and
/// the record of cut handles.
pub(crate) type Mapped<'py> =
    (PositionsOut<'py>, FacesOut<'py>, PositionsOut<'py>, String, Vec<String>, Option<SeamOut<'py>>);

/// Maps a surface to a sphere, and records cut handles in the metadata of the sphere. Also returns the report on the
/// handles, if any were cut.
pub(crate) fn map(
    input: &Input,
    method: &Method,
    memory: Option<usize>,
    monitor: &dyn Monitor,
) -> Result<(Parametrization, Option<Value>), Failure> {
    check_mapping(input, method, memory)?;
    let mut found = method.run(input, monitor)?;
    if let Some(cut) = input.cut() {
        cut.mark(&mut found.sphere);
    }
    Ok((found, input.handles().map(|handles| json!(handles))))
}

/// Returns a mapped surface for Python, with further details in its report.
pub(crate) fn mapped(
    py: Python<'_>,
    found: Parametrization,
    details: impl IntoIterator<Item = (&'static str, Option<Value>)>,
) -> Mapped<'_> {
    let mut report = json!(found.report);
    if let Some(report) = report.as_object_mut() {
        report.extend(details.into_iter().filter_map(|(name, detail)| Some((name.to_owned(), detail?))));
    }
    if let (Some(report), Some(resampling)) = (report.as_object_mut(), &found.resampling) {
        report.insert("distance_rms".to_owned(), json!(resampling.distance.rms));
        report.insert("distance_max".to_owned(), json!(resampling.distance.hausdorff));
    }
    let warnings = found.report.warnings.iter().map(ToString::to_string).collect();
    let seam = Seam::of(&found.sphere.meta).map(|seam| seam_out(py, seam));
    let (vertices, faces) = mesh_arrays(py, found.surface);
    (vertices, faces, positions(py, found.sphere.vertices), report.to_string(), warnings, seam)
}

pub(crate) fn method(name: &str, degree: Option<usize>, area: f64, seed: u64) -> PyResult<Method> {
    let params = CaldParams { area, degree, seed, ..CaldParams::default() };
    Ok(match name {
        "auto" => Method::Auto(params),
        "cald" => Method::Cald(params),
        "conformal" => Method::Conformal(ConformalParams { seed, ..ConformalParams::default() }),
        "stretch" => Method::Stretch(StretchParams { seed, ..StretchParams::default() }),
        "equal-area" => Method::EqualArea(EqualAreaParams::default()),
        "deform" => Method::Deform { params: DeformParams::default(), map: params },
        found => {
            let expected = "expected auto, cald, conformal, stretch, equal-area or deform";
            return Err(PyValueError::new_err(format!("method: {expected}; found {found}")));
        }
    })
}

#[pyfunction]
#[pyo3(signature = (
    vertices, faces, *, changes, method, degree, area, seed, memory = None, threads = None, progress = None
))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
fn parametrize<'py>(
    py: Python<'py>,
    vertices: Positions<'py>,
    faces: Faces<'py>,
    changes: Changes,
    method: &str,
    degree: Option<usize>,
    area: f64,
    seed: u64,
    memory: Option<usize>,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Mapped<'py>> {
    let (mesh, method) = (mesh("surface", &vertices, &faces)?, self::method(method, degree, area, seed)?);
    let (found, handles, repair, changes) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let mesh = Input::Mesh(mesh);
        check_mapping(&mesh, &method, memory)?;
        let mesh = Preparation::from(changes).apply(mesh, monitor)?;
        let (found, handles) = map(&mesh, &method, memory, monitor)?;
        Ok((found, handles, mesh.mesh_repair().copied(), mesh.changes(false)))
    })?;
    let details = [("handles", handles), ("mesh_repair", repair.map(|repair| json!(repair)))];
    let mut mapped = mapped(py, found, details);
    mapped.4.extend(changes);
    Ok(mapped)
}

#[pyfunction]
#[pyo3(signature = (
    vertices, faces, sphere, shared, shared_faces, *, memory = None, threads = None, progress = None
))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
fn resample<'py>(
    py: Python<'py>,
    vertices: Positions<'py>,
    faces: Faces<'py>,
    sphere: Positions<'py>,
    shared: Positions<'py>,
    shared_faces: Faces<'py>,
    memory: Option<usize>,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Mapped<'py>> {
    let surface = mesh("surface", &vertices, &faces)?;
    let sphere = Mesh::new(crate::arrays::rows("sphere", sphere.as_array())?, surface.faces.clone());
    let shared = mesh("resampling sphere", &shared, &shared_faces)?;
    let found = run_owned(py, threads, progress.as_ref(), move |monitor| {
        corresponding(&surface, &sphere)?;
        check_resampling(&shared, memory)?;
        Ok(resample_mesh(&surface, &sphere, &shared, monitor)?)
    })?;
    Ok(mapped(py, found, []))
}

/// Returns measures of the quality of a map to the sphere, as JSON.
#[pyfunction]
fn quality(py: Python<'_>, vertices: Positions<'_>, faces: Faces<'_>, sphere: Positions<'_>) -> PyResult<String> {
    let surface = mesh("surface", &vertices, &faces)?;
    let sphere = Mesh::new(crate::arrays::rows("sphere", sphere.as_array())?, surface.faces.clone());
    let found = run(py, None, None, move |_| {
        corresponding(&surface, &sphere)?;
        Ok(Quality::of(&surface, &sphere))
    })?;
    Ok(json!(found).to_string())
}

fn corresponding(surface: &Mesh, sphere: &Mesh) -> Result<(), Failure> {
    let (expected, found) = (surface.vertices.len(), sphere.vertices.len());
    if expected == found {
        return Ok(());
    }
    Err(Failure::Argument(format!("sphere: expected {expected} vertices, as many as the surface has; found {found}")))
}

/// Mean and maximum squared distance, rms, maximum, scale; the farthest vertex; each vertex's distance; a warning.
type Compared<'py> = ([f64; 5], usize, Bound<'py, PyArray1<f64>>, Option<String>);

/// Compares two meshes whose vertices correspond. Returns msd, xsd and related numbers, the vertex with the largest
/// distance, the distance at each vertex and, with `check`, a warning if the vertices don't correspond.
#[pyfunction]
fn compare<'py>(
    py: Python<'py>,
    vertices: Positions<'py>,
    faces: Faces<'py>,
    others: Positions<'py>,
    other_faces: Faces<'py>,
    mask: Option<PyReadonlyArray1<'py, bool>>,
    check: bool,
) -> PyResult<Compared<'py>> {
    let (first, second) = (mesh("surface", &vertices, &faces)?, mesh("other surface", &others, &other_faces)?);
    let mask = mask.map(|mask| mask.as_array().to_vec());
    let (found, each, unpaired) = run(py, None, None, move |_| {
        let found = compare_at(&first, &second, mask.as_deref())?;
        let each = vertex_distances(&first.vertices, &second.vertices)?;
        let unpaired = if check && Unpaired::bytes(second.faces.len()) <= available_memory() as u64 {
            Unpaired::of(&first, &second, mask.as_deref(), &found)?
        } else {
            None
        };
        Ok((found, each, unpaired.map(|found| found.to_string())))
    })?;
    let figures = [found.msd, found.xsd, found.rms_raw, found.max_raw, found.scale];
    Ok((figures, found.worst_vertex, each.into_pyarray(py), unpaired))
}

/// Measures the distance between two surfaces over their whole area. Returns the measured numbers as JSON, and the
/// distances of the second surface's vertices from the first surface.
#[pyfunction]
#[pyo3(signature = (vertices, faces, others, other_faces, *, samples, mask = None, memory = None, threads = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
fn surface_distance<'py>(
    py: Python<'py>,
    vertices: Positions<'py>,
    faces: Faces<'py>,
    others: Positions<'py>,
    other_faces: Faces<'py>,
    samples: usize,
    mask: Option<PyReadonlyArray1<'py, bool>>,
    memory: Option<usize>,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<(String, Bound<'py, PyArray1<f64>>)> {
    let mask = mask.map(|mask| mask.as_array().to_vec());
    let (first, second) = (mesh("surface", &vertices, &faces)?, mesh("other surface", &others, &other_faces)?);
    let (found, each) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let params = SurfaceDistanceParams { samples };
        check_distance([&first, &second], &params, memory)?;
        let found = surface_distance_at(&first, &second, mask.as_deref(), &params, monitor)?;
        Ok((found, distances_to_surface(&first, &second.vertices, monitor)?))
    })?;
    let figures = json!({
        "mean": found.mean, "rms": found.rms, "percentile95": found.percentile95, "hausdorff": found.hausdorff,
        "bound": found.bound, "scale": found.scale,
        "forward": {"mean": found.forward.mean, "rms": found.forward.rms, "max": found.forward.max},
        "backward": {"mean": found.backward.mean, "rms": found.backward.rms, "max": found.backward.max},
    });
    Ok((figures.to_string(), each.into_pyarray(py)))
}
