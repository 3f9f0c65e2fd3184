//! Represents a label volume: an integer for each voxel, 0 for the background.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use spharm_monitor::{Monitor, Silent};

use super::affine::Affine;
use super::axes::AxisOrder;
use super::doubt::{VolumeDoubt, ratio};
use super::grey::{Grey, VoxelValues};
use super::image::ImageChoice;
use super::mask::Mask;
use super::open::read;
use super::repair::largest_piece;
use super::runs::{Extent, Runs};
use super::source::Source;
use super::values::{Collector, Volume, Voxels};
use crate::error::ParametrizeError;

/// A label volume: an integer for each voxel, 0 for the background.
#[derive(Clone, Debug)]
pub struct LabelVolume {
    path: PathBuf,
    /// Matrix that maps voxel coordinates to positions in mm.
    pub affine: Affine,
    /// The voxel size in the file, if the size that the caller gave contradicts it.
    replaced: Option<[f64; 3]>,
    /// Reason to doubt the voxel positions that the file specifies, if any.
    doubt: Option<VolumeDoubt>,
    size: [usize; 3],
    found: Runs,
    extents: BTreeMap<i32, Extent>,
    /// The values in and around the body, if the file contains grey values or probabilities instead of labels.
    pub(super) grey: Option<Grey>,
}

/// Text used in error messages instead of a path, for a volume made in memory.
const IN_MEMORY: &str = "the volume";

/// Two voxel sizes contradict each other if they differ by more than this fraction.
const CONTRADICTION: f64 = 0.01;
/// A voxel size is probably wrong if the ratio of a voxel's longest side to its shortest side exceeds this number.
const LARGEST_RATIO: f64 = 10.0;
/// A volume is refused if the ratio of a voxel's longest side to its shortest side exceeds this number, because no
/// surface around its labels can be mapped to a sphere.
const IMPOSSIBLE_RATIO: f64 = 1e6;

/// Settings for reading a volume from a file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct VolumeReading {
    /// Size of the voxels along x, y and z in mm, instead of the size in the file. Default `None`: the size in the
    /// file.
    pub voxel_size: Option<[f64; 3]>,
    /// Meaning of the values. Default: labels.
    pub values: VoxelValues,
    /// Channel and time point to read from a file of several images. Default: the only channel and the only time point.
    pub image: ImageChoice,
    /// Order of the axes of a NumPy file. Default: x, y, z, the only order of other formats.
    pub axes: AxisOrder,
}

impl LabelVolume {
    /// Reads a volume from a file: NIfTI-1 or -2, FreeSurfer or NumPy, each gzipped or not, NRRD, or a TIFF stack. The
    /// labels must be 32-bit integers.
    ///
    /// # Errors
    ///
    /// [`Io`](ParametrizeError::Io) if the operating system can't read the file;
    /// [`VertexMap`](ParametrizeError::VertexMap) for a FreeSurfer file of values on vertices;
    /// [`NoVoxelSize`](ParametrizeError::NoVoxelSize) for a file that doesn't specify the size of its voxels;
    /// [`SeveralImages`](ParametrizeError::SeveralImages) for a file of several channels or time points;
    /// [`NotAVolume`](ParametrizeError::NotAVolume) for a file of another format, a file shorter than its header says,
    /// a file with more than three dimensions other than channels and time points, a NIfTI file with an invalid unit of
    /// length, or voxels whose sides differ by a factor of more than 1,000,000;
    /// [`NotLabels`](ParametrizeError::NotLabels) for values that aren't 32-bit integers;
    /// [`Interrupted`](ParametrizeError::Interrupted).
    pub fn read(path: impl AsRef<Path>, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        Self::read_with(path, VolumeReading::default(), monitor)
    }

