//! Repairs common defects of scanned or exported meshes: duplicate vertices, repeated triangles, unreferenced vertices,
//! loose pieces and small holes.
//!
//! No vertex is moved and no triangle is reversed. Triangles wound against each other and edges of more than two
//! triangles remain; [`Topology`](crate::topology::Topology) reports them.

use std::collections::hash_map::Entry;
use std::collections::{HashMap, HashSet};
use std::fmt;

use crate::mesh::Mesh;
use crate::topology::UnionFind;

/// Largest number of edges of a hole that is filled.
pub const LARGEST_HOLE: usize = 32;

/// The changes that a repair made, in the order in which they are made.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub struct MeshRepair {
    /// Number of vertices merged with another vertex at exactly the same position.
    pub welded: usize,
    /// Number of triangles dropped because they used a vertex twice.
    pub degenerate: usize,
    /// Number of triangles dropped because an earlier triangle has the same vertices.
    pub repeated: usize,
    /// Number of pieces dropped, which are all except the one with the most triangles.
    pub pieces: usize,
    /// Number of holes filled, each of at most [`LARGEST_HOLE`] edges.
    pub holes: usize,
    /// Number of triangles added to fill the holes.
    pub filled: usize,
    /// Number of vertices dropped because no triangle used them after all other changes.
    pub unused: usize,
}

impl MeshRepair {
    /// Returns whether anything was changed.
    #[must_use]
    pub fn is_any(&self) -> bool {
        *self != Self::default()
    }

    /// Returns each count with its name for reports.
    #[must_use]
    pub fn counts(&self) -> [(&'static str, usize); 7] {
        [
            ("vertices_welded", self.welded),
            ("degenerate_triangles_dropped", self.degenerate),
            ("repeated_triangles_dropped", self.repeated),
            ("pieces_dropped", self.pieces),
            ("holes_filled", self.holes),
            ("triangles_added", self.filled),
            ("unused_vertices_dropped", self.unused),
        ]
    }
}

impl fmt::Display for MeshRepair {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let phrase = |count: usize, one: &str, many: &str| match count {
            0 => None,
            1 => Some(format!("1 {one}")),
            n => Some(format!("{n} {many}")),
        };
        let phrases: Vec<String> = [
            phrase(self.welded, "vertex welded to another", "vertices welded to others"),
            phrase(self.degenerate, "degenerate triangle dropped", "degenerate triangles dropped"),
            phrase(self.repeated, "repeated triangle dropped", "repeated triangles dropped"),
            phrase(self.pieces, "smaller piece dropped", "smaller pieces dropped"),
            phrase(self.holes, "hole filled", "holes filled"),
            phrase(self.unused, "unused vertex dropped", "unused vertices dropped"),
        ]
        .into_iter()
        .flatten()
        .collect();
        write!(
            f,
            "the mesh was repaired: {}",
            if phrases.is_empty() { "nothing".to_owned() } else { phrases.join(", ") }
        )
    }
}

