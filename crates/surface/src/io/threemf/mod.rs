//! Reads and writes 3MF, the format of 3D printing: a zip archive with XML.
//!
//! The archive's relationships state the path of the model. The model's build places objects. An object is a mesh, or
//! consists of components that place other objects, which may be in another part of the archive (production extension).
//! All placed objects become one surface. Coordinates aren't converted from the model's unit, since other formats don't
//! specify a unit.
//!
//! `package` reads parts of the archive, `model` parses a part, `build` places objects, and `write` writes files.
//!
//! Source: 3MF Consortium, 3MF Core Specification 1.3, chapters 2 to 4, and Production Extension 1.1.

mod build;
mod model;
mod names;
mod package;
mod write;

use super::flaw::Flaw;
use crate::mesh::Mesh;
use package::Package;
pub(super) use write::write;

/// Reads all objects that the build places, as one surface.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    build::read(Package::open(bytes)?)
}
