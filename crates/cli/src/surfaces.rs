//! Surfaces to work on: files, and labels of volumes.

use std::path::{Path, PathBuf};
use std::str::FromStr;

use anyhow::{Result, bail};
use spharm::Monitor;
use spharm::parametrize::Input;
use spharm::parametrize::volume::{LabelVolume, VolumeParams, is_volume};
use spharm_surface::io::read_mesh;

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

/// `--voxel-size`: sizes along x, y, z.
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

/// Finds and reads surfaces: meshes, and labels of volumes. A volume takes a while to read and is kept until the next
/// one.
#[derive(Debug)]
pub struct SurfaceReader {
    fix: bool,
    cut_handles: bool,
    voxel_size: Option<[f64; 3]>,
    /// The volume that was read last.
    volume: Option<LabelVolume>,
}

impl SurfaceReader {
    /// A reader that repairs labels and meshes with `fix`, and cuts their handles with `cut_handles`, in place of
    /// leaving them to be refused. `voxel_size` is for volumes, in place of what they say of it.
    pub fn new(fix: bool, cut_handles: bool, voxel_size: Option<VoxelSize>) -> Self {
        Self { fix, cut_handles, voxel_size: voxel_size.map(|size| size.0), volume: None }
    }

    /// Returns the surfaces that paths, lists and labels name: a file, or a file and a label of it. Without `labels` a
    /// volume has to have a single one. Where surfaces are not to be made of volumes, every file stands for itself.
    ///
    /// # Errors
    ///
    /// When a list or volume can't be read, a label isn't there, or `labels` or a repair are asked of a file that isn't
    /// a volume.
    pub fn surfaces(
        &mut self,
        paths: &[PathBuf],
        labels: Option<Labels>,
        of_volumes: bool,
        monitor: &dyn Monitor,
    ) -> Result<Vec<(PathBuf, Option<i64>)>> {
        let mut surfaces = Vec::new();
        for path in expand_lists(paths)? {
            if path.is_dir() {
                bail!("{}: is a folder: give its files or @LIST", path.display());
            }
            if !of_volumes || !is_volume(&path) {
                if labels.is_some() || self.voxel_size.is_some() {
                    bail!(
                        "{}: --label and --voxel-size are for volumes (.nii, .mgz, .nrrd, .tif, .npy)",
                        path.display()
                    );
                }
                surfaces.push((path, None));
                continue;
            }
            let volume = self.volume(&path, monitor)?;
            let found: Vec<i64> = match labels {
                Some(Labels::All) => volume.labels().into_keys().collect(),
                Some(Labels::One(label)) => vec![volume.choose(Some(label))?],
                None => vec![volume.choose(None)?],
            };
            surfaces.extend(found.into_iter().map(|label| (path.clone(), Some(label))));
        }
        Ok(surfaces)
    }

    /// Reads a mesh, or the surface around a label.
    ///
    /// # Errors
    ///
    /// When the file can't be read, or the label has no closed surface of genus zero, or what is to be cut isn't one
    /// closed surface.
    pub fn read(&mut self, path: &Path, label: Option<i64>, monitor: &dyn Monitor) -> Result<Input> {
        if label.is_none() {
            let mesh = Input::Mesh(read_mesh(path)?);
            let mesh = if self.fix { mesh.mended() } else { mesh };
            return Ok(if self.cut_handles { mesh.without_handles(monitor)? } else { mesh });
        }
        let params = VolumeParams { label, fix: self.fix, handles: self.cut_handles };
        let found = Input::Label(self.volume(path, monitor)?.surface(&params, monitor)?);
        Ok(if self.cut_handles { found.without_handles(monitor)? } else { found })
    }

    /// Returns a volume: the one that was read last, or from its file.
    ///
    /// # Errors
    ///
    /// Those of [`LabelVolume::read_with`].
    pub fn volume(&mut self, path: &Path, monitor: &dyn Monitor) -> Result<&LabelVolume> {
        let volume = match self.volume.take().filter(|volume| volume.path() == path) {
            Some(volume) => volume,
            None => LabelVolume::read_with(path, self.voxel_size, monitor)?,
        };
        Ok(self.volume.insert(volume))
    }
}
