//! Reads VRML 97 (`.wrl`), which segmentation programs write through VTK. All IndexedFaceSets of the scene are read,
//! and placed by their Transforms.
//!
//! `token` splits the text into words and brackets, `node` reads nodes, and `face_set` converts polygons to triangles.
//! Nodes whose contents depend on the viewer or are defined elsewhere (Switch, LOD, Inline, PROTO), and shapes that
//! aren't meshes, are rejected.
//!
//! Source: ISO/IEC 14772-1:1997, sections 5 and 6.

mod face_set;
mod node;
mod token;

use super::flaw::{Flaw, shown};
use crate::mesh::Mesh;

/// First bytes of a VRML 97 file.
const MAGIC: &[u8] = b"#VRML V2.0";

/// Returns whether the bytes begin like a VRML file.
pub(super) fn is_vrml(bytes: &[u8]) -> bool {
    bytes.starts_with(b"#VRML V")
}

/// Reads all face sets.
pub(super) fn read(bytes: &[u8]) -> Result<Mesh, Flaw> {
    if bytes.starts_with(b"#VRML V1.") {
        return Err(Flaw::unsupported("VRML 1.0", "save the surface as VRML 97 (2.0)"));
    }
    if !bytes.starts_with(MAGIC) {
        return Err(Flaw::new("#VRML V2.0", shown(bytes)));
    }
    node::read(bytes)
}
