//! Reads labels of volumes, and maps their surfaces to the sphere.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use numpy::{PyReadonlyArray2, PyReadonlyArray3};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde_json::{Value, json};
use spharm::Monitor;
use spharm::parametrize::volume::{
    Affine, AxisOrder, ImageChoice, LabelSurface, LabelVolume, Repair, VolumeParams, VolumeReading, VolumeSurface,
    VoxelValues,
};
use spharm::parametrize::{Input, Method, Parametrization, ParametrizeError};
use spharm_cohort::degree::degree_of_labels;

use crate::errors::{Failure, exception};
use crate::run::{run, run_owned};
use crate::surfaces::{Mapped, map, mapped, method as method_of};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(parametrize_volume, module)?)?;
    module.add_function(wrap_pyfunction!(labels, module)?)?;
    module.add_class::<Labels>()?;
    Ok(())
}

/// Returns the settings for reading a volume, given the numbers of the channel and the time point.
pub(crate) fn reading((channel, time): (Option<usize>, Option<usize>), values: VoxelValues) -> VolumeReading {
    VolumeReading { values, image: ImageChoice { channel, time }, ..VolumeReading::default() }
}

/// Returns the order of axes with this name.
pub(crate) fn axes_of(name: &str) -> PyResult<AxisOrder> {
    AxisOrder::named(name).map_err(|error| PyValueError::new_err(error.to_string()))
}

/// A volume as passed from Python, either a file or an array. A file is given by its path, a voxel size that replaces
/// the size in the file, an affine matrix if the file has no voxel size, and the order of its axes. An array (i, j, k)
/// of labels or other values is given with its affine matrix (4, 4).
#[derive(FromPyObject)]
enum Volume<'py> {
    File(PathBuf, Option<[f64; 3]>, Option<PyReadonlyArray2<'py, f64>>, String),
    Labels(PyReadonlyArray3<'py, i32>, PyReadonlyArray2<'py, f64>),
    Values(PyReadonlyArray3<'py, f64>, PyReadonlyArray2<'py, f64>),
}

type Reader = Box<dyn FnOnce(&dyn Monitor) -> Result<LabelVolume, ParametrizeError> + Send>;

impl Volume<'_> {
    /// Returns a function that reads the volume without access to the interpreter's data.
    fn reader(self, reading: VolumeReading) -> PyResult<Reader> {
        // In NIfTI, the first index varies fastest.
        match self {
            Self::File(path, voxel_size, None, axes) => {
                let reading = VolumeReading { voxel_size, axes: axes_of(&axes)?, ..reading };
                Ok(Box::new(move |monitor| LabelVolume::read_with(path, reading, monitor)))
            }
            Self::File(path, _, Some(matrix), axes) => {
                let (affine, reading) = (affine(&matrix)?, VolumeReading { axes: axes_of(&axes)?, ..reading });
                Ok(Box::new(move |monitor| with_affine(&path, reading, affine, monitor)))
            }
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

/// Reads a file without a voxel size, and gives it an affine matrix.
fn with_affine(
    path: &Path,
    reading: VolumeReading,
    affine: Affine,
    monitor: &dyn Monitor,
) -> Result<LabelVolume, ParametrizeError> {
    match LabelVolume::read_with(path, reading, monitor) {
        Err(ParametrizeError::NoVoxelSize { .. }) => {
            let mut volume = of_unit_voxels(path, reading, monitor)?;
            volume.affine = affine;
            Ok(volume)
        }
        Err(error) => Err(error),
        Ok(_) => {
            let (what, expected) = ("affine", "None, because the volume file has its own affine");
            Err(ParametrizeError::Argument { what, expected, found: "a matrix".to_owned() })
        }
    }
}

fn of_unit_voxels(path: &Path, reading: VolumeReading, monitor: &dyn Monitor) -> Result<LabelVolume, ParametrizeError> {
    LabelVolume::read_with(path, VolumeReading { voxel_size: Some([1.0; 3]), ..reading }, monitor)
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
    let (found, details, warnings) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let volume = read(monitor)?;
        let surface = volume.surface(&params, monitor)?;
        let (path, label) = (volume.path().display().to_string(), surface.label);
        let border = format!("{path}: label {label} touches the border of the volume and may be cut off");
        let border = surface.at_border.then_some(border);
        let doubts: Vec<String> = volume.warnings().into_iter().chain(border).collect();
        drop(volume);
        let (found, details, changes) = map_label(surface, cut_handles, &method, memory, monitor)?;
        let warnings: Vec<String> = doubts.into_iter().chain(changes).collect();
        Ok((found, details, warnings))
    })?;
    let mut mapped = mapped(py, found, details);
    mapped.4.extend(warnings);
    Ok(mapped)
}

