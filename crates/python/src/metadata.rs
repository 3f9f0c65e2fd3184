//! Converts the metadata of surfaces' files.

use std::path::Path;

use pyo3::prelude::*;
use spharm::Mesh;
use spharm::io::gifti_metadata;
use spharm_surface::{CoordinateSystem, Meta};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(of_point_set, module)?)?;
    Ok(())
}

/// Metadata of a surface's file, a dict in Python: the fields of [`Meta`], and the file's path.
#[derive(Clone, FromPyObject, IntoPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct Metadata {
    structure: Option<String>,
    file: Vec<(String, String)>,
    surface: Vec<(String, String)>,
    /// GIfTI's coordinate system: the names of two spaces, and the 4 x 4 transform from the first space to the second.
    coordinate_system: Option<(String, String, [f64; 16])>,
    stamp: Option<String>,
    footer: Option<Vec<u8>>,
    /// Path of the file, whose name may indicate the hemisphere.
    path: Option<String>,
}

impl Metadata {
    /// Returns the metadata of a mesh that was read from a file or made from a model; `None` if the mesh has no
    /// metadata.
    pub(crate) fn of(meta: Meta, path: Option<&Path>) -> Option<Self> {
        if meta == Meta::default() && path.is_none() {
            return None;
        }
        let system = meta.coordinate_system;
        Some(Self {
            structure: meta.anatomical_structure_primary,
            file: meta.file_metadata,
            surface: meta.surface_metadata,
            coordinate_system: system.map(|system| (system.data_space, system.transformed_space, system.matrix)),
            stamp: meta.freesurfer_stamp,
            footer: meta.freesurfer_footer,
            path: path.map(|path| path.to_string_lossy().into_owned()),
        })
    }

    /// Returns the path of the file from which the surface or signal was read.
    pub(crate) fn path(&self) -> Option<&Path> {
        self.path.as_deref().map(Path::new)
    }

    /// Returns GIfTI's `AnatomicalStructurePrimary`.
    pub(crate) fn structure(&self) -> Option<&str> {
        self.structure.as_deref()
    }
}

impl From<Metadata> for Meta {
    fn from(metadata: Metadata) -> Self {
        let system = metadata.coordinate_system;
        Self {
            anatomical_structure_primary: metadata.structure,
            file_metadata: metadata.file,
            surface_metadata: metadata.surface,
            coordinate_system: system.map(|(data_space, transformed_space, matrix)| CoordinateSystem {
                data_space,
                transformed_space,
                matrix,
            }),
            freesurfer_stamp: metadata.stamp,
            freesurfer_footer: metadata.footer,
        }
    }
}

/// Returns a mesh with the metadata given from Python.
pub(crate) fn with_metadata(mesh: Mesh, metadata: Option<Metadata>) -> Mesh {
    Mesh { meta: metadata.map(Meta::from).unwrap_or_default(), ..mesh }
}

/// Returns the metadata that are written to a GIfTI file for the point set of a surface.
#[pyfunction]
fn of_point_set(metadata: Metadata) -> Vec<(String, String)> {
    gifti_metadata(&Meta::from(metadata))
}
