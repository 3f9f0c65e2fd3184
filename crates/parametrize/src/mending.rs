//! Describes the repair that would turn a refused mesh into a closed surface.

use std::fmt;

use spharm_surface::repair::MeshRepair;

/// A repair that turns a mesh into a closed surface without defects, except that handles may remain.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Mending {
    /// The changes that the repair makes.
    pub repair: MeshRepair,
    /// Number of handles of the repaired mesh.
    pub handles: usize,
    /// Whether the repair drops a large part of the mesh that a wrap would keep, see
    /// [`would_wrap`](crate::wrap::would_wrap).
    pub wraps: bool,
}

impl fmt::Display for Mending {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let left = match self.handles {
            0 => String::new(),
            1 => ", which leaves 1 handle".to_owned(),
            handles => format!(", which leaves {handles} handles"),
        };
        write!(f, "a repair is possible{left}: {}", self.repair.changes())
    }
}
