//! The folder of the bases.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// A folder of bases.
pub(crate) struct Store {
    pub(crate) folder: PathBuf,
    /// Removes the folder when dropped.
    temporary: Option<tempfile::TempDir>,
}

impl Store {
    /// Opens a permanent folder, or creates a temporary one within `beside`.
    pub(crate) fn new(kept: Option<&Path>, beside: &Path) -> Result<Self> {
        if let Some(folder) = kept {
            let made = std::fs::create_dir_all(folder);
            made.with_context(|| format!("{}: cannot create the folder", folder.display()))?;
            return Ok(Self { folder: folder.to_owned(), temporary: None });
        }
        let temporary = tempfile::Builder::new().prefix(".store.").tempdir_in(beside);
        let temporary =
            temporary.with_context(|| format!("{}: cannot create a folder for the store", beside.display()))?;
        Ok(Self { folder: temporary.path().to_path_buf(), temporary: Some(temporary) })
    }

    /// Removes a basis from a temporary store, so that the store never holds more than one, and neither the disk nor
    /// the system's cache has to hold all of them.
    pub(crate) fn done_with(&self, basis: &Path) -> Result<()> {
        if self.temporary.is_some() {
            std::fs::remove_dir_all(basis).with_context(|| format!("{}: cannot remove", basis.display()))?;
        }
        Ok(())
    }
}