/// A mapped label: its surface and map, the details of its report, and the changes made to its surface.
type MappedLabel = (Parametrization, Vec<(&'static str, Option<Value>)>, Vec<String>);

/// Maps the surface of a label to the sphere, after cutting the surface's handles.
fn map_label(
    surface: VolumeSurface,
    cut_handles: bool,
    method: &Method,
    memory: Option<usize>,
    monitor: &dyn Monitor,
) -> Result<MappedLabel, Failure> {
    let repair = surface.repair.as_ref();
    let lost = repair.filter(|_| cut_handles).and_then(Repair::no_handle_left);
    let repairs: Vec<String> = repair.map(ToString::to_string).into_iter().chain(lost).collect();
    let details = [
        ("voxels", Some(json!(surface.voxels))),
        ("at_border", Some(json!(surface.at_border))),
        ("repair", repair.map(|repair| json!(repair))),
    ];
    let surface = Input::Label(surface).without_handles(monitor)?;
    let (found, handles) = map(&surface, method, memory, monitor)?;
    let changes = repairs.into_iter().chain(surface.handles().map(ToString::to_string)).collect();
    Ok((found, details.into_iter().chain([("handles", handles)]).collect(), changes))
}

/// A volume of labels that is read once, for the maps of several labels.
#[pyclass(frozen)]
pub(crate) struct Labels {
    volume: Arc<LabelVolume>,
}

#[pymethods]
impl Labels {
    #[new]
    #[pyo3(signature = (volume, *, image))]
    fn new(py: Python<'_>, volume: Volume<'_>, image: (Option<usize>, Option<usize>)) -> PyResult<Self> {
        let read = volume.reader(reading(image, VoxelValues::Labels))?;
        let volume = run_owned(py, Some(1), None, move |monitor| Ok(read(monitor)?))?;
        Ok(Self { volume: Arc::new(volume) })
    }

    /// Returns each label with its number of voxels, and whether the label touches the border of the volume. If `fix`
    /// is set, only the component that a repair keeps is checked for touching the border. `chosen` limits the effect of
    /// `fix` to these labels; without `chosen`, `fix` applies to all labels.
    fn labels(&self, py: Python<'_>, fix: bool, chosen: Option<Vec<i64>>) -> PyResult<BTreeMap<i64, (usize, bool)>> {
        let volume = Arc::clone(&self.volume);
        let chosen: Option<HashSet<i64>> = chosen.map(|labels| labels.into_iter().collect());
        run_owned(py, Some(1), None, move |monitor| {
            let of = |(label, voxels): (i64, usize)| -> Result<_, Failure> {
                // Repairs are limited to the chosen labels, because the repair of a label that fills the volume takes a
                // long time.
                let fixed = fix && chosen.as_ref().is_none_or(|chosen| chosen.contains(&label));
                Ok((label, (voxels, volume.touches_border_if(label, fixed, monitor)?)))
            };
            volume.labels().into_iter().map(of).collect()
        })
    }

    /// Returns the warnings about the voxel size.
    fn warnings(&self) -> Vec<String> {
        self.volume.warnings()
    }

    /// Returns the volume of a voxel, in mm^3.
    fn voxel(&self) -> f64 {
        self.volume.affine.determinant().abs()
    }

    /// Returns the degree that suits labels with these numbers of voxels.
    fn degree(&self, voxels: Vec<usize>) -> usize {
        degree_of_labels(&voxels, self.volume.voxel_size()).degree()
    }

    /// Maps the surface of a label to the sphere. The returned warnings concern only this label.
    #[pyo3(signature = (
        label, *, label_surface, smooth_radius, fix, cut_handles, memory = None, threads = None, progress = None
    ))]
    #[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
    fn parametrize<'py>(
        &self,
        py: Python<'py>,
        label: i64,
        label_surface: &str,
        smooth_radius: Option<f64>,
        fix: bool,
        cut_handles: bool,
        memory: Option<usize>,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Mapped<'py>> {
        let surface = label_surface_of(py, label_surface, smooth_radius)?;
        let params = VolumeParams { label: Some(label), surface, fix, handles: cut_handles };
        let (method, volume) = (Method::default(), Arc::clone(&self.volume));
        let (found, details, changes) = run_owned(py, threads, progress.as_ref(), move |monitor| {
            map_label(volume.surface(&params, monitor)?, cut_handles, &method, memory, monitor)
        })?;
        let mut mapped = mapped(py, found, details);
        mapped.4.extend(changes);
        Ok(mapped)
    }
}

/// Returns the kind of label surface with the given name, such as `smooth`, and the given radius of smoothing.
pub(crate) fn label_surface_of(py: Python<'_>, name: &str, radius: Option<f64>) -> PyResult<LabelSurface> {
    LabelSurface::named(name, radius).map_err(|error| exception(py, error.into()))
}

/// Returns the labels in a volume, each with its number of voxels.
#[pyfunction]
#[pyo3(signature = (volume, *, image))]
fn labels(py: Python<'_>, volume: Volume<'_>, image: (Option<usize>, Option<usize>)) -> PyResult<BTreeMap<i64, usize>> {
    let reading = reading(image, VoxelValues::Labels);
    let read: Reader = match volume {
        // The labels don't depend on the voxel size, so files without a voxel size are accepted.
        Volume::File(path, ..) => Box::new(move |monitor| of_unit_voxels(&path, reading, monitor)),
        array => array.reader(reading)?,
    };
    run(py, Some(1), None, move |monitor| Ok(read(monitor)?.labels()))
}
