//! Accepts surfaces as passed from Python.

use std::path::PathBuf;

use pyo3::prelude::*;
use spharm::io::read_mesh;
use spharm::parametrize::volume::{LabelVolume, is_volume};
use spharm::{Error, Mesh, Silent};

use crate::arrays::{Faces, Positions, mesh};
use crate::errors::Failure;
use crate::metadata::{Metadata, with_metadata};

/// A surface as passed from Python: the path of a file, or vertices, triangles and the metadata of the surface's file.
#[derive(FromPyObject)]
#[expect(clippy::large_enum_variant, reason = "a value lives only until its surface has been converted")]
pub(crate) enum Given<'py> {
    File(PathBuf),
    Arrays(Positions<'py>, Faces<'py>, Option<Metadata>),
}

/// A surface that doesn't depend on the interpreter's data. Files are read when they are needed, so that a group need
/// not fit into memory.
pub(crate) enum Source {
    File(PathBuf),
    Mesh(Box<Mesh>),
}

impl Given<'_> {
    pub(crate) fn source(self, what: &str) -> PyResult<Source> {
        Ok(match self {
            Self::File(path) => Source::File(path),
            Self::Arrays(vertices, faces, metadata) => {
                Source::Mesh(Box::new(with_metadata(mesh(what, &vertices, &faces)?, metadata)))
            }
        })
    }
}

impl Source {
    pub(crate) fn read(&self) -> Result<Mesh, Error> {
        match self {
            Self::File(path) if is_volume(path) => {
                Ok(LabelVolume::read(path, &Silent)?.smooth_surface(None, None, &Silent)?)
            }
            Self::File(path) => Ok(read_mesh(path)?),
            Self::Mesh(mesh) => Ok(Mesh::clone(mesh)),
        }
    }
}

pub(crate) fn sources(given: Vec<Given<'_>>, names: &[String]) -> PyResult<Vec<Source>> {
    given.into_iter().zip(names).map(|(given, name)| given.source(name)).collect()
}

/// Adds the name of the surface to an error that concerns one member of a group.
pub(crate) fn named(names: &[String], error: Error) -> Failure {
    match error {
        Error::Member { index, source } => Failure::Member { name: names[index].clone(), error: source },
        error => Failure::Library(error),
    }
}
