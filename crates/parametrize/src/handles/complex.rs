//! Represents a closed surface of polygons by half-edges, and cuts the surface along loops of edges.
//!
//! Half-edge 3 f + k runs from corner k of triangle f to corner k + 1, with triangle f on its left. A cut along a loop
//! of edges gives new vertices, copies of the loop's vertices, to the triangle corners on the loop's left. Each of the
//! two resulting rims is closed by a *cap*: a polygon with the same number of half-edges as the loop. The complex
//! therefore stays closed, and a cut along a loop that doesn't separate it lowers its genus by one. Later loops run
//! along edges only, so they never cross a cap. Triangles and original vertices keep their indices.
//!
//! Memory: 36 bytes per half-edge and 44 per vertex. A cut takes time proportional to the number of corners around the
//! loop.

use spharm_surface::Mesh;

use crate::geometry::{Vec3, norm, sub};

/// Used in place of a half-edge's index if there is no half-edge.
pub(super) const NONE: u32 = u32::MAX;

/// The half-edges of a closed, oriented surface.
pub(super) struct Complex {
    /// Positions of the vertices: the original vertices, then the copies.
    pub(super) positions: Vec<Vec3>,
    /// The original vertex of each vertex: for a copy the vertex that it was copied from, otherwise the vertex itself.
    pub(super) own: Vec<u32>,
    /// For each vertex, a half-edge that starts at it.
    outgoing: Vec<u32>,
    /// For each half-edge, the vertex that it starts at.
    from: Vec<u32>,
    next: Vec<u32>,
    previous: Vec<u32>,
    twin: Vec<u32>,
    face: Vec<u32>,
    length: Vec<f64>,
    /// For each face, one of its half-edges.
    first: Vec<u32>,
    /// Number of original triangles.
    triangles: usize,
}

/// A loop of edges that visits no vertex twice.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Loop {
    /// The loop's half-edges; each starts where the previous one ends.
    pub(super) edges: Vec<u32>,
    /// Sum of the half-edges' lengths.
    pub(super) length: f64,
}

/// The two rims of a cut. Half-edge i of either rim runs along edge i of the loop.
pub(super) struct Rims {
    /// The half-edges of the cap on the loop's left; they run against the loop, so half-edge i - 1 follows half-edge i.
    pub(super) left: Vec<u32>,
    /// The half-edges of the cap on the loop's right; they run along the loop.
    pub(super) right: Vec<u32>,
}

impl Complex {
    /// Builds the half-edges of a closed, consistently wound manifold.
    pub(super) fn new(mesh: &Mesh) -> Self {
        let faces = mesh.faces.len();
        let half_edges = 3 * faces;
        let from: Vec<u32> = mesh.faces.as_flattened().to_vec();
        let next: Vec<u32> = (0..half_edges as u32).map(|h| if h % 3 == 2 { h - 2 } else { h + 1 }).collect();
        let previous = (0..half_edges as u32).map(|h| if h % 3 == 0 { h + 2 } else { h - 1 }).collect();
        let ends = |h: u32| (from[h as usize], from[next[h as usize] as usize]);
        let mut order: Vec<(u32, u32, u32)> =
            (0..half_edges as u32).map(|h| (ends(h).0.min(ends(h).1), ends(h).0.max(ends(h).1), h)).collect();
        order.sort_unstable();
        let mut twin = vec![NONE; half_edges];
        for pair in order.chunks_exact(2) {
            (twin[pair[0].2 as usize], twin[pair[1].2 as usize]) = (pair[1].2, pair[0].2);
        }
        let mut outgoing = vec![NONE; mesh.vertices.len()];
        for (&v, h) in from.iter().zip(0..) {
            outgoing[v as usize] = h;
        }
        let at = |v: u32| mesh.vertices[v as usize];
        let length = (0..half_edges as u32).map(|h| norm(sub(at(ends(h).0), at(ends(h).1)))).collect();
        Self {
            positions: mesh.vertices.clone(),
            own: (0..mesh.vertices.len() as u32).collect(),
            outgoing,
            face: (0..half_edges as u32).map(|h| h / 3).collect(),
            first: (0..faces as u32).map(|f| 3 * f).collect(),
            from,
            next,
            previous,
            twin,
            length,
            triangles: faces,
        }
    }

