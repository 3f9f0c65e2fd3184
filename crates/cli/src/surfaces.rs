//! Surfaces to work on: files, and labels of volumes.

use std::path::PathBuf;
use std::str::FromStr;

use anyhow::{Result, bail};
use spharm::Monitor;
use spharm::parametrize::volume::{LabelVolume, is_volume};

use crate::inputs::expand_lists;

/// `--label`: labels of a volume.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Labels {
    /// Every one.
    All,
    /// This one.
    One(i64),
}

impl FromStr for Labels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            _ => text.parse().map(Self::One).map_err(|_| "expected a whole number, or all".to_owned()),
        }
    }
}

/// Returns the surfaces that paths, lists and labels name: a file, or a file and a label of it. Without `labels` a volume
/// has to have a single one. Where surfaces are not to be made of volumes, every file stands for itself.
///
/// # Errors
///
/// When a list or volume can't be read, a label isn't there, or `labels` are asked of a file that isn't a volume.
pub fn surfaces(
    paths: &[PathBuf],
    labels: Option<Labels>,
    of_volumes: bool,
    monitor: &dyn Monitor,
) -> Result<Vec<(PathBuf, Option<i64>)>> {
    let mut surfaces = Vec::new();
    for path in expand_lists(paths)? {
        if !of_volumes || !is_volume(&path) {
            if labels.is_some() {
                bail!("{}: --label is for label volumes", path.display());
            }
            surfaces.push((path, None));
            continue;
        }
        let volume = LabelVolume::read(&path, monitor)?;
        let found: Vec<i64> = match labels {
            Some(Labels::All) => volume.labels().into_keys().collect(),
            Some(Labels::One(label)) => vec![volume.choose(Some(label))?],
            None => vec![volume.choose(None)?],
        };
        surfaces.extend(found.into_iter().map(|label| (path.clone(), Some(label))));
    }
    Ok(surfaces)
}
