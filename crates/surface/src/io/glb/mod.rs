//! Reads and writes glTF 2.0: scenes for viewers, as one binary file (`.glb`) or as JSON with all data embedded
//! (`.gltf`, read only).
//!
//! All triangles of the default scene become one surface, each mesh placed by its nodes. Viewers need a normal and
//! texture coordinates at each vertex, so exporters split a vertex if its normal or texture coordinates are
//! discontinuous. The reader merges vertices at equal positions again. Vertices in files written by this crate aren't
//! split, so they aren't merged and keep their order.
//!
//! `container` splits a file into its parts, `document` parses the JSON, `accessor` reads arrays, `primitive` converts
//! arrays to triangles, `scene` places meshes, and `write` writes files. Positions stay in the file's unit and axes. In
//! glTF, these are metres and a y axis that points upwards.
//!
//! Source: Khronos Group, glTF 2.0 specification, sections 3 and 4. The crate gltf isn't used, since only a scene's
//! meshes and their placement are needed.

mod accessor;
mod container;
mod document;
mod primitive;
mod scene;
mod write;

use super::budget::Budget;
use super::flaw::Flaw;
use super::weld::welded;
use crate::mesh::Mesh;
use container::Container;
use document::{Document, GENERATOR};
pub(super) use write::write;

/// Reads all triangles of the default scene.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    let container = Container::parse(bytes)?;
    let document = Document::parse(container.json)?;
    let buffers = container.buffers(&document)?;
    let mesh = scene::read(&document, &buffers, &mut Budget::of_file(bytes.len()))?;
    if mesh.faces.is_empty() {
        return Err(Flaw::new("at least one triangle in the scene", "none; points and lines aren't read"));
    }
    if document.asset.generator == GENERATOR { Ok(mesh) } else { welded(mesh) }
}
