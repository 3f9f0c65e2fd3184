//! What is to be mapped: a mesh, or the surface around a label of a volume.

use std::borrow::Cow;
use std::path::Path;

use anyhow::{Context, Result, bail};
use serde::Serialize;
use spharm_parametrize::volume::{LabelVolume, QuadMesh, Repair, VolumeParams, surface_of};
use spharm_surface::Mesh;
use spharm_surface::io::read_mesh;

/// The input, read.
// One of these exists; a box would only be in the way.
#[expect(clippy::large_enum_variant)]
pub(crate) enum Input {
    /// A mesh.
    Mesh(Mesh),
    /// The surface around a label, in mm.
    Volume(QuadMesh, Label),
}

/// Which label it was.
#[derive(Debug, Serialize)]
pub(crate) struct Label {
    label: i64,
    voxels: usize,
    /// What `--fix` changed, if anything.
    pub(crate) repair: Option<Repair>,
}

impl Input {
    /// Reads a volume where the name says so, else a mesh.
    pub(crate) fn read(path: &Path, label: Option<i64>, fix: bool) -> Result<Self> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
        if ![".nii", ".nii.gz"].iter().any(|ending| name.ends_with(ending)) {
            if label.is_some() || fix {
                bail!("{}: --label and --fix are for volumes (.nii, .nii.gz)", path.display());
            }
            return Ok(Self::Mesh(read_mesh(path)?));
        }
        let volume = LabelVolume::read(path)?;
        let found = surface_of(&volume, &VolumeParams { label, fix }).with_context(|| path.display().to_string())?;
        Ok(Self::Volume(found.quads, Label { label: found.label, voxels: found.voxels, repair: found.repair }))
    }

    /// The surface as triangles.
    pub(crate) fn mesh(&self) -> Cow<'_, Mesh> {
        match self {
            Self::Mesh(mesh) => Cow::Borrowed(mesh),
            Self::Volume(quads, _) => Cow::Owned(quads.triangles(|_| false)),
        }
    }

    /// Of a volume.
    pub(crate) fn label(&self) -> Option<&Label> {
        match self {
            Self::Mesh(_) => None,
            Self::Volume(_, label) => Some(label),
        }
    }

    /// What was read, a line each.
    pub(crate) fn notes(&self, path: &Path) -> Vec<String> {
        let path = path.display();
        match self {
            Self::Mesh(mesh) => {
                vec![format!("{path}: {} vertices, {} triangles", mesh.vertices.len(), mesh.faces.len())]
            }
            Self::Volume(quads, Label { label, voxels, .. }) => {
                let (vertices, faces) = (quads.vertices.len(), quads.quads.len());
                vec![format!("{path}: label {label}, {voxels} voxels; {vertices} vertices, {faces} quadrangles")]
            }
        }
    }
}
