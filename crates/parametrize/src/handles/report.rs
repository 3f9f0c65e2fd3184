//! Report on the cuts.

use serde::Serialize;
use spharm_surface::{Mesh, Seam};

/// A surface of genus zero, cut from one with handles.
#[derive(Clone, Debug)]
#[non_exhaustive]
pub struct CutSurface {
    /// The surface's vertices in their order, copies of those on the seams, and the fillings' vertices; its triangles
    /// in their order, over copies on one side of each seam, and the fillings' triangles.
    pub surface: Mesh,
    /// The copies and the fillings; `None` if there was no handle.
    pub seam: Option<Seam>,
    /// Report on the cuts.
    pub report: HandlesReport,
}

impl CutSurface {
    /// Records the seam in the metadata of a sphere that has this surface's vertices and triangles, so that models over
    /// it can be converted back to the original surface. A sphere with another sampling is left unchanged.
    pub fn mark(&self, sphere: &mut Mesh) {
        let same = sphere.vertices.len() == self.surface.vertices.len() && sphere.faces == self.surface.faces;
        if let Some(seam) = self.seam.as_ref().filter(|_| same) {
            seam.write_to(&mut sphere.meta);
        }
    }
}

/// The cuts and the parts added.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[non_exhaustive]
pub struct HandlesReport {
    /// Handles of the given surface.
    pub genus_before: usize,
    /// Handles of the cut surface: 0.
    pub genus_after: usize,
    /// Area of the fillings of both sides of all cuts, in the surface's unit squared.
    pub area_added: f64,
    /// Area of the given surface.
    pub area: f64,
    /// Vertices of the fillings.
    pub vertices_added: usize,
    /// The loops, one for each handle, in the order of the cuts.
    pub loops: Vec<CutLoop>,
}

/// A loop of edges along which the surface was cut.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[non_exhaustive]
pub struct CutLoop {
    /// Whether it goes around a handle or a tunnel.
    pub kind: Kind,
    /// Length of the loop, in the surface's unit.
    pub length: f64,
    /// Number of its vertices.
    pub vertices: usize,
    /// Area of the two fillings.
    pub area_added: f64,
    /// Mean of its vertices' positions.
    pub centre: [f64; 3],
}

/// The side of the surface on which a loop is spanned (T. K. Dey, F. Fan and Y. Wang, "An efficient computation of
/// handle and tunnel loops via Reeb graphs", ACM Trans. Graph. 32, 2013).
///
/// Theirs is a property of the loop's class, computed from a graph; this one is the side towards which a film over the
/// loop leaves the surface, on average. If the film stays on one side of the surface the two agree.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The film is inside: the cut severs a handle.
    Handle,
    /// The film is outside: the cut plugs a tunnel.
    Tunnel,
}

impl Kind {
    /// Returns the other kind.
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
        write!(f, "genus {} cut to {}: ", self.genus_before, self.genus_after)?;
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
        write!(f, ", filling adds {:.3} % of the area", 100.0 * self.area_added / self.area)
    }
}

fn counted(count: usize, one: &str) -> String {
    if count == 1 { format!("1 {one}") } else { format!("{count} {one}s") }
}
