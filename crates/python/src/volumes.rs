//! Reads labels of volumes, and maps their surfaces to the sphere.

use std::collections::BTreeMap;
use std::path::PathBuf;

use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use spharm::parametrize::volume::{
    Affine, ImageChoice, LabelSurface, LabelVolume, Repair, VolumeParams, VolumeReading, VoxelValues,
};
use spharm::parametrize::{Input, ParametrizeError};

use crate::errors::exception;
use crate::run::{run, run_owned};
use crate::surfaces::{Mapped, map, mapped, method as method_of};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(parametrize_volume, module)?)?;
    module.add_function(wrap_pyfunction!(labels, module)?)?;
    Ok(())
}

/// Returns how a volume is read, given the numbers of its channel and its time.
pub(crate) fn reading((channel, time): (Option<usize>, Option<usize>), values: VoxelValues) -> VolumeReading {
    VolumeReading { voxel_size: None, values, image: ImageChoice { channel, time } }
}

/// A volume: the path of a file, or an array of labels or of other values, (i, j, k), with its affine matrix, (4, 4).
#[derive(FromPyObject)]
enum Volume<'py> {
    File(PathBuf),
    Labels(PyReadonlyArray3<'py, i32>, PyReadonlyArray2<'py, f64>),
    Values(PyReadonlyArray3<'py, f64>, PyReadonlyArray2<'py, f64>),
}

type Reader = Box<dyn FnOnce(&dyn spharm::Monitor) -> Result<LabelVolume, ParametrizeError> + Send>;

impl Volume<'_> {
    /// Returns a function that reads the volume without access to the interpreter's data.
    fn reader(self, reading: VolumeReading) -> PyResult<Reader> {
        // In NIfTI, the first index varies fastest.
        match self {
            Self::File(path) => Ok(Box::new(move |monitor| LabelVolume::read_with(path, reading, monitor))),
            Self::Labels(values, matrix) => {
                let (size, affine) = (values.as_array().dim().into(), affine(&matrix)?);
                let labels: Vec<i32> = values.as_array().t().iter().copied().collect();
                Ok(Box::new(move |_| Ok(LabelVolume::new(size, labels, affine))))
            }
            Self::Values(values, matrix) => {
                let (size, affine) = (values.as_array().dim().into(), affine(&matrix)?);
                let values: Vec<f64> = values.as_array().t().iter().copied().collect();
                Ok(Box::new(move |_| LabelVolume::of_values(size, &values, reading.values, affine)))
            }
        }
    }
}

fn affine(matrix: &PyReadonlyArray2<'_, f64>) -> PyResult<Affine> {
    let matrix = matrix.as_array();
    if matrix.dim() != (4, 4) {
        return Err(PyValueError::new_err(format!("affine: expected shape (4, 4), found {:?}", matrix.dim())));
    }
    Ok(Affine([0, 1, 2].map(|row| [0, 1, 2, 3].map(|column| matrix[[row, column]]))))
}

#[pyfunction]
#[pyo3(signature = (
    volume, *, label, image, threshold, probability, label_surface, smooth_radius, fix, cut_handles, method, degree, area, seed,
    memory = None, threads = None, progress = None
))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
fn parametrize_volume<'py>(
    py: Python<'py>,
    volume: Volume<'py>,
    label: Option<i64>,
    image: (Option<usize>, Option<usize>),
    threshold: Option<f64>,
    probability: bool,
    label_surface: &str,
    smooth_radius: Option<f64>,
    fix: bool,
    cut_handles: bool,
    method: &str,
    degree: Option<usize>,
    area: f64,
    seed: u64,
    memory: Option<usize>,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Mapped<'py>> {
    let read = volume.reader(reading(image, VoxelValues::of(threshold, probability)))?;
    let method = method_of(method, degree, area, seed)?;
    let surface = label_surface_of(py, label_surface, smooth_radius)?;
    let params = VolumeParams { label, surface, fix, handles: cut_handles };
    let (found, handles, repairs) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let surface = read(monitor)?.surface(&params, monitor)?;
        let repair = surface.repair.as_ref();
        let lost = repair.filter(|_| cut_handles).and_then(Repair::no_handle_left);
        let repairs: Vec<String> = repair.map(ToString::to_string).into_iter().chain(lost).collect();
        let (found, handles) = map(&Input::Label(surface).without_handles(monitor)?, &method, memory, monitor)?;
        Ok((found, handles, repairs))
    })?;
    let mut mapped = mapped(py, found, [("handles", handles)]);
    mapped.4.extend(repairs);
    Ok(mapped)
}

/// Returns the kind of surface for labels with this name, such as `smooth`, and a radius of smoothing.
pub(crate) fn label_surface_of(py: Python<'_>, name: &str, radius: Option<f64>) -> PyResult<LabelSurface> {
    LabelSurface::named(name, radius).map_err(|error| exception(py, error.into()))
}

/// Returns the labels in a volume, each with its number of voxels.
#[pyfunction]
#[pyo3(signature = (volume, *, image))]
fn labels(py: Python<'_>, volume: Volume<'_>, image: (Option<usize>, Option<usize>)) -> PyResult<BTreeMap<i64, usize>> {
    let read = volume.reader(reading(image, VoxelValues::Labels))?;
    run(py, Some(1), None, move |monitor| Ok(read(monitor)?.labels()))
}