    /// Reads a volume like [`read`](Self::read), but with settings. The body in a volume of grey values or
    /// probabilities becomes label 1.
    ///
    /// # Errors
    ///
    /// The errors of [`read`](Self::read); [`Argument`](ParametrizeError::Argument) if a size isn't positive or the
    /// level isn't finite; [`NotProbability`](ParametrizeError::NotProbability) for probabilities outside of 0 to 1;
    /// [`NotAVolume`](ParametrizeError::NotAVolume) if all voxels are on one side of the level;
    /// [`FixedAxes`](ParametrizeError::FixedAxes) if the order z, y, x is given for a file that isn't a NumPy file.
    pub fn read_with(
        path: impl AsRef<Path>,
        VolumeReading { voxel_size, values, image, axes }: VolumeReading,
        monitor: &dyn Monitor,
    ) -> Result<Self, ParametrizeError> {
        values.check()?;
        if let Some(size) = voxel_size.filter(|size| size.iter().any(|x| !(x.is_finite() && *x > 0.0))) {
            let (what, expected) = ("voxel size", "positive numbers");
            return Err(ParametrizeError::Argument { what, expected, found: format!("{size:?}") });
        }
        let path = path.as_ref();
        let (found, replaced) = read(&Source { path, voxel_size, values, image, axes, monitor })?;
        monitor.check()?;
        let size = found.affine.voxel_size();
        if ratio(size) > IMPOSSIBLE_RATIO {
            let expected = "voxels whose sides differ by a factor of at most 1,000,000";
            let found = format!("the voxel size {size:?}; correct the spacing in the file, or give the voxel size");
            return Err(ParametrizeError::NotAVolume { path: path.to_owned(), expected, found });
        }
        let replaced = replaced.filter(|file| (0..3).any(|axis| (size[axis] / file[axis] - 1.0).abs() > CONTRADICTION));
        Ok(Self { replaced, ..Self::of(path.to_owned(), found, values) })
    }

    /// Returns a volume made in memory. `values` has an integer for each voxel, with x varying fastest.
    ///
    /// # Panics
    ///
    /// When the number of values isn't the number of voxels, or memory doesn't suffice for the labels.
    #[must_use]
    pub fn new(size: [usize; 3], values: Vec<i32>, affine: Affine) -> Self {
        assert_eq!(values.len(), size.iter().product::<usize>(), "expected one value for each of {size:?} voxels");
        let labels = Runs::of(size, &values).unwrap_or_else(|room| panic!("the labels need {room}"));
        let voxels = Voxels { labels, values: Vec::new() };
        Self::of(PathBuf::from(IN_MEMORY), Volume { size, affine, voxels, doubt: None }, VoxelValues::Labels)
    }

    /// Returns a volume made in memory from grey values or probabilities. Its body becomes label 1. `values` has a
    /// number for each voxel, with x varying fastest.
    ///
    /// # Errors
    ///
    /// [`NotProbability`](ParametrizeError::NotProbability) for probabilities outside of 0 to 1;
    /// [`NotAVolume`](ParametrizeError::NotAVolume) if all voxels are on one side of the level;
    /// [`Argument`](ParametrizeError::Argument) if the level isn't finite.
    ///
    /// # Panics
    ///
    /// When the number of values isn't the number of voxels.
    pub fn of_values(
        size: [usize; 3],
        values: &[f64],
        meaning: VoxelValues,
        affine: Affine,
    ) -> Result<Self, ParametrizeError> {
        assert_eq!(values.len(), size.iter().product::<usize>(), "expected one value for each of {size:?} voxels");
        meaning.check()?;
        let path = Path::new(IN_MEMORY);
        let (image, axes) = (ImageChoice::default(), AxisOrder::default());
        let source = Source { path, voxel_size: None, values: meaning, image, axes, monitor: &Silent };
        let mut voxels = Collector::new(&source, size);
        voxels.check_room(values.len() as u64)?;
        values.iter().try_for_each(|&value| voxels.push(value))?;
        let volume = Volume { size, affine, voxels: voxels.finish()?, doubt: None };
        Ok(Self::of(path.to_owned(), volume, meaning))
    }

    fn of(
        path: PathBuf,
        Volume { size, affine, voxels: Voxels { labels, values }, doubt }: Volume,
        meaning: VoxelValues,
    ) -> Self {
        let extents = labels.extents();
        let body = extents.get(&1).copied();
        let grey = body.and_then(|Extent { low, high, .. }| Grey::around(&values, size, low, high, meaning));
        Self { path, affine, replaced: None, doubt, size, found: labels, extents, grey }
    }

    /// Returns the path of the file, or "the volume" for a volume made in memory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Returns the lengths of a voxel's edges, in mm.
    #[must_use]
    pub fn voxel_size(&self) -> [f64; 3] {
        self.affine.voxel_size()
    }

    /// Returns reasons to doubt the voxel size or the positions: the caller's voxel size contradicts the size in the
    /// file, the sides of a voxel differ by a large factor, a NIfTI header states no positions or contradictory
    /// positions, or an NRRD header has an unknown unit of length.
    #[must_use]
    pub fn doubts(&self) -> Vec<VolumeDoubt> {
        let size = self.voxel_size();
        let replaced = self.replaced.map(|file| VolumeDoubt::Replaced { given: size, file });
        let uneven = (ratio(size) > LARGEST_RATIO).then_some(VolumeDoubt::Uneven { size });
        replaced.into_iter().chain(uneven).chain(self.doubt).collect()
    }

