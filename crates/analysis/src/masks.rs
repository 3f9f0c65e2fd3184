//! Reads masks of directions from per-vertex files, labels and groups. The mask of a group excludes the places that
//! have no counterpart on its members.

use std::path::{Path, PathBuf};

use anyhow::{Error, Result, anyhow, bail};
use spharm::correspond::GroupFiles;
use spharm_cli::output::counted;
use spharm_cli::paths::all_shown;
use spharm_surface::geometry::Vec3;
use spharm_surface::io::read_mask;
use spharm_surface::{Sphere, SurfaceError};

/// Intersection of several masks on the vertices of a sampling.
pub(super) struct Masks {
    /// Whether each vertex is within all masks; `None` without masks.
    pub(super) kept: Option<Vec<bool>>,
    /// Number of vertices without a counterpart on the members of a group, if a mask is a group.
    pub(super) without_counterpart: usize,
}

impl Masks {
    /// Reads each mask with [`read`], and combines the masks.
    pub(super) fn read(paths: &[PathBuf], sphere: &Sphere, sampling: &str, remedy: &str) -> Result<Self> {
        let mut masks = Self { kept: None, without_counterpart: 0 };
        for path in paths {
            let mask = read(path, sphere, sampling, remedy)?;
            if is_group(path) {
                masks.without_counterpart += mask.iter().filter(|kept| !**kept).count();
            }
            masks.kept = Some(match masks.kept.take() {
                Some(kept) => kept.iter().zip(&mask).map(|(kept, also)| *kept && *also).collect(),
                None => mask,
            });
        }
        if masks.kept.as_ref().is_some_and(|kept| !kept.contains(&true)) {
            bail!("{}: expected a vertex within all masks, found none", all_shown(paths).join(", "));
        }
        Ok(masks)
    }
}

/// Returns whether a mask is a group, given by its folder or its `group.json`.
pub(super) fn is_group(path: &Path) -> bool {
    path.is_dir() || path.file_name().is_some_and(|name| name == "group.json")
}

/// Returns, for each direction of a sphere, whether it is kept. If the mask is a group, the sphere may be any sphere.
/// All other masks are read by [`read_file`]. FreeSurfer labels and annotations are accepted only with the sphere to
/// which they belong, read from its file.
pub(super) fn read(path: &Path, sphere: &Sphere, sampling: &str, remedy: &str) -> Result<Vec<bool>> {
    let directions: &[Vec3] = sphere.directions.as_slice();
    if is_group(path) {
        let folder = if path.is_dir() { path } else { path.parent().unwrap_or(Path::new("")) };
        return Ok(GroupFiles::open(folder)?.template()?.kept_at(directions));
    }
    if sphere.path.is_none() && is_of_freesurfer(path) {
        bail!(
            "{}: expected a mask for the {} vertices of {sampling}, found a FreeSurfer label or annotation, \
             whose surface has other vertices; {remedy}",
            path.display(),
            directions.len()
        );
    }
    read_file(path, directions.len(), sampling, remedy)
}

/// Returns whether a mask is a label or an annotation of FreeSurfer. A label doesn't state the number of vertices of
/// its surface, and fsaverage5 has as many vertices as the default icosphere, but in another order.
pub fn is_of_freesurfer(mask: &Path) -> bool {
    mask.extension().is_some_and(|ending| ending == "label" || ending == "annot")
}

/// Reads a mask for the vertices of a sampling from a per-vertex file, a label or an annotation.
///
/// # Errors
///
/// If the mask can't be read, or belongs to another sphere. If it belongs to another sphere, the error states
/// `sampling` and `remedy`.
pub fn read_file(path: &Path, vertices: usize, sampling: &str, remedy: &str) -> Result<Vec<bool>> {
    read_mask(path, vertices).map_err(|error| {
        let expected = format!("expected a mask for the {vertices} vertices of {sampling}");
        match error {
            SurfaceError::VertexCount { found, .. } => {
                anyhow!("{}: {expected}, found one for {found}; {remedy}", path.display())
            }
            // A label doesn't state the number of vertices. In a label of another sphere, a vertex may be out of range.
            SurfaceError::Malformed { .. } => Error::from(error).context(format!("{expected} ({remedy})")),
            _ => error.into(),
        }
    })
}

/// Returns the name of a sampling for messages: the path of the sphere's file, or else a description of an icosphere.
pub fn sampling(sphere: Option<&Path>, subdivisions: u32) -> String {
    match sphere {
        Some(path) => path.display().to_string(),
        None => format!("an icosphere of {}", counted(subdivisions as usize, "subdivision")),
    }
}
