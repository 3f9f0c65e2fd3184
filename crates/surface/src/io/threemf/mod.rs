//! Reads and writes 3MF, the format of 3D printing: a zip archive with XML.
//!
//! The archive's relationships name the model. Its build places objects; an object is a mesh, or components that place
//! other objects, perhaps of another part of the archive (production extension). All placed objects become one surface.
//! Coordinates stay as they are, whatever the model's unit, as in other formats, whose files don't state one.
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

/// Reads all objects that are to be printed.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    build::read(Package::open(bytes)?)
}