    /// Returns a warning for each of the [`doubts`](Self::doubts). Each warning starts with the path.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let path = self.path.display();
        self.doubts().iter().map(|doubt| format!("{path}: {}", doubt.text(false))).collect()
    }

    /// Returns all labels except 0 (the background), with the number of voxels of each.
    #[must_use]
    pub fn labels(&self) -> BTreeMap<i64, usize> {
        self.extents.iter().map(|(&label, extent)| (i64::from(label), extent.voxels)).collect()
    }

    /// Returns whether a label has voxels at the border of the volume. A label at the border may be cut off.
    #[must_use]
    pub fn touches_border(&self, label: i64) -> bool {
        let extent = i32::try_from(label).ok().and_then(|label| self.extents.get(&label));
        extent.is_some_and(|extent| (0..3).any(|k| extent.low[k] == 0 || extent.high[k] + 1 == self.size[k]))
    }

    /// Returns whether a label has voxels at the border of the volume. If `fixed` is true, only the largest piece is
    /// considered, because a repair drops all other pieces.
    ///
    /// # Errors
    ///
    /// [`Interrupted`](ParametrizeError::Interrupted).
    pub fn touches_border_if(&self, label: i64, fixed: bool, monitor: &dyn Monitor) -> Result<bool, ParametrizeError> {
        if !fixed || !self.touches_border(label) {
            return Ok(self.touches_border(label));
        }
        Ok(self.is_at_border(&largest_piece(&self.mask(label)?, monitor)?.0))
    }

    /// Returns whether a mask has voxels at the border of the volume.
    pub(super) fn is_at_border(&self, mask: &Mask) -> bool {
        let inside = mask.inside.iter().enumerate().filter(|(_, inside)| **inside);
        inside.map(|(index, _)| mask.place(index)).any(|at| {
            let place = |k: usize| mask.origin[k] + at[k] as i64;
            (0..3).any(|k| place(k) == 0 || place(k) + 1 == self.size[k] as i64)
        })
    }

    /// Returns `label` if the volume has it. For `None`, returns the volume's only label.
    ///
    /// # Errors
    ///
    /// [`NoLabel`](ParametrizeError::NoLabel) if the volume lacks `label`, or has several labels and `label` is `None`;
    /// [`NotAVolume`](ParametrizeError::NotAVolume) if the volume has no label.
    pub fn choose(&self, label: Option<i64>) -> Result<i64, ParametrizeError> {
        let labels = self.labels();
        match (label, labels.len()) {
            (Some(label), _) if labels.contains_key(&label) => Ok(label),
            (None, 1) => Ok(labels.into_keys().next().unwrap_or_default()),
            (_, 0) => {
                let (expected, found) = ("a label", "only 0, the background".to_owned());
                Err(ParametrizeError::NotAVolume { path: self.path.clone(), expected, found })
            }
            _ => Err(ParametrizeError::NoLabel { path: self.path.clone(), label, there: listed(&labels) }),
        }
    }

    /// Returns a label's voxels as a mask. Takes time proportional to the size of the label's bounding box.
    ///
    /// # Errors
    ///
    /// [`NoLabel`](ParametrizeError::NoLabel) if no voxel has the label.
    pub fn mask(&self, label: i64) -> Result<Mask, ParametrizeError> {
        let found = i32::try_from(label).ok().and_then(|label| Some((label, self.extents.get(&label)?)));
        let Some((label, extent)) = found else {
            let there = listed(&self.labels());
            return Err(ParametrizeError::NoLabel { path: self.path.clone(), label: Some(label), there });
        };
        let mut mask = Mask::around(extent.low, extent.high);
        self.found.within(extent.low, extent.high, |from, to, found| {
            if found == label {
                let first = mask.index(std::array::from_fn(|k| from[k] - extent.low[k] + 1));
                mask.inside[first..=first + (to - from[0])].fill(true);
            }
        });
        Ok(mask)
    }
}

/// Lists up to 5 labels, with the number of voxels of each, for an error message.
fn listed(labels: &BTreeMap<i64, usize>) -> String {
    let voxels = |n: usize| if n == 1 { "1 voxel".to_owned() } else { format!("{n} voxels") };
    let mut listed: Vec<String> = labels.iter().take(5).map(|(label, &n)| format!("{label} ({})", voxels(n))).collect();
    if labels.len() > listed.len() {
        listed.push(format!("and {} more", labels.len() - listed.len()));
    }
    if listed.is_empty() { "only 0".to_owned() } else { listed.join(", ") }
}
