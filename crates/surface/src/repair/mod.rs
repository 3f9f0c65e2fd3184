//! Repairs common defects of scanned or exported meshes: duplicate vertices, repeated triangles, fins, triangles wound
//! against their neighbours, parts that touch, unreferenced vertices, loose pieces and small holes.
//!
//! Rims that nearly coincide are welded. No other vertex is moved. Holes remain open if they have more than
//! [`LARGEST_FAN`] edges, or a shape that a fan of triangles can't fill. One-sided surfaces remain one-sided.
//! [`Topology`](crate::topology::Topology) reports these defects.

mod rims;
mod sheets;
mod wrap;

use std::collections::{HashMap, HashSet};
use std::fmt;

use serde::ser::{Serialize, SerializeMap, Serializer};

use crate::geometry::{Vec3, dot, face_normal};
use crate::mesh::Mesh;
pub use rims::{LARGEST_FAN, LEAST_AREA, WELDING_DISTANCE, bulk, rims};
pub use wrap::Wrap;

/// The description of a repair gives the share of the area that the dropped fins had, if this share is at least this
/// value.
const LEAST_STATED: f64 = 0.01;

/// The changes that a repair made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct MeshRepair {
    /// Number of vertices merged with another vertex at exactly the same position or, on rims, at nearly the same
    /// position.
    pub welded: usize,
    /// Area lost by welding rims, and by dropping the triangles that are degenerate afterwards, as a fraction of the
    /// area before.
    pub lost_area: f64,
    /// Number of triangles dropped because they used a vertex twice.
    pub degenerate: usize,
    /// Number of triangles dropped because an earlier triangle has the same vertices.
    pub repeated: usize,
    /// Number of triangles dropped in fins and in walls between chambers.
    pub fins: usize,
    /// Area of the triangles dropped in fins and walls, as a fraction of the area before they were dropped.
    pub fins_area: f64,
    /// Number of triangles turned to agree with their neighbours.
    pub turned: usize,
    /// Number of vertices added where parts of the surface touched.
    pub split: usize,
    /// Number of pieces dropped, which are all except the one with the largest area.
    pub pieces: usize,
    /// Area of the dropped pieces as a fraction of the area of all pieces.
    pub dropped_area: f64,
    /// Number of dropped pieces that shared edges with the kept piece, such as a body behind a common wall.
    pub attached: usize,
    /// Number of holes filled.
    pub holes: usize,
    /// Number of triangles added to fill the holes. They are the last triangles of the repaired mesh.
    pub filled: usize,
    /// Area of the added triangles as a fraction of the area of the repaired mesh.
    pub filled_area: f64,
    /// Number of vertices dropped because no triangle used them after all other changes.
    pub unused: usize,
    /// The closed surface that took the mesh's place, if the mesh was wrapped after the changes above.
    pub wrap: Option<Wrap>,
}

impl MeshRepair {
    /// Returns whether anything was changed.
    #[must_use]
    pub fn is_any(&self) -> bool {
        *self != Self::default()
    }

    /// Returns a description of the area lost by welding, the pieces dropped and the holes filled, each with its share
    /// of the area.
    #[must_use]
    pub fn drops_and_fills(&self) -> String {
        self.large().into_iter().chain([self.behind_walls()]).flatten().collect::<Vec<_>>().join(", ")
    }

    /// Returns a description of all changes: phrases joined by commas, or "nothing".
    #[must_use]
    pub fn changes(&self) -> String {
        let [lost, dropped, filled] = self.large();
        let phrases = [
            phrase(self.welded, "vertex welded to another", "vertices welded to others"),
            lost,
            phrase(self.degenerate, "degenerate triangle dropped", "degenerate triangles dropped"),
            phrase(self.repeated, "repeated triangle dropped", "repeated triangles dropped"),
            self.of_fins(),
            phrase(self.turned, "triangle reversed", "triangles reversed"),
            phrase(self.split, "vertex added where parts touched", "vertices added where parts touched"),
            dropped,
            filled,
            self.behind_walls(),
            phrase(self.unused, "unused vertex dropped", "unused vertices dropped"),
            self.wrap.map(|wrap| wrap.to_string()),
        ];
        let phrases: Vec<String> = phrases.into_iter().flatten().collect();
        if phrases.is_empty() { "nothing".to_owned() } else { phrases.join(", ") }
    }

    fn of_fins(&self) -> Option<String> {
        let text =
            phrase(self.fins, "triangle of fins or inner walls dropped", "triangles of fins or inner walls dropped");
        let share = (self.fins_area >= LEAST_STATED).then(|| format!(" ({} % of the area)", percent(self.fins_area)));
        text.map(|text| text + &share.unwrap_or_default())
    }

