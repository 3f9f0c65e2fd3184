//! Stores registrations while a group is computed, so that an interrupted run can be resumed.
//!
//! | file | contents |
//! |---|---|
//! | `key.json` | the group's inputs and settings: a folder with a different key is refused |
//! | `R-I.npz` | round R, surface I: `vertices` (n, 3); `reached` (n, 1), 1 or 0; `numbers`: cover, flipped triangles, distances of left-out landmarks |
//!
//! An unreadable file is treated as missing: its registration is repeated.

use std::path::{Path, PathBuf};

use ndarray::{Array2, ArrayView2, aview1};
use spharm_model::arrays::{Arrays, Entry, write_arrays};
use spharm_register::{Cover, Registered};
use spharm_surface::io::write_new;

use crate::Error;

/// Number of values in `numbers` that precede the distances of landmarks.
const NUMBERS: usize = 5;
/// Maximum size of a key in bytes.
const MOST: u64 = 64 << 20;

/// A folder in which registrations are stored.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Resume {
    folder: PathBuf,
}

impl Resume {
    /// Opens or creates a folder. `key` identifies the group's surfaces, by their hashes, and the group's settings.
    ///
    /// # Errors
    ///
    /// [`Error::GroupFile`] if the folder has a different key or contains unrelated files; [`Error::Surface`] if it
    /// can't be read or written.
    pub fn open(folder: &Path, key: &str) -> Result<Self, Error> {
        let path = folder.join("key.json");
        let io = |action| {
            move |cause| Error::from(spharm_surface::SurfaceError::Io { path: folder.to_owned(), action, cause })
        };
        let refused = |expected: &str, found: &str| {
            let (expected, found) = (expected.to_owned(), found.to_owned());
            Err(Error::GroupFile { path: path.clone(), expected, found })
        };
        if path.exists() {
            if spharm_files::read(&path, MOST).map_err(io("read"))? != key.as_bytes() {
                return refused(
                    "registrations of these surfaces with these settings",
                    "registrations of other surfaces or with other settings; remove the folder, or choose another \
                     folder",
                );
            }
        } else {
            std::fs::create_dir_all(folder).map_err(io("create"))?;
            if std::fs::read_dir(folder).map_err(io("read"))?.next().is_some() {
                return refused("a new folder, or a folder of registrations", "a folder with other files");
            }
            write_new(&path, false, |out| out.write_all(key.as_bytes()))?;
        }
        Ok(Self { folder: folder.to_owned() })
    }

    /// Removes the folder.
    ///
    /// # Errors
    ///
    /// [`Error::Surface`] if it can't be removed.
    pub fn remove(self) -> Result<(), Error> {
        let Self { folder: path } = self;
        std::fs::remove_dir_all(&path)
            .map_err(|cause| spharm_surface::SurfaceError::Io { path, action: "remove", cause }.into())
    }

    fn path(&self, round: usize, index: usize) -> PathBuf {
        self.folder.join(format!("{round}-{index}.npz"))
    }

    /// Reads a stored registration of a template with n vertices, and the distances of left-out landmarks. `landmarks`
    /// is the number of left-out landmarks. Returns `None` if the file is missing or unreadable.
    pub(super) fn read(
        &self,
        round: usize,
        index: usize,
        (n, landmarks): (usize, usize),
    ) -> Option<(Registered, Vec<f64>)> {
        let mut arrays = Arrays::open(&self.path(round, index)).ok()?;
        let mut matrix = |name: &str, shape: (usize, usize)| -> Option<Array2<f64>> {
            arrays.matrix(name).ok().filter(|found| found.dim() == shape && found.iter().all(|value| value.is_finite()))
        };
        let (vertices, reached) = (matrix("vertices", (n, 3))?, matrix("reached", (n, 1))?);
        let numbers = matrix("numbers", (1, NUMBERS + landmarks))?;
        let [rms, most, farthest, unreached, turned] = std::array::from_fn(|k| numbers[[0, k]]);
        let registered = Registered {
            vertices: vertices.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect(),
            reached: reached.iter().map(|value| *value == 1.0).collect(),
            cover: Cover { rms, most, farthest, unreached },
            turned: turned as usize,
        };
        Some((registered, numbers.iter().skip(NUMBERS).copied().collect()))
    }

    /// Stores a registration.
    pub(super) fn write(&self, round: usize, index: usize, found: &Registered, left_out: &[f64]) -> Result<(), Error> {
        let Registered { vertices, reached, cover, turned } = found;
        let reached: Vec<f64> = reached.iter().map(|reached| f64::from(u8::from(*reached))).collect();
        let mut numbers = vec![cover.rms, cover.most, cover.farthest, cover.unreached, *turned as f64];
        numbers.extend(left_out);
        let path = self.path(round, index);
        let invalid = |error: ndarray::ShapeError| spharm_model::ModelError::Invalid {
            path: path.clone(),
            problem: error.to_string(),
        };
        let vertices = ArrayView2::from_shape((vertices.len(), 3), vertices.as_flattened()).map_err(invalid)?;
        let (reached, numbers) = (aview1(&reached), aview1(&numbers));
        let column = reached.view().into_shape_with_order((reached.len(), 1)).map_err(invalid)?;
        let row = numbers.view().into_shape_with_order((1, numbers.len())).map_err(invalid)?;
        let entries = [
            ("vertices", Entry::Matrix(vertices)),
            ("reached", Entry::Matrix(column)),
            ("numbers", Entry::Matrix(row)),
        ];
        Ok(write_arrays(&path, true, &entries)?)
    }
}
