//! Represents the file of a volume, with settings that supply data that the file's format may lack.

use std::io::Read;
use std::path::Path;

use spharm_monitor::Monitor;
use spharm_surface::SurfaceError;
use spharm_surface::io::{NoRoom, check_room};

use super::affine::Affine;
use super::axes::AxisOrder;
use super::grey::VoxelValues;
use super::image::ImageChoice;
use crate::error::ParametrizeError;

/// A volume's file, and the settings for reading it.
#[derive(Clone, Copy)]
pub(super) struct Source<'a> {
    pub(super) path: &'a Path,
    /// Size of the voxels, if the caller gives it because the format lacks it or the size in the file is wrong.
    pub(super) voxel_size: Option<[f64; 3]>,
    /// Meaning of the values.
    pub(super) values: VoxelValues,
    /// Channel and time point to read.
    pub(super) image: ImageChoice,
    /// Order of the axes of a NumPy array.
    pub(super) axes: AxisOrder,
    pub(super) monitor: &'a dyn Monitor,
}

impl Source<'_> {
    /// Returns the matrix from voxel coordinates to mm for a format that doesn't store positions. `found` is the file's
    /// voxel size, or the reason why the file has no voxel size. The caller's size replaces a missing or invalid size
    /// here; it replaces a valid size after the file has been read.
    pub(super) fn affine(&self, found: Result<[f64; 3], &'static str>) -> Result<Affine, ParametrizeError> {
        // A negative size is an axis that is stored in the opposite direction.
        let is_valid = |size: [f64; 3]| size.iter().all(|x| x.is_finite() && *x != 0.0);
        let size = match (found, self.voxel_size) {
            (Ok(size), given) => given.filter(|_| !is_valid(size)).unwrap_or(size),
            (Err(_), Some(given)) => given,
            (Err(format), None) => {
                return Err(ParametrizeError::NoVoxelSize { path: self.path.to_owned(), format });
            }
        };
        let affine = Affine::of_voxel_size(size);
        if !affine.is_valid() {
            return Err(self.wrong("voxels of finite, nonzero volume", format!("sizes {size:?}")));
        }
        Ok(affine)
    }

    /// Returns the indices, from 0, of the channel and the time point to read.
    pub(super) fn image(&self, channels: usize, times: usize) -> Result<[usize; 2], ParametrizeError> {
        self.image.indices(self.path, channels, times)
    }

    /// Refuses an order of axes other than x, y, z for a format with a fixed order. `format` is its name with an
    /// article.
    pub(super) fn fixed_axes(&self, format: &'static str) -> Result<(), ParametrizeError> {
        match self.axes {
            AxisOrder::Xyz => Ok(()),
            AxisOrder::Zyx => Err(ParametrizeError::FixedAxes { path: self.path.to_owned(), format }),
        }
    }

    pub(super) fn wrong(&self, expected: &'static str, found: String) -> ParametrizeError {
        ParametrizeError::NotAVolume { path: self.path.to_owned(), expected, found }
    }
}

/// Reads a whole regular file. Files of other kinds are rejected; opening a pipe, for instance, would wait for its
/// writer.
pub(super) fn load(path: &Path) -> Result<Vec<u8>, ParametrizeError> {
    let io = |cause| ParametrizeError::Io { path: path.to_owned(), cause };
    if let Some(found) = spharm_files::other_kind(std::fs::metadata(path).map_err(io)?.file_type()) {
        let (expected, found) = ("a regular file", found.to_owned());
        return Err(ParametrizeError::NotAVolume { path: path.to_owned(), expected, found });
    }
    let mut file = spharm_files::open(path).map_err(io)?;
    // The size is checked because a sparse file can be larger than the memory although it needs no space on disk.
    check_room(file.metadata().map_err(io)?.len()).map_err(|room| no_room(path, room))?;
    let mut bytes = Vec::new();
    file.read_to_end(&mut bytes).map_err(io)?;
    Ok(bytes)
}

/// Returns the error for a volume that needs more memory than is free.
pub(super) fn no_room(path: &Path, room: NoRoom) -> ParametrizeError {
    SurfaceError::NoRoom { path: path.to_owned(), room }.into()
}
