//! Mirrors models before they are aligned, such as right hemispheres in a group of left hemispheres.

use std::path::PathBuf;

use anyhow::{Result, bail};
use spharm::Model;
use spharm::shape::Transform;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::same_place;

use super::args::files;

/// Returns, for each path, whether it is among the named files. A named file that isn't among the paths is an error.
pub(super) fn among(named: &[PathBuf], paths: &[PathBuf], what: &str) -> Result<Vec<bool>> {
    let mut found = vec![false; paths.len()];
    for file in named {
        match paths.iter().position(|path| same_place(path, file)) {
            Some(index) => found[index] = true,
            None => bail!("--mirrored: {}: not among the given {what}", file.display()),
        }
    }
    Ok(found)
}

/// For each model of a group, whether the model is mirrored.
pub(super) struct Mirrored(Vec<bool>);

impl Mirrored {
    /// Finds the named models, files or folders, among the models to align.
    ///
    /// # Errors
    ///
    /// If a named model doesn't exist or isn't among the models to align.
    pub(super) fn find(named: &[PathBuf], paths: &[PathBuf]) -> Result<Self> {
        among(&files(named)?, paths, "models").map(Self)
    }

    /// Mirrors the models that are marked as mirrored.
    pub(super) fn apply(&self, models: &mut [Model], monitor: &ConsoleMonitor) -> Result<()> {
        for (model, _) in models.iter_mut().zip(&self.0).filter(|(_, mirrored)| **mirrored) {
            *model = Transform::reflection().apply_model(model, monitor)?;
        }
        Ok(())
    }

    /// Converts transforms of the mirrored models to transforms of the models as they were read.
    pub(super) fn of_files(&self, transforms: &[Transform]) -> Vec<Transform> {
        let whole = |(transform, mirrored): (&Transform, &bool)| {
            if *mirrored { Transform::reflection().then(transform) } else { *transform }
        };
        transforms.iter().zip(&self.0).map(whole).collect()
    }
}
