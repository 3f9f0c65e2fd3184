//! Defines the result of cutting handles: the cut surface, and a report on the cuts.

use serde::Serialize;
use spharm_surface::{Mesh, Seam};

/// A surface of genus zero, made by cutting the handles of another surface.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CutSurface {
    /// The cut surface. Its vertices are the vertices of the given surface in their order, then the copies along the
    /// seams, then the vertices of the fillings. Its triangles are the triangles of the given surface in their order,
    /// then the triangles of the fillings; on one side of each seam, the corners of the given triangles are replaced by
    /// the copies.
    pub surface: Mesh,
    /// The seam, which relates the cut surface to the given surface; `None` if the given surface had no handle.
    pub seam: Option<Seam>,
    /// Report on the cuts.
    pub report: HandlesReport,
}

impl CutSurface {
    /// Records the seam in the metadata of a sphere with this surface's vertices and triangles, so that models over the
    /// sphere can be converted back to the given surface. A sphere with other triangles is left unchanged.
    pub fn mark(&self, sphere: &mut Mesh) {
        let same = sphere.vertices.len() == self.surface.vertices.len() && sphere.faces == self.surface.faces;
        if let Some(seam) = self.seam.as_ref().filter(|_| same) {
            seam.write_to(&mut sphere.meta);
        }
    }
}

/// Report on the cuts: the loops, and the area and the vertices that were added.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct HandlesReport {
    /// Number of handles of the given surface.
    pub genus_before: usize,
    /// Number of handles of the cut surface: 0.
    pub genus_after: usize,
    /// Total area of all fillings, in the square of the surface's unit.
    pub area_added: f64,
    /// Area of the given surface, in the square of its unit.
    pub area: f64,
    /// Number of vertices of the fillings.
    pub vertices_added: usize,
    /// The loops, one for each handle, in the order of the cuts.
    pub loops: Vec<CutLoop>,
}

/// A loop of edges along which the surface was cut.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CutLoop {
    /// Whether the cut severs a handle or plugs a tunnel.
    pub kind: Kind,
    /// Length of the loop, in the surface's unit.
    pub length: f64,
    /// Number of vertices of the loop.
    pub vertices: usize,
    /// Total area of the two fillings, in the square of the surface's unit.
    pub area_added: f64,
    /// Mean of the positions of the loop's vertices.
    pub centre: [f64; 3],
}

/// The kind of a cut: whether a film spanned across the loop lies inside or outside the surface (after T. K. Dey, F.
/// Fan and Y. Wang, "An efficient computation of handle and tunnel loops via Reeb graphs", ACM Trans. Graph. 32, 2013).
///
/// In the paper the kind is a property of the loop's homology class, computed from a graph. Here the kind is determined
/// by the side of the surface on which the film starts at the loop, on average. Both definitions agree if the film
/// stays on one side of the surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A film across the loop is inside the body: the cut severs a handle.
    Handle,
    /// A film across the loop is outside of the body: the cut plugs a tunnel.
    Tunnel,
}

impl Kind {
    /// Returns `Tunnel` for `Handle`, and `Handle` for `Tunnel`.
    pub(super) fn other(self) -> Self {
        match self {
            Self::Handle => Self::Tunnel,
            Self::Tunnel => Self::Handle,
        }
    }
}

impl std::fmt::Display for Kind {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Handle => "handle",
            Self::Tunnel => "tunnel",
        })
    }
}

impl std::fmt::Display for HandlesReport {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let count = |kind: Kind| self.loops.iter().filter(|found| found.kind == kind).count();
        let (handles, tunnels) = (count(Kind::Handle), count(Kind::Tunnel));
        let length =
            |pick: fn(f64, f64) -> f64| self.loops.iter().map(|found| found.length).reduce(pick).unwrap_or(0.0);
        let (short, long) = (length(f64::min), length(f64::max));
        write!(f, "genus reduced from {} to {}: ", self.genus_before, self.genus_after)?;
        match (handles, tunnels) {
            (handles, 0) => write!(f, "{} severed", counted(handles, "handle"))?,
            (0, tunnels) => write!(f, "{} plugged", counted(tunnels, "tunnel"))?,
            _ => write!(f, "{} severed, {} plugged", counted(handles, "handle"), counted(tunnels, "tunnel"))?,
        }
        if self.loops.len() == 1 {
            write!(f, " along a loop of length {short:.4}")?;
        } else {
            write!(f, " along loops of length {short:.4} to {long:.4}")?;
        }
        write!(f, "; filling the cuts adds {:.3} % to the area", 100.0 * self.area_added / self.area)
    }
}

fn counted(count: usize, one: &str) -> String {
    if count == 1 { format!("1 {one}") } else { format!("{count} {one}s") }
}