/// Repairs a mesh, whose triangles must have valid indices. Returns the repaired mesh and the changes. The remaining
/// vertices keep their order; vertices added to fill holes come last.
#[must_use]
pub fn repair(mesh: &Mesh) -> (Mesh, MeshRepair) {
    let mut found = MeshRepair::default();
    let mut vertices = mesh.vertices.clone();
    let mut faces = weld(mesh, &mut found);
    let before = faces.len();
    faces.retain(|&[a, b, c]| a != b && b != c && c != a);
    found.degenerate = before - faces.len();
    let mut seen = HashSet::with_capacity(faces.len());
    let before = faces.len();
    faces.retain(|face| {
        let mut corners = *face;
        corners.sort_unstable();
        seen.insert(corners)
    });
    found.repeated = before - faces.len();
    found.pieces = keep_largest(vertices.len(), &mut faces);
    fill_holes(&mut vertices, &mut faces, &mut found);
    let welded = found.welded;
    let (vertices, unused) = compact(&vertices, &mut faces);
    // The vertices that were merged with others are unused, too. They are subtracted, since they are counted as
    // welded.
    found.unused = unused.saturating_sub(welded);
    (Mesh { vertices, faces, meta: mesh.meta.clone() }, found)
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

/// Keeps the piece with the most triangles; in case of ties, the first one. Returns the number of pieces dropped.
fn keep_largest(vertices: usize, faces: &mut Vec<[u32; 3]>) -> usize {
    let mut pieces = UnionFind::new(vertices);
    for &[a, b, c] in faces.iter() {
        pieces.join(a, b);
        pieces.join(b, c);
    }
    let mut sizes: HashMap<u32, usize> = HashMap::new();
    for &[a, ..] in faces.iter() {
        *sizes.entry(pieces.root(a)).or_default() += 1;
    }
    let largest = sizes.iter().max_by_key(|&(&root, &size)| (size, std::cmp::Reverse(root))).map(|(&root, _)| root);
    faces.retain(|&[a, ..]| Some(pieces.root(a)) == largest);
    sizes.len().saturating_sub(1)
}

/// Fills holes, which are loops of edges with one triangle each. A loop of three edges is filled by one triangle, a
/// loop of four by two, a longer one by a fan around the mean of its vertices.
fn fill_holes(vertices: &mut Vec<[f64; 3]>, faces: &mut Vec<[u32; 3]>, found: &mut MeshRepair) {
    let edges: HashSet<(u32, u32)> = faces.iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]).collect();
    // The edges of a rim run opposite to the triangles' edges. Rims that meet at a vertex are separated by taking the
    // shortest rim through each edge.
    let mut open: Vec<(u32, u32)> =
        edges.iter().filter(|&&(a, b)| !edges.contains(&(b, a))).map(|&(a, b)| (b, a)).collect();
    open.sort_unstable();
    let mut next: HashMap<u32, Vec<u32>> = HashMap::new();
    open.iter().for_each(|&(from, to)| next.entry(from).or_default().push(to));
    for (from, to) in open {
        if !next.get(&from).is_some_and(|ends| ends.contains(&to)) {
            continue;
        }
        let Some(rim) = rim(from, to, &next) else { continue };
        for (a, b) in rim.iter().zip(rim.iter().cycle().skip(1)) {
            if let Some(ends) = next.get_mut(a) {
                ends.retain(|end| end != b);
            }
        }
        found.holes += 1;
        let before = faces.len();
        match rim[..] {
            [a, b, c] => faces.push([a, b, c]),
            [a, b, c, d] => {
                let length = |p: u32, q: u32| {
                    let [p, q] = [p, q].map(|v| vertices.get(v as usize).copied().unwrap_or_default());
                    (0..3).map(|k| (p[k] - q[k]).powi(2)).sum::<f64>()
                };
                // A diagonal that is already an edge can't be used.
                let taken = |p: u32, q: u32| edges.contains(&(p, q)) || edges.contains(&(q, p));
                let along = if taken(a, c) || (!taken(b, d) && length(b, d) < length(a, c)) {
                    [[b, c, d], [b, d, a]]
                } else {
                    [[a, b, c], [a, c, d]]
                };
                faces.extend(along);
            }
            _ => {
                let middle = vertices.len() as u32;
                let at = |k: usize| {
                    let sum: f64 = rim.iter().filter_map(|&v| vertices.get(v as usize)).map(|v| v[k]).sum();
                    sum / rim.len() as f64
                };
                vertices.push([0, 1, 2].map(at));
                let ends = rim.iter().zip(rim.iter().cycle().skip(1));
                faces.extend(ends.map(|(&a, &b)| [a, b, middle]));
            }
        }
        found.filled += faces.len() - before;
    }
}

/// Returns the shortest rim that begins with a given edge; `None` if it has more than [`LARGEST_HOLE`] edges.
fn rim(from: u32, to: u32, next: &HashMap<u32, Vec<u32>>) -> Option<Vec<u32>> {
    let mut before = HashMap::from([(to, from)]);
    let mut front = vec![to];
    for _ in 1..LARGEST_HOLE {
        let mut further = Vec::new();
        for at in front {
            for &end in next.get(&at).into_iter().flatten() {
                if end == from {
                    let mut rim = vec![at];
                    while rim.last() != Some(&from) {
                        rim.push(*before.get(rim.last()?)?);
                    }
                    rim.reverse();
                    return (rim.len() > 2).then_some(rim);
                }
                if let Entry::Vacant(new) = before.entry(end) {
                    new.insert(at);
                    further.push(end);
                }
            }
        }
        front = further;
    }
    None
}

/// Returns the vertices that triangles use, and the number of dropped vertices. Renumbers the triangles' corners.
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
mod tests {
    use super::*;
    use crate::generate::icosphere;
    use crate::topology::Topology;

    #[test]
    fn a_sound_mesh_stays_as_it_is() {
        let mesh = icosphere(2);
        let (same, found) = repair(&mesh);
        assert_eq!((same, found.is_any()), (mesh, false));
    }

    #[test]
    fn a_soup_is_welded() {
        let mesh = icosphere(2);
        let vertices: Vec<[f64; 3]> = mesh.faces.as_flattened().iter().map(|&v| mesh.vertices[v as usize]).collect();
        let faces = (0..mesh.faces.len() as u32).map(|f| [3 * f, 3 * f + 1, 3 * f + 2]).collect();
        let (welded, found) = repair(&Mesh::new(vertices, faces));
        assert!(Topology::of(&welded).is_sphere());
        assert_eq!((welded.vertices.len(), found.welded, found.unused), (162, 960 - 162, 0));
    }

