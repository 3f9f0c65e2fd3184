//! Reads surfaces from mesh files, or from labels of volumes.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use spharm::io::read_mesh;
use spharm::parametrize::volume::{LabelVolume, VolumeParams, VolumeReading};
use spharm::parametrize::{Input, ParametrizeError};
use spharm::{Error, Monitor, Preparation};

/// Reads surfaces, and repairs them and cuts their handles if requested. The volume that was read last is kept in
/// memory, because reading a volume is slow and its labels are usually read one after another. Several threads may
/// read at the same time.
#[derive(Debug)]
pub struct SurfaceReader {
    preparation: Preparation,
    /// The volume that was read last.
    volume: Mutex<Option<Arc<LabelVolume>>>,
    /// Warnings about the volumes read so far, each once.
    warnings: Mutex<Vec<String>>,
}

impl SurfaceReader {
    /// Creates a reader. If `preparation` requests no repairs or cuts, surfaces that need them are returned unchanged,
    /// and the fit refuses these surfaces.
    #[must_use]
    pub fn new(preparation: Preparation) -> Self {
        Self { preparation, volume: Mutex::default(), warnings: Mutex::default() }
    }

    /// Returns the settings for reading volumes.
    #[must_use]
    pub fn reading(&self) -> VolumeReading {
        self.preparation.reading
    }

    /// Reads a mesh, or the surface around a label.
    ///
    /// # Errors
    ///
    /// An error if the file can't be read, if the label has no closed surface of genus zero, or if the surface whose
    /// handles are to be cut isn't closed and connected.
    pub fn read(&self, path: &Path, label: Option<i64>, monitor: &dyn Monitor) -> Result<Input, Error> {
        if label.is_none() {
            return self.preparation.apply(Input::Mesh(read_mesh(path)?), monitor);
        }
        let Preparation { label_surface: surface, fix, cut_handles, .. } = self.preparation;
        let params = VolumeParams { label, surface, fix, handles: cut_handles };
        let found = Input::Label(self.volume(path, monitor)?.surface(&params, monitor)?);
        self.preparation.apply(found, monitor)
    }

    /// Returns the volume at `path`: the volume in memory if it has this path, otherwise the volume read from the file.
    ///
    /// # Errors
    ///
    /// [`ParametrizeError`] if the volume can't be read; see [`LabelVolume::read_with`].
    pub fn volume(&self, path: &Path, monitor: &dyn Monitor) -> Result<Arc<LabelVolume>, ParametrizeError> {
        // Threads that need the same volume wait until one of them has read it.
        let mut last = self.volume.lock().unwrap_or_else(PoisonError::into_inner);
        let volume = match last.take().filter(|volume| volume.path() == path) {
            Some(volume) => volume,
            None => {
                let volume = LabelVolume::read_with(path, self.preparation.reading, monitor)?;
                let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
                for warning in volume.warnings() {
                    if !warnings.contains(&warning) {
                        warnings.push(warning);
                    }
                }
                Arc::new(volume)
            }
        };
        Ok(last.insert(volume).clone())
    }

    /// Returns the warnings about the voxel sizes of all volumes read so far, see [`LabelVolume::warnings`].
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        self.warnings.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}