    pub(super) fn vertices(&self) -> usize {
        self.positions.len()
    }

    pub(super) fn faces(&self) -> usize {
        self.first.len()
    }

    pub(super) fn half_edges(&self) -> u32 {
        self.from.len() as u32
    }

    pub(super) fn from(&self, h: u32) -> u32 {
        self.from[h as usize]
    }

    pub(super) fn to(&self, h: u32) -> u32 {
        self.from[self.next[h as usize] as usize]
    }

    pub(super) fn twin(&self, h: u32) -> u32 {
        self.twin[h as usize]
    }

    pub(super) fn face(&self, h: u32) -> u32 {
        self.face[h as usize]
    }

    pub(super) fn length(&self, h: u32) -> f64 {
        self.length[h as usize]
    }

    /// Returns the half-edges that start at a vertex, counter-clockwise.
    pub(super) fn around(&self, vertex: u32) -> impl Iterator<Item = u32> + '_ {
        let start = self.outgoing[vertex as usize];
        let turn = move |&h: &u32| {
            let turned = self.twin[self.previous[h as usize] as usize];
            (turned != start).then_some(turned)
        };
        std::iter::successors((start != NONE).then_some(start), turn)
    }

    /// Returns the half-edges of a face, counter-clockwise.
    pub(super) fn of_face(&self, face: u32) -> impl Iterator<Item = u32> + '_ {
        let start = self.first[face as usize];
        std::iter::successors(Some(start), move |&h| Some(self.next[h as usize]).filter(|&next| next != start))
    }

    /// Returns the original triangles. After cuts, some of their corners are copies of vertices.
    pub(super) fn own_triangles(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.from[..3 * self.triangles].as_chunks().0.iter().copied()
    }

    /// Cuts along a loop. The corners on the loop's left get copies of the loop's vertices.
    pub(super) fn cut(&mut self, cut: &Loop) -> Rims {
        let edges = &cut.edges;
        let count = edges.len();
        let before = |i: usize| (i + count - 1) % count;
        for (i, &edge) in edges.iter().enumerate() {
            let vertex = self.from(edge) as usize;
            let copy = self.positions.len() as u32;
            self.positions.push(self.positions[vertex]);
            self.own.push(self.own[vertex]);
            self.outgoing.push(edge);
            self.outgoing[vertex] = self.twin(edges[before(i)]);
            let mut corner = edge;
            loop {
                self.from[corner as usize] = copy;
                let arriving = self.previous[corner as usize];
                if arriving == edges[before(i)] {
                    break;
                }
                corner = self.twin(arriving);
            }
        }
        let (left, right) = (self.half_edges(), self.half_edges() + count as u32);
        let faces = self.first.len() as u32;
        self.first.extend([left, right]);
        // The half-edges of the left cap run against the loop, those of the right cap along the loop.
        for (i, &edge) in edges.iter().enumerate() {
            let copy = self.to(edge);
            self.from.push(copy);
            self.next.push(left + before(i) as u32);
            self.previous.push(left + ((i + 1) % count) as u32);
            self.face.push(faces);
        }
        for (i, &edge) in edges.iter().enumerate() {
            let vertex = self.to(self.twin(edge));
            self.from.push(vertex);
            self.next.push(right + ((i + 1) % count) as u32);
            self.previous.push(right + before(i) as u32);
            self.face.push(faces + 1);
        }
        let twins: Vec<u32> = edges.iter().copied().chain(edges.iter().map(|&edge| self.twin(edge))).collect();
        for (&edge, cap) in twins.iter().zip(left..) {
            self.twin[edge as usize] = cap;
            self.twin.push(edge);
            self.length.push(self.length[edge as usize]);
        }
        Rims { left: (left..right).collect(), right: (right..right + count as u32).collect() }
    }
}
