//! Reads and writes landmarks, and measures the quality of a group's correspondence.

use std::path::PathBuf;

use pyo3::prelude::*;
use spharm::Kind;
use spharm::io::landmarks::{Frame, Landmarks};
use spharm::shape::quality::landmarks::LandmarkErrors;
use spharm::shape::{Curve, QualityParams, group_quality};

use crate::arrays::{Positions, PositionsOut, positions, rows};
use crate::errors::Failure;
use crate::groups::{coefficients, group};
use crate::models::Model;
use crate::run::{run, run_owned};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(read_landmarks, module)?)?;
    module.add_function(wrap_pyfunction!(write_landmarks, module)?)?;
    module.add_function(wrap_pyfunction!(shape_quality, module)?)?;
    Ok(())
}

type Named<'py> = (Vec<String>, PositionsOut<'py>, Option<&'static str>);

/// Reads a file of landmarks. Returns the names of the landmarks, their positions, (n, 3), and the name of the frame
/// of the positions.
#[pyfunction]
fn read_landmarks(py: Python<'_>, path: PathBuf) -> PyResult<Named<'_>> {
    let Landmarks { names, points, frame } = run(py, Some(1), None, move |_| Ok(Landmarks::read(path)?))?;
    Ok((names, positions(py, points), frame.map(Frame::name)))
}

#[pyfunction]
#[pyo3(signature = (path, names, points, frame, *, overwrite))]
fn write_landmarks(
    py: Python<'_>,
    path: PathBuf,
    names: Vec<String>,
    points: Positions<'_>,
    frame: Option<String>,
    overwrite: bool,
) -> PyResult<()> {
    let points = rows("points", points.as_array())?;
    run(py, Some(1), None, move |_| {
        let frame = match frame.as_deref() {
            None => None,
            Some(text) => Some(
                Frame::named(text)
                    .ok_or_else(|| Failure::Argument(format!("frame: expected LPS or RAS, found {text:?}")))?,
            ),
        };
        Ok(Landmarks::new(names, points, frame)?.write(path, overwrite)?)
    })
}

/// Keyword arguments of `spharm_rs.shape.quality`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Settings {
    degree: Option<usize>,
    modes: usize,
    samples: usize,
    bands: usize,
    sphere: u32,
    rigid: bool,
    surfaces: bool,
    seed: u64,
    mask: Option<Vec<bool>>,
}

type Ends = (Vec<f64>, Vec<f64>, Vec<f64>);
type Apart = (f64, f64, Option<[f64; 2]>, Vec<f64>, Vec<Vec<f64>>);
/// Quality of a group as returned to Python: total variance; variances of the modes; compactness, generalisation and
/// specificity; generalisation and specificity measured between surfaces; errors of landmarks; warnings.
type Found = (f64, Vec<f64>, [Ends; 3], [Option<Ends>; 2], Option<Apart>, Vec<String>);

/// Measures the quality of a group of corresponding surfaces.
#[pyfunction]
#[pyo3(signature = (models, landmarks, *, settings, threads = None, progress = None))]
fn shape_quality(
    py: Python<'_>,
    models: Vec<Py<Model>>,
    landmarks: Option<Vec<Positions<'_>>>,
    settings: Settings,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Found> {
    let models = coefficients(&models);
    let marks =
        landmarks.map(|all| all.iter().map(|own| rows("landmarks", own.as_array())).collect::<PyResult<Vec<_>>>());
    let marks = marks.transpose()?;
    let Settings { degree, modes, samples, bands, sphere, rigid, surfaces, seed, mask } = settings;
    let params = QualityParams { modes, samples, bands, subdivisions: sphere, rigid, surfaces, seed, mask };
    run_owned(py, threads, progress.as_ref(), move |monitor| {
        let group = group(&models, Kind::Surface, degree, monitor)?;
        let found = group_quality(&group.members, marks.as_deref(), &params, monitor)?;
        let ends = |Curve { values, low, high }: Curve| (values, low, high);
        let apart = |LandmarkErrors { mean, median, band, by_landmark, off }| (mean, median, band, by_landmark, off);
        Ok((
            found.variance,
            found.variances,
            [found.compactness, found.generalisation, found.specificity].map(ends),
            [found.surface_generalisation, found.surface_specificity].map(|curve| curve.map(ends)),
            found.landmarks.map(apart),
            group.warnings,
        ))
    })
}
