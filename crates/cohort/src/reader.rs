//! Reads surfaces from mesh files, or from labels of volumes.

use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use spharm::io::read_mesh;
use spharm::parametrize::volume::{LabelVolume, VolumeDoubts, VolumeParams, VolumeReading};
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
    /// Doubts about the voxel sizes and positions of the volumes read so far.
    doubts: Mutex<VolumeDoubts>,
}

impl SurfaceReader {
    /// Creates a reader. If `preparation` requests no repairs or cuts, surfaces that need them are returned unchanged,
    /// and the fit refuses these surfaces.
    #[must_use]
    pub fn new(preparation: Preparation) -> Self {
        Self { preparation, volume: Mutex::default(), doubts: Mutex::default() }
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
                self.doubts.lock().unwrap_or_else(PoisonError::into_inner).add(path, &volume.doubts());
                Arc::new(volume)
            }
        };
        Ok(last.insert(volume).clone())
    }

    /// Returns warnings about doubtful voxel sizes and positions of the volumes read so far, one warning for each kind
    /// of doubt (see [`LabelVolume::doubts`]).
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        self.doubts.lock().unwrap_or_else(PoisonError::into_inner).warnings()
    }
}

#[cfg(test)]
mod tests {
    use spharm::Silent;

    use super::*;

    /// Returns a NIfTI-1 file of 2 x 2 x 2 voxels with label 1, whose header has neither an sform nor a qform.
    fn without_forms() -> Vec<u8> {
        let mut bytes = vec![0; 352];
        bytes[..4].copy_from_slice(&348_i32.to_le_bytes());
        for (k, n) in [3_i16, 2, 2, 2, 1, 1, 1, 1].into_iter().enumerate() {
            bytes[40 + 2 * k..42 + 2 * k].copy_from_slice(&n.to_le_bytes());
        }
        (bytes[70], bytes[72]) = (2, 8);
        for k in 0..4 {
            bytes[76 + 4 * k..80 + 4 * k].copy_from_slice(&1.0_f32.to_le_bytes());
        }
        bytes[108..112].copy_from_slice(&352.0_f32.to_le_bytes());
        bytes[344..348].copy_from_slice(b"n+1\0");
        bytes.extend([1; 8]);
        bytes
    }

    #[test]
    fn doubts_of_one_kind_about_several_volumes_share_a_warning() {
        let folder = tempfile::tempdir().unwrap();
        let reader = SurfaceReader::new(Preparation::default());
        // The first volume is read twice, because the reader only keeps the last one.
        for name in ["a", "b", "c", "d", "e", "a"] {
            let path = folder.path().join(format!("{name}.nii"));
            std::fs::write(&path, without_forms()).unwrap();
            reader.volume(&path, &Silent).unwrap();
        }
        let [only] = &reader.warnings()[..] else { panic!("{:?}", reader.warnings()) };
        assert!(only.starts_with("5 volumes, such as ") && only.contains("c.nii: the header has neither"), "{only}");
    }
}
