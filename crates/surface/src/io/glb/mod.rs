//! Reads and writes glTF 2.0: scenes for viewers, as one binary file (`.glb`) or as JSON (`.gltf`, read only) with all
//! data in it.
//!
//! All triangles of the default scene become one surface, each mesh placed by its nodes. Viewers need a normal and
//! texture coordinates at each vertex, so exporters split vertices where these jump; the reader merges vertices at
//! equal positions again. Files of our own writer aren't split, and keep all their vertices in order.
//!
//! `container` takes the file apart, `document` is the JSON, `accessor` reads arrays, `primitive` makes triangles of
//! them, `scene` places meshes, and `write` writes files. Positions stay in the file's unit and axes (in glTF metres, y
//! upwards).
//!
//! Source: Khronos Group, glTF 2.0 specification, sections 3 and 4. The crate gltf isn't used: a scene's meshes and
//! their placement are a small part of it.

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
    if document.asset.generator == GENERATOR { Ok(mesh) } else { welded(mesh) }
}
