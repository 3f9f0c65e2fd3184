//! The settings of rows that have weights of their own, or a mask.

use std::path::Path;

use anyhow::{Result, bail};
use spharm::cohort::Row;
use spharm::{FitParams, Sphere, Weights};

use super::unread;
use super::work::Work;

impl Work<'_> {
    /// The settings with a row's own weights.
    pub(super) fn params(&self, row: &Row) -> Result<FitParams> {
        let params = self.options.params.clone();
        let read = |path: &Path| -> Result<Weights> {
            if !path.exists() {
                let path = path.display();
                bail!("column weights: expected uniform, area or a file, found {path}, which isn't there");
            }
            Ok(Weights::read(path)?)
        };
        let weights = match row.weights.as_deref().map(|path| (path, path.to_str())) {
            None => return Ok(params),
            Some((_, Some("uniform"))) => Ok(Weights::Uniform),
            Some((_, Some("area"))) => Ok(Weights::Area),
            Some((path, _)) => read(path),
        };
        match weights {
            Ok(weights) => Ok(FitParams { weights, ..params }),
            // Each row is named with what becomes of it, where failures don't end the call.
            Err(error) if self.options.cohort.keep_going => Err(error),
            Err(error) => Err(error.context(row.id.clone())),
        }
    }

    /// The settings with the weights that a mask leaves.
    pub(super) fn masked(&self, params: FitParams, sphere: Option<&Sphere>) -> Result<FitParams> {
        match (&self.options.mask, sphere) {
            (Some(mask), Some(sphere)) => {
                Ok(FitParams { weights: unread::masked(&params.weights, mask, sphere)?, ..params })
            }
            _ => Ok(params),
        }
    }
}
