//! Reads surfaces: meshes, and labels of volumes.

use std::path::Path;

use spharm::io::read_mesh;
use spharm::parametrize::volume::{LabelVolume, VolumeParams};
use spharm::parametrize::{Input, ParametrizeError};
use spharm::{Error, Monitor, Preparation};

/// Reads surfaces, and repairs them and cuts their handles if requested. A volume takes a while to read and is kept
/// until the next one.
#[derive(Debug)]
pub struct SurfaceReader {
    preparation: Preparation,
    /// The volume that was read last.
    volume: Option<LabelVolume>,
}

impl SurfaceReader {
    /// Creates a reader. Without repairs and cuts, surfaces that need them are left for the fit to refuse.
    #[must_use]
    pub fn new(preparation: Preparation) -> Self {
        Self::with_volume(preparation, None)
    }

    /// Creates a reader with a volume that has already been read.
    #[must_use]
    pub fn with_volume(preparation: Preparation, volume: Option<LabelVolume>) -> Self {
        Self { preparation, volume }
    }

    /// Reads a mesh, or the surface around a label.
    ///
    /// # Errors
    ///
    /// When the file can't be read, the label has no closed surface of genus zero, or the surface whose handles are to
    /// be cut isn't closed and in one piece.
    pub fn read(&mut self, path: &Path, label: Option<i64>, monitor: &dyn Monitor) -> Result<Input, Error> {
        if label.is_none() {
            return self.preparation.apply(Input::Mesh(read_mesh(path)?), monitor);
        }
        let Preparation { fix, cut_handles, .. } = self.preparation;
        let params = VolumeParams { label, fix, handles: cut_handles };
        let found = Input::Label(self.volume(path, monitor)?.surface(&params, monitor)?);
        self.preparation.apply(found, monitor)
    }

    /// Returns a volume: the one read last if it is the same, else reads it from its file.
    ///
    /// # Errors
    ///
    /// Those of [`LabelVolume::read_with`].
    pub fn volume(&mut self, path: &Path, monitor: &dyn Monitor) -> Result<&LabelVolume, ParametrizeError> {
        let volume = match self.volume.take().filter(|volume| volume.path() == path) {
            Some(volume) => volume,
            None => LabelVolume::read_with(path, self.preparation.voxel_size, monitor)?,
        };
        Ok(self.volume.insert(volume))
    }
}