    fn behind_walls(&self) -> Option<String> {
        phrase(
            self.attached,
            "dropped piece shared edges with the kept piece (for example at a common wall)",
            "dropped pieces shared edges with the kept piece (for example at a common wall)",
        )
    }

    fn large(&self) -> [Option<String>; 3] {
        let of = |count: usize, one: &str, many: &str, share: f64| {
            let text = phrase(count, one, many)?;
            Some(format!("{text} ({} % of the area)", percent(share)))
        };
        [
            (self.lost_area >= 5e-5).then(|| format!("{} % of the area lost by welding", percent(self.lost_area))),
            of(self.pieces, "smaller piece dropped", "smaller pieces dropped", self.dropped_area),
            of(self.holes, "hole filled", "holes filled", self.filled_area),
        ]
    }

    /// Sets `filled_area` to the fraction of the repaired mesh's area that belongs to filled holes.
    pub fn measure(&mut self, repaired: &Mesh) {
        let filled = &repaired.faces[repaired.faces.len() - self.filled..];
        let [filled, all] = [filled, repaired.faces.as_slice()].map(|faces| area(&repaired.vertices, faces));
        self.filled_area = if all > 0.0 { filled / all } else { 0.0 };
    }

    /// Returns the counts with their names, for reports.
    #[must_use]
    pub fn counts(&self) -> [(&'static str, usize); 11] {
        [
            ("vertices_welded", self.welded),
            ("degenerate_triangles_dropped", self.degenerate),
            ("repeated_triangles_dropped", self.repeated),
            ("triangles_of_fins_dropped", self.fins),
            ("triangles_turned", self.turned),
            ("vertices_split", self.split),
            ("pieces_dropped", self.pieces),
            ("attached_pieces_dropped", self.attached),
            ("holes_filled", self.holes),
            ("triangles_added", self.filled),
            ("unused_vertices_dropped", self.unused),
        ]
    }
}

impl Serialize for MeshRepair {
    /// Serializes the counts by name, the shares of the area (`lost_area`, `fins_area`, `dropped_area` and
    /// `filled_area`), and `wrap` if the mesh was wrapped.
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let counts = self.counts();
        let mut map = serializer.serialize_map(Some(counts.len() + 4 + usize::from(self.wrap.is_some())))?;
        for (name, count) in counts {
            map.serialize_entry(name, &count)?;
        }
        map.serialize_entry("lost_area", &self.lost_area)?;
        map.serialize_entry("fins_area", &self.fins_area)?;
        map.serialize_entry("dropped_area", &self.dropped_area)?;
        map.serialize_entry("filled_area", &self.filled_area)?;
        if let Some(wrap) = &self.wrap {
            map.serialize_entry("wrap", wrap)?;
        }
        map.end()
    }
}

impl fmt::Display for MeshRepair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the mesh was repaired: {}", self.changes())
    }
}

fn phrase(count: usize, one: &str, many: &str) -> Option<String> {
    match count {
        0 => None,
        1 => Some(format!("1 {one}")),
        n => Some(format!("{n} {many}")),
    }
}

/// Returns a fraction as a percentage with one decimal, or with two decimals below 1 %.
fn percent(fraction: f64) -> String {
    let percent = 100.0 * fraction;
    let digits = if percent >= 0.995 { 1 } else { 2 };
    format!("{percent:.digits$}")
}

/// Repairs a mesh, whose triangles must have valid indices. Returns the repaired mesh and the changes. A closed result
/// is wound outwards. The remaining vertices keep their order. Vertices that were added to separate parts that touched,
/// or to fill holes, come last.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
#[must_use]
pub fn repair(mesh: &Mesh) -> (Mesh, MeshRepair) {
    let mut found = MeshRepair::default();
    let mut vertices = mesh.vertices.clone();
    let mut faces = welded(mesh, &mut found);
    (found.fins, found.fins_area) = sheets::drop_fins(&vertices, &mut faces);
    found.turned = sheets::orient(&vertices, &mut faces);
    (found.pieces, found.dropped_area, found.attached) = sheets::keep_largest(&vertices, &mut faces);
    rims::fill(&mut vertices, &mut faces, &mut found);
    found.split = sheets::split(&mut vertices, &mut faces);
    let welded = found.welded;
    let (vertices, unused) = compact(&vertices, &mut faces);
    // Vertices that were merged with others are also unused. They are subtracted, because they are already counted as
    // welded.
    found.unused = unused.saturating_sub(welded);
    let mut mesh = Mesh { vertices, faces, meta: mesh.meta.clone() };
    turn_closed_outward(&mut mesh, &mut found);
    found.measure(&mesh);
    (mesh, found)
}

