//! Manages the folder in which bases are stored, which may be temporary.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

/// A folder that holds bases.
pub(crate) struct Store {
    pub(crate) folder: PathBuf,
    /// Handle that removes the temporary folder when dropped; `None` for a permanent folder.
    temporary: Option<tempfile::TempDir>,
}

impl Store {
    /// Opens the permanent folder `kept`, or creates a temporary folder within `beside`.
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

    /// Removes a basis from a temporary store, so that the store holds only one basis at a time. This limits the
    /// space needed on disk and in the system's file cache.
    pub(crate) fn done_with(&self, basis: &Path) -> Result<()> {
        if self.temporary.is_some() {
            std::fs::remove_dir_all(basis).with_context(|| format!("{}: cannot remove the folder", basis.display()))?;
        }
        Ok(())
    }
}