    /// -0 and +0 are the same position, nearly equal positions aren't.
    #[test]
    fn only_what_lies_exactly_on_another_is_welded() {
        let mut mesh = icosphere(0);
        let whole = mesh.vertices.len() as u32;
        mesh.vertices[0] = [0.0, 0.0, 1.0];
        mesh.vertices.extend([[-0.0, -0.0, 1.0], [0.0, 1e-300, 1.0]]);
        mesh.faces[0] = mesh.faces[0].map(|v| if v == 0 { whole } else { v });
        let (welded, found) = repair(&mesh);
        assert_eq!((found.welded, found.unused, welded.vertices.len()), (1, 1, 12));
        assert!(Topology::of(&welded).is_sphere());
        mesh.faces[0] = mesh.faces[0].map(|v| if v == whole { whole + 1 } else { v });
        // The crack along an edge is filled as a hole of four edges.
        let (cracked, found) = repair(&mesh);
        assert_eq!((found.welded, found.holes, cracked.vertices.len()), (1, 1, 13));
    }

    /// Holes of four edges are filled along the shorter diagonal, larger holes by a fan around the mean of the rim.
    #[test]
    fn holes_are_filled_without_bumps() {
        let tent = |top: [f64; 3], rim: Vec<[f64; 3]>| {
            let n = rim.len() as u32;
            let faces = (0..n).map(|k| [n, k, (k + 1) % n]).collect();
            repair(&Mesh::new(rim.into_iter().chain([top]).collect(), faces))
        };
        let rim = (0..6).map(|k| f64::from(k).sin_cos()).map(|(y, x)| [3.0 * x, 2.0 * y, x]).collect::<Vec<_>>();
        let (filled, found) = tent([0.0, 0.0, 9.0], rim.clone());
        assert_eq!((found.holes, found.filled), (1, 6));
        let middle = filled.vertices[7];
        for k in 0..3 {
            assert!((middle[k] - rim.iter().map(|v| v[k]).sum::<f64>() / 6.0).abs() < 1e-15, "{middle:?}");
        }
        for (a, diagonal) in [(0.5, [0, 2]), (2.0, [1, 3])] {
            let rim = vec![[a, 0.0, 0.0], [0.0, 1.0, 0.0], [-a, 0.0, 0.0], [0.0, -1.0, 0.0]];
            let (filled, found) = tent([0.0, 0.0, 1.0], rim);
            assert_eq!((found.holes, found.filled), (1, 2));
            assert!(filled.faces[4..].iter().all(|face| diagonal.iter().all(|v| face.contains(v))), "{filled:?}");
        }
    }

    #[test]
    fn holes_of_every_size_up_to_the_bound_are_filled() {
        let whole = icosphere(3);
        let around: Vec<[u32; 3]> = whole.faces.iter().filter(|face| face.contains(&500)).copied().collect();
        let edge = |a: &[u32; 3], b: &[u32; 3]| a.iter().filter(|corner| b.contains(corner)).count() == 2;
        let second = around.iter().find(|face| **face != around[0] && !edge(face, &around[0])).unwrap();
        let apart = [around[0], *second];
        let next = around.iter().find(|face| **face != around[0] && edge(face, &around[0])).unwrap();
        let joined = [around[0], *next];
        // Removes all triangles around a vertex (five or six edges), one triangle, or two that share an edge.
        let at = |vertex: u32| move |face: &[u32; 3]| face.contains(&vertex);
        for (drop, holes) in [
            (Box::new(at(0)) as Box<dyn Fn(&[u32; 3]) -> bool>, 1),
            (Box::new(|face: &[u32; 3]| at(0)(face) || at(400)(face)), 2),
            (Box::new(|face: &[u32; 3]| *face == whole.faces[7]), 1),
            // Removes two triangles that share a vertex but no edge.
            (Box::new(|face: &[u32; 3]| apart.contains(face)), 2),
            (Box::new(|face: &[u32; 3]| joined.contains(face)), 1),
        ] {
            let mut mesh = whole.clone();
            mesh.faces.retain(|face| !drop(face));
            let (filled, found) = repair(&mesh);
            assert!(Topology::of(&filled).is_sphere(), "{found:?}");
            assert_eq!(found.holes, holes, "{found}");
        }
        let mut half = whole.clone();
        half.faces.retain(|face| face.iter().any(|&v| whole.vertices[v as usize][2] > 0.0));
        let (open, found) = repair(&half);
        assert!(found.holes == 0 && !Topology::of(&open).is_sphere(), "a hole of half the surface stays");
    }

    #[test]
    fn loose_and_repeated_things_are_dropped_and_counted() {
        let mut mesh = icosphere(2);
        let whole = mesh.clone();
        let [a, b, c] = mesh.faces[0];
        mesh.faces.extend([[b, c, a], [c, b, a], [a, a, b]]);
        mesh.vertices.extend([[9.0; 3], [5.0, 0.0, 0.0], [6.0, 0.0, 0.0], [5.0, 1.0, 0.0]]);
        mesh.faces.push([163, 164, 165]);
        let (found, report) = repair(&mesh);
        assert_eq!(found, whole);
        let expected = MeshRepair { degenerate: 1, repeated: 2, pieces: 1, unused: 4, ..MeshRepair::default() };
        assert_eq!(report, expected);
        let text = report.to_string();
        assert!(text.contains("1 degenerate triangle dropped, 2 repeated triangles dropped, 1 smaller piece dropped"));
        assert!(text.ends_with("4 unused vertices dropped"), "{text}");
    }
}
