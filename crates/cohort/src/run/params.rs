//! Surfaces to fit, and settings for all of them.

use std::path::PathBuf;

use spharm::{FitParams, Preparation, Sphere, Target};

use super::error::RunError;
use crate::evaluate::Evaluate;
use crate::rerun::IfExists;
use crate::{Manifest, Row, Shard};

/// Surfaces to fit.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct Cohort {
    /// The rows, in order.
    pub rows: Vec<Row>,
    /// The folder that models are relative to.
    pub folder: PathBuf,
    /// The sphere of all rows, if it has been read.
    pub sphere: Option<Sphere>,
    /// Whether to check all outputs before any work, so that a run that can't succeed doesn't begin; default false.
    pub check_first: bool,
}

impl Cohort {
    /// Creates a cohort of rows whose models are written to a folder.
    pub fn new(rows: Vec<Row>, folder: impl Into<PathBuf>) -> Self {
        Self { rows, folder: folder.into(), sphere: None, check_first: false }
    }

    /// Creates a cohort from a shard of a manifest. Models are written to `folder`, by default that of the manifest.
    #[must_use]
    pub fn of_manifest(manifest: Manifest, folder: Option<PathBuf>, shard: Shard) -> Self {
        let folder = folder.unwrap_or_else(|| manifest.folder().to_owned());
        let (index, count) = shard.index_and_count();
        let rows = manifest.rows.into_iter().skip(index).step_by(count);
        Self::new(rows.collect(), folder)
    }

    /// Sets the sphere's file for the rows without one.
    #[must_use]
    pub fn with_sphere(mut self, sphere: Option<PathBuf>) -> Self {
        for row in self.rows.iter_mut().filter(|row| row.sphere.is_none()) {
            row.sphere.clone_from(&sphere);
        }
        self
    }
}

/// Accepts or refuses a surface that was read over its sphere.
pub type Check = Box<dyn Fn(&Row, &Sphere, Result<Target, RunError>) -> Result<Target, RunError> + Send + Sync>;

/// Settings for all rows.
#[non_exhaustive]
pub struct RunParams {
    /// Settings of the fits.
    pub fit: FitParams,
    /// Changes to surfaces without a sphere before they are mapped; none by default.
    pub preparation: Preparation,
    /// A mask of the sphere's vertices: those with 0 in this file aren't read; none by default.
    pub mask: Option<PathBuf>,
    /// Whether to write the complex coefficients beside each model; default false.
    pub coefficients_csv: bool,
    /// Treatment of existing outputs; they are refused by default.
    pub if_exists: IfExists,
    /// Whether to continue with further rows after a failure; default true.
    pub keep_going: bool,
    /// The table of outcomes to append to; none by default.
    pub status: Option<PathBuf>,
    /// A check of each surface and its sphere; none by default.
    pub check: Option<Check>,
    /// A sphere on which every model is evaluated; none by default.
    pub evaluate: Option<Evaluate>,
}

impl RunParams {
    /// Creates settings with defaults for all but the fits.
    #[must_use]
    pub fn new(fit: FitParams) -> Self {
        Self {
            fit,
            preparation: Preparation::default(),
            mask: None,
            coefficients_csv: false,
            if_exists: IfExists::Refuse,
            keep_going: true,
            status: None,
            check: None,
            evaluate: None,
        }
    }
}
