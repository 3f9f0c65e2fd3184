//! A label volume: a whole number for each voxel, 0 for the background.

use std::collections::BTreeMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use spharm_monitor::Monitor;
use spharm_surface::io::MOST_EXPANSION;

use super::affine::Affine;
use super::mask::Mask;
use super::values::Volume;
use super::{mgh, nifti};
use crate::error::ParametrizeError;

/// Whether a path has the name of a volume: `.nii`, `.nii.gz`, `.mgh` or `.mgz`.
///
/// FreeSurfer keeps maps over surfaces in `.mgh` and `.mgz` files, too; which of the two a file is, its sizes show, and
/// [`LabelVolume::read`] refuses a map.
#[must_use]
pub fn is_volume(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    [".nii", ".nii.gz", ".mgh", ".mgz"].iter().any(|ending| name.ends_with(ending))
}

/// A label volume.
#[derive(Clone, Debug)]
pub struct LabelVolume {
    path: PathBuf,
    /// Matrix from voxels to mm.
    pub affine: Affine,
    size: [usize; 3],
    /// (size), x fastest.
    values: Vec<i32>,
    extents: BTreeMap<i32, Extent>,
}

/// A label's number of voxels and the box around them, both ends included.
#[derive(Clone, Copy, Debug)]
struct Extent {
    voxels: usize,
    low: [usize; 3],
    high: [usize; 3],
}

impl LabelVolume {
    /// Reads a NIfTI-1 file (`.nii`, `.nii.gz`) or a FreeSurfer volume (`.mgh`, `.mgz`), gzipped or not. Its labels must
    /// fit into 32 bits.
    ///
    /// # Errors
    ///
    /// [`Io`](ParametrizeError::Io); [`VertexMap`](ParametrizeError::VertexMap) for a FreeSurfer file of values on
    /// vertices; [`NotAVolume`](ParametrizeError::NotAVolume) for a file of another format, that is shorter than its header
    /// says, or has more than three dimensions or values that aren't whole numbers;
    /// [`Interrupted`](ParametrizeError::Interrupted).
    pub fn read(path: impl AsRef<Path>, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        let path = path.as_ref();
        let io = |cause| ParametrizeError::Io { path: path.to_owned(), cause };
        // Opening a pipe would wait for whoever writes it.
        if !std::fs::metadata(path).map_err(io)?.is_file() {
            let (expected, found) = ("a regular file", "something else".to_owned());
            return Err(ParametrizeError::NotAVolume { path: path.to_owned(), expected, found });
        }
        let bytes = std::fs::read(path).map_err(io)?;
        let found = if bytes.starts_with(&[0x1f, 0x8b]) {
            let most = (bytes.len() as u64).saturating_mul(MOST_EXPANSION);
            parse(path, flate2::bufread::MultiGzDecoder::new(&bytes[..]), most, monitor)?
        } else {
            parse(path, &bytes[..], bytes.len() as u64, monitor)?
        };
        monitor.check()?;
        Ok(Self::of(path.to_owned(), found))
    }

    /// A volume from memory: `values` are (size), x fastest.
    ///
    /// # Panics
    ///
    /// When the number of values isn't that of the voxels.
    #[must_use]
    pub fn new(size: [usize; 3], values: Vec<i32>, affine: Affine) -> Self {
        assert_eq!(values.len(), size.iter().product(), "values of {size:?} voxels");
        Self::of(PathBuf::from("the volume"), Volume { size, affine, values })
    }

    fn of(path: PathBuf, Volume { size, affine, values }: Volume) -> Self {
        let extents = extents(size, &values);
        Self { path, affine, size, values, extents }
    }

    /// The file; "the volume" for one that was made in memory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The labels and their numbers of voxels, without 0 (the background).
    #[must_use]
    pub fn labels(&self) -> BTreeMap<i64, usize> {
        self.extents.iter().map(|(&label, extent)| (i64::from(label), extent.voxels)).collect()
    }

    /// `label`, if the volume has it; for `None` the only label.
    ///
    /// # Errors
    ///
    /// [`NoLabel`](ParametrizeError::NoLabel), with the labels of the volume.
    pub fn choose(&self, label: Option<i64>) -> Result<i64, ParametrizeError> {
        let labels = self.labels();
        match (label, labels.len()) {
            (Some(label), _) if labels.contains_key(&label) => Ok(label),
            (None, 1) => Ok(labels.into_keys().next().unwrap_or_default()),
            _ => Err(ParametrizeError::NoLabel { path: self.path.clone(), label, there: listed(&labels) }),
        }
    }

    /// A label's voxels. Takes time by the size of the label's box, not of the volume.
    ///
    /// # Errors
    ///
    /// [`NoLabel`](ParametrizeError::NoLabel) where no voxel has the label.
    pub fn mask(&self, label: i64) -> Result<Mask, ParametrizeError> {
        let found = i32::try_from(label).ok().and_then(|label| Some((label, self.extents.get(&label)?)));
        let Some((label, extent)) = found else {
            let there = listed(&self.labels());
            return Err(ParametrizeError::NoLabel { path: self.path.clone(), label: Some(label), there });
        };
        let [nx, ny, _] = self.size;
        let inside = |[x, y, z]: [usize; 3]| self.values[x + nx * (y + ny * z)] == label;
        Ok(Mask::of_box(extent.low, extent.high, inside))
    }
}

/// The format by the first bytes: NIfTI-1 begins with its header's size, in either byte order, MGH with its version.
fn parse(path: &Path, mut stream: impl Read, most: u64, monitor: &dyn Monitor) -> Result<Volume, ParametrizeError> {
    let mut magic = Vec::with_capacity(4);
    // A stream that breaks off here is an empty or damaged one, which the parsers name.
    let _ = (&mut stream).take(4).read_to_end(&mut magic);
    let is_mgh = magic == [0, 0, 0, 1];
    let stream = magic.chain(stream);
    if is_mgh { mgh::parse(path, stream, most, monitor) } else { nifti::parse(path, stream, most, monitor) }
}

/// The extent of every label but 0, in one pass.
fn extents(size: [usize; 3], values: &[i32]) -> BTreeMap<i32, Extent> {
    let mut extents = BTreeMap::new();
    let rows = values.chunks_exact(size[0].max(1));
    for (row, values) in rows.enumerate() {
        let (y, z) = (row % size[1], row / size[1]);
        let mut x = 0;
        for run in values.chunk_by(|a, b| a == b) {
            let (low, high) = ([x, y, z], [x + run.len() - 1, y, z]);
            x += run.len();
            if run[0] == 0 {
                continue;
            }
            let extent = extents.entry(run[0]).or_insert(Extent { voxels: 0, low, high });
            extent.voxels += run.len();
            for k in 0..3 {
                extent.low[k] = extent.low[k].min(low[k]);
                extent.high[k] = extent.high[k].max(high[k]);
            }
        }
    }
    extents
}

/// The first labels with their voxels, for an error message.
fn listed(labels: &BTreeMap<i64, usize>) -> String {
    let voxels = |n: usize| if n == 1 { "1 voxel".to_owned() } else { format!("{n} voxels") };
    let mut listed: Vec<String> =
        labels.iter().take(20).map(|(label, &n)| format!("{label} ({})", voxels(n))).collect();
    if labels.len() > listed.len() {
        listed.push(format!("{} more", labels.len() - listed.len()));
    }
    if listed.is_empty() { "none but 0".to_owned() } else { listed.join(", ") }
}
