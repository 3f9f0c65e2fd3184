//! Defines the rows of a run, and the settings that apply to all rows.

use std::path::PathBuf;

use spharm::{FitParams, Preparation, Sphere, Target};

use super::error::RunError;
use crate::evaluate::Evaluate;
use crate::rerun::IfExists;
use crate::{Manifest, Row, Shard};

/// The surfaces to fit, and the folder for their models.
#[derive(Debug, Clone, Default)]
#[non_exhaustive]
pub struct Cohort {
    /// The rows, in the order in which they are processed.
    pub rows: Vec<Row>,
    /// Folder to which the paths of models are relative.
    pub folder: PathBuf,
    /// The common sphere of all rows, if the caller has already read it.
    pub sphere: Option<Sphere>,
    /// Whether to check the outputs of all rows before fitting, so that a run that can't succeed doesn't start; false
    /// by default.
    pub check_first: bool,
}

impl Cohort {
    /// Creates a cohort whose models are written to a folder.
    pub fn new(rows: Vec<Row>, folder: impl Into<PathBuf>) -> Self {
        Self { rows, folder: folder.into(), sphere: None, check_first: false }
    }

    /// Creates a cohort from the rows of a manifest that belong to a shard. Models are written to `folder`, or to the
    /// manifest's folder if `folder` is `None`.
    #[must_use]
    pub fn of_manifest(manifest: Manifest, folder: Option<PathBuf>, shard: Shard) -> Self {
        let folder = folder.unwrap_or_else(|| manifest.folder().to_owned());
        let (index, count) = shard.index_and_count();
        let rows = manifest.rows.into_iter().skip(index).step_by(count);
        Self::new(rows.collect(), folder)
    }

    /// Sets the path of the sphere for all rows without a sphere.
    #[must_use]
    pub fn with_sphere(mut self, sphere: Option<PathBuf>) -> Self {
        for row in self.rows.iter_mut().filter(|row| row.sphere.is_none()) {
            row.sphere.clone_from(&sphere);
        }
        self
    }
}

/// A function, supplied by the caller, that accepts, changes or refuses a surface after it has been read together with
/// its sphere.
pub type Check = Box<dyn Fn(&Row, &Sphere, Result<Target, RunError>) -> Result<Target, RunError> + Send + Sync>;

/// Settings that apply to all rows.
#[non_exhaustive]
pub struct RunParams {
    /// Settings of the fits.
    pub fit: FitParams,
    /// Changes to make to surfaces without a sphere before they are mapped; none by default.
    pub preparation: Preparation,
    /// Path of a mask of the sphere's vertices. The fit ignores vertices at which the mask is 0. `None` by default.
    pub mask: Option<PathBuf>,
    /// Whether to write the complex coefficients as CSV beside each model; false by default.
    pub coefficients_csv: bool,
    /// Treatment of existing outputs. By default, the fit is refused if outputs exist.
    pub if_exists: IfExists,
    /// Whether to continue with the next row after a failure; true by default.
    pub keep_going: bool,
    /// Path of the table to which outcomes are appended; `None` by default.
    pub status: Option<PathBuf>,
    /// Checks each surface for which a sphere is given; `None` by default.
    pub check: Option<Check>,
    /// A common sphere on which every model is evaluated; `None` by default.
    pub evaluate: Option<Evaluate>,
}

impl RunParams {
    /// Creates settings with the given settings of the fits and defaults for all other fields.
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