/// Turns all triangles if the mesh is closed and wound inwards, and adds the turned triangles to the changes. An open
/// mesh isn't changed.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
pub fn turn_closed_outward(mesh: &mut Mesh, found: &mut MeshRepair) {
    if sheets::turn_closed_outward(&mesh.vertices, &mut mesh.faces) {
        // Triangles that the repair had turned before have been turned twice, so they have their original winding
        // again.
        found.turned = (mesh.faces.len() - found.filled).saturating_sub(found.turned);
    }
}

/// Welds a mesh, and turns its triangles so that the winding is consistent within each piece. Closed pieces are wound
/// outwards. Open pieces keep the winding of the larger part of their area. All open pieces are reversed if together
/// they are inside out. Returns the mesh with all its pieces and vertices, and the changes.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
#[must_use]
pub fn orient_outward(mesh: &Mesh) -> (Mesh, MeshRepair) {
    let mut found = MeshRepair::default();
    let mut faces = welded(mesh, &mut found);
    let given = faces.clone();
    sheets::orient(&mesh.vertices, &mut faces);
    sheets::turn_outward(&mesh.vertices, &mut faces);
    found.turned = given.iter().zip(&faces).filter(|(given, face)| given != face).count();
    (Mesh { vertices: mesh.vertices.clone(), faces, meta: mesh.meta.clone() }, found)
}

/// Welds equal vertices and nearly equal rims. Returns all triangles except degenerate and repeated ones.
fn welded(mesh: &Mesh, found: &mut MeshRepair) -> Vec<[u32; 3]> {
    let mut faces = weld(mesh, found);
    drop_needless(&mut faces, found);
    let before = area(&mesh.vertices, &faces);
    let on_rims = rims::weld(&mesh.vertices, &mut faces);
    found.welded += on_rims;
    if on_rims > 0 && before > 0.0 {
        // Triangles that are degenerate after welding count as lost area. Triangles that now repeat others don't. Both
        // kinds are dropped below.
        found.lost_area = (1.0 - area(&mesh.vertices, &faces) / before).max(0.0);
    }
    drop_needless(&mut faces, found);
    faces
}

/// Drops triangles that use a vertex twice, and triangles with the same vertices as an earlier one.
fn drop_needless(faces: &mut Vec<[u32; 3]>, found: &mut MeshRepair) {
    let before = faces.len();
    faces.retain(|&[a, b, c]| a != b && b != c && c != a);
    found.degenerate += before - faces.len();
    let mut seen = HashSet::with_capacity(faces.len());
    let before = faces.len();
    faces.retain(|face| {
        let mut corners = *face;
        corners.sort_unstable();
        seen.insert(corners)
    });
    found.repeated += before - faces.len();
}

/// Returns the total area of the given triangles.
fn area(vertices: &[Vec3], faces: &[[u32; 3]]) -> f64 {
    faces.iter().map(|face| area_of(vertices, face)).sum()
}

/// Returns the area of a triangle.
fn area_of(vertices: &[Vec3], face: &[u32; 3]) -> f64 {
    let normal = face_normal(face.map(|v| vertices[v as usize]));
    0.5 * dot(normal, normal).sqrt()
}

/// Returns the triangles with each vertex replaced by the first vertex at the same position. -0 and +0 are equal.
fn weld(mesh: &Mesh, found: &mut MeshRepair) -> Vec<[u32; 3]> {
    let mut first: HashMap<[u64; 3], u32> = HashMap::with_capacity(mesh.vertices.len());
    let mut place = Vec::with_capacity(mesh.vertices.len());
    for (number, vertex) in (0_u32..).zip(&mesh.vertices) {
        let at = *first.entry(vertex.map(|x| (x + 0.0).to_bits())).or_insert(number);
        found.welded += usize::from(at != number);
        place.push(at);
    }
    mesh.faces.iter().map(|face| face.map(|v| place.get(v as usize).copied().unwrap_or(v))).collect()
}

/// Drops the vertices that no triangle uses, and renumbers the triangles' corners. Returns the remaining vertices and
/// the number of dropped vertices.
fn compact(vertices: &[[f64; 3]], faces: &mut [[u32; 3]]) -> (Vec<[f64; 3]>, usize) {
    let mut used = vec![false; vertices.len()];
    for &corner in faces.as_flattened() {
        if let Some(used) = used.get_mut(corner as usize) {
            *used = true;
        }
    }
    let mut number = 0;
    let numbers: Vec<u32> = used
        .iter()
        .map(|&used| {
            number += u32::from(used);
            number.saturating_sub(1)
        })
        .collect();
    for corner in faces.as_flattened_mut() {
        *corner = numbers.get(*corner as usize).copied().unwrap_or(*corner);
    }
    let kept: Vec<[f64; 3]> = vertices.iter().zip(&used).filter(|(_, used)| **used).map(|(v, _)| *v).collect();
    let dropped = vertices.len() - kept.len();
    (kept, dropped)
}

#[cfg(test)]
mod tests;
