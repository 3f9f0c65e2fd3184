//! Lists the surfaces that arguments name: mesh files, and labels of volumes.

use std::collections::{BTreeMap, HashSet};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Result, bail};
use spharm::Monitor;
use spharm::parametrize::volume::{VolumeReading, is_volume};
use spharm_cohort::reader::SurfaceReader;

/// A value of `--label`: one label of a volume, or all.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Labels {
    /// All labels.
    All,
    /// A single label.
    One(i64),
}

impl Labels {
    /// Returns the chosen labels, each once, in the order given; if `all` is among them, all labels of the volume.
    /// `there` maps each label of the volume to its number of voxels. Chosen labels that the volume doesn't contain are
    /// also returned.
    #[must_use]
    pub fn of(chosen: &[Self], there: &BTreeMap<i64, usize>) -> Vec<i64> {
        if chosen.contains(&Self::All) {
            return there.keys().copied().collect();
        }
        let one = |label: &Self| if let Self::One(label) = label { Some(*label) } else { None };
        let mut seen = HashSet::new();
        chosen.iter().filter_map(one).filter(|label| seen.insert(*label)).collect()
    }
}

impl FromStr for Labels {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "all" => Ok(Self::All),
            _ => text
                .parse()
                .map(Self::One)
                .map_err(|_| "expected a whole number, or all; give files before --label".to_owned()),
        }
    }
}

/// Value of `--voxel-size`: the voxel's size along x, y and z.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoxelSize(pub [f64; 3]);

impl FromStr for VoxelSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let sizes: Option<Vec<f64>> = text.split(',').map(|size| size.trim().parse().ok()).collect();
        let sizes = sizes.and_then(|sizes| <[f64; 3]>::try_from(sizes).ok());
        let valid = sizes.filter(|sizes| sizes.iter().all(|size| size.is_finite() && *size > 0.0));
        valid.map(Self).ok_or_else(|| "expected three positive numbers, X,Y,Z".to_owned())
    }
}

/// Refuses labels and volume settings for a file that isn't a volume.
///
/// # Errors
///
/// If labels or volume settings are given.
pub fn refuse_for_mesh(path: &Path, labels: &[Labels], reading: VolumeReading) -> Result<()> {
    if labels.is_empty() && reading == VolumeReading::default() {
        return Ok(());
    }
    bail!(
        "{}: --label, --channel, --time, --voxel-size, --axes, --threshold and --probability are for volumes (.nii, \
         .mgz, .nrrd, .tif, .npy)",
        path.display()
    )
}

/// Returns the surfaces that paths and labels name. Each surface is a file, or a file with one of its labels. Without
/// `labels`, a volume must have a single label. If `of_volumes` is false, volumes are treated like any other file and
/// returned without a label. The reader's volume settings are refused for files that aren't volumes.
///
/// # Errors
///
/// If a path is a folder, a volume can't be read, a label is missing, or `labels` or volume settings are given for a
/// file that isn't a volume.
pub fn surfaces(
    reader: &SurfaceReader,
    paths: &[PathBuf],
    labels: &[Labels],
    of_volumes: bool,
    monitor: &dyn Monitor,
) -> Result<Vec<(PathBuf, Option<i64>)>> {
    let mut surfaces = Vec::new();
    for path in paths {
        if path.is_dir() {
            bail!(
                "{}: this path is a folder; give the files in the folder, or a list of paths as @LIST",
                path.display()
            );
        }
        if !of_volumes || !is_volume(path) {
            refuse_for_mesh(path, labels, reader.reading())?;
            surfaces.push((path.clone(), None));
            continue;
        }
        let volume = reader.volume(path, monitor)?;
        let found: Vec<i64> = match labels {
            [] => vec![volume.choose(None)?],
            labels => {
                let chosen = Labels::of(labels, &volume.labels());
                chosen.into_iter().map(|label| volume.choose(Some(label))).collect::<Result<_, _>>()?
            }
        };
        surfaces.extend(found.into_iter().map(|label| (path.clone(), Some(label))));
    }
    Ok(surfaces)
}
