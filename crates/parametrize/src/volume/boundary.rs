//! Builds the closed surface of quadrangles that separates the voxels inside a mask from those outside.
//!
//! Each face that a voxel inside shares with a voxel outside is a quadrangle, wound outwards. If two diagonally
//! adjacent voxels share only an edge, four quadrangles meet at the edge, two from each voxel. The two from the same
//! voxel are treated as neighbours, so that the surface passes between the voxels. A vertex belongs to one fan of
//! neighbouring quadrangles around a corner of the lattice; if two parts of the surface touch at a corner, there are
//! two vertices at the corner. Every edge therefore belongs to exactly two quadrangles, and every vertex to one fan.

use spharm_surface::Mesh;
use spharm_surface::geometry::{Vec3, cross, sub};

use super::affine::Affine;
use super::mask::{FACES, Mask};

/// A closed surface of quadrangles.
#[derive(Clone, Debug, PartialEq)]
pub struct QuadMesh {
    /// Positions of the vertices: in voxel coordinates of the volume, or in mm after [`to_world`](Self::to_world).
    pub vertices: Vec<[f64; 3]>,
    /// The four vertices of each quadrangle, counter-clockwise seen from outside.
    pub quads: Vec<[u32; 4]>,
    /// Positions of the vertices on the smooth surface; `None` without a smooth surface. [`triangles`](Self::triangles)
    /// uses these positions.
    pub(crate) smooth: Option<Vec<[f64; 3]>>,
    /// The twin of each edge. Edge 4 q + k runs from corner k of quadrangle q to the next corner; its twin 4 q' + k' is
    /// the same edge as part of the neighbouring quadrangle q'.
    pub(crate) twins: Vec<u32>,
}

/// The position and orientation of a quadrangle, in voxel coordinates.
#[derive(Clone, Copy, Debug)]
pub(super) struct Face {
    pub(super) centre: Vec3,
    /// The axis along which the quadrangle's normal points.
    pub(super) axis: usize,
    /// The sign of the outward normal along the axis: 1 or -1.
    pub(super) sign: f64,
}

impl QuadMesh {
    /// Returns the surface of a mask in voxel coordinates; voxel (0, 0, 0) extends from -0.5 to 0.5 along each axis.
    #[must_use]
    pub fn around(mask: &Mask) -> Self {
        let mut corners: Vec<[[i32; 3]; 4]> = Vec::new();
        let mut voxels: Vec<usize> = Vec::new();
        for voxel in (0..mask.inside.len()).filter(|&i| mask.inside[i]) {
            for (face, d) in FACES.iter().enumerate() {
                if !mask.inside[voxel.wrapping_add_signed(mask.step(*d))] {
                    corners.push(face_corners(mask.place(voxel).map(|x| x as i32), face));
                    voxels.push(voxel);
                }
            }
        }
        let twins = twins(&corners, &voxels);
        let (of_corner, places) = vertices(&corners, &twins);
        let place = |[x, y, z]: [i32; 3]| {
            let at = [x, y, z].map(f64::from);
            std::array::from_fn(|k| at[k] + mask.origin[k] as f64 - 0.5)
        };
        let quads = of_corner.chunks_exact(4).map(|c| [c[0], c[1], c[2], c[3]]).collect();
        Self { vertices: places.into_iter().map(place).collect(), quads, smooth: None, twins }
    }

    /// Returns the surface with its vertices in mm. The quadrangles are again counter-clockwise seen from outside.
    #[must_use]
    pub fn to_world(&self, affine: &Affine) -> Self {
        let placed = |positions: &Vec<[f64; 3]>| positions.iter().map(|&v| affine.apply(v)).collect::<Vec<_>>();
        let (vertices, smooth) = (placed(&self.vertices), self.smooth.as_ref().map(placed));
        if affine.determinant() > 0.0 {
            return Self { vertices, smooth, ..self.clone() };
        }
        // A reflection reverses the order of corners. Edge k, from corner k to k + 1, becomes edge 2 - k (mod 4).
        let quads = self.quads.iter().map(|&[a, b, c, d]| [d, c, b, a]).collect();
        let turned = |edge: u32| edge / 4 * 4 + (6 - edge % 4) % 4;
        let twins = (0..self.twins.len() as u32).map(|edge| turned(self.twins[turned(edge) as usize])).collect();
        Self { vertices, quads, smooth, twins }
    }

    /// Returns the position of a quadrangle. The surface must be in voxel coordinates.
    pub(super) fn face(&self, quad: usize) -> Face {
        let corners = self.quads[quad].map(|v| self.vertices[v as usize]);
        let centre = [0, 1, 2].map(|k| corners.iter().map(|corner| corner[k]).sum::<f64>() / 4.0);
        let normal = cross(sub(corners[1], corners[0]), sub(corners[3], corners[0]));
        let axis = (0..3).find(|&k| normal[k] != 0.0).unwrap_or(0);
        Face { centre, axis, sign: normal[axis].signum() }
    }

    /// Returns the Euler characteristic: vertices - edges + quadrangles.
    #[must_use]
    pub fn euler_characteristic(&self) -> i64 {
        self.vertices.len() as i64 - self.twins.len() as i64 / 2 + self.quads.len() as i64
    }

    /// Returns the number of handles: the sum of the genera of all closed surfaces of which the mesh consists.
    #[must_use]
    pub fn handles(&self) -> usize {
        let genera = self.components() as i64 - self.euler_characteristic() / 2;
        usize::try_from(genera).unwrap_or(0)
    }

    /// Returns the number of closed surfaces of which the mesh consists.
    #[must_use]
    pub fn components(&self) -> usize {
        let mut seen = vec![false; self.quads.len()];
        let mut count = 0;
        let mut stack = Vec::new();
        for start in 0..seen.len() {
            if seen[start] {
                continue;
            }
            count += 1;
            seen[start] = true;
            stack.push(start);
            while let Some(quad) = stack.pop() {
                for k in 0..4 {
                    let next = self.twins[4 * quad + k] as usize / 4;
                    if !seen[next] {
                        seen[next] = true;
                        stack.push(next);
                    }
                }
            }
        }
        count
    }

    /// Returns the number of edges that have the same two vertices as an earlier edge. A mesh of triangles can't
    /// distinguish two such edges: there, it would have a single edge that belongs to four triangles, although the
    /// surface is closed.
    #[must_use]
    pub fn pinched_edges(&self) -> usize {
        let mut ends: Vec<[u32; 2]> = self.edges().collect();
        ends.sort_unstable();
        ends.windows(2).filter(|pair| pair[0] == pair[1]).count()
    }

    /// Returns the two vertices of each edge, the smaller index first.
    pub(crate) fn edges(&self) -> impl Iterator<Item = [u32; 2]> {
        let edges = (0..self.twins.len()).filter(|&edge| edge as u32 <= self.twins[edge]);
        edges.map(|edge| {
            let quad = self.quads[edge / 4];
            let (a, b) = (quad[edge % 4], quad[(edge + 1) % 4]);
            [a.min(b), a.max(b)]
        })
    }

    /// Returns a mesh of triangles. The mesh is smooth if the surface is smooth. Each quadrangle is cut from corner 0
    /// to 2, or from corner 1 to 3 if `from_second` is true for its index. The volume of a smooth surface doesn't
    /// depend on the cuts.
    #[must_use]
    pub fn triangles(&self, from_second: impl Fn(usize) -> bool) -> Mesh {
        match &self.smooth {
            None => self.cut(&self.vertices, from_second),
            Some(smooth) => self.cut_evenly(smooth, from_second),
        }
    }

    /// Returns a mesh of triangles with the given vertex positions.
    pub(super) fn cut(&self, vertices: &[Vec3], from_second: impl Fn(usize) -> bool) -> Mesh {
        let cut = |(q, &[a, b, c, d]): (usize, &[u32; 4])| {
            if from_second(q) { [[a, b, d], [b, c, d]] } else { [[a, b, c], [a, c, d]] }
        };
        Mesh::new(vertices.to_vec(), self.quads.iter().enumerate().flat_map(cut).collect())
    }
}

/// Returns the four lattice corners of a voxel's face, counter-clockwise seen from outside the voxel. Among a voxel's
/// corners, the corner with the smallest coordinates has the voxel's own coordinates.
fn face_corners(voxel: [i32; 3], face: usize) -> [[i32; 3]; 4] {
    let (axis, high) = (face / 2, face.is_multiple_of(2));
    let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
    let corner = |du: i32, dv: i32| {
        let mut at = voxel;
        at[axis] += i32::from(high);
        at[u] += du;
        at[v] += dv;
        at
    };
    let ring = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
    if high { ring } else { [ring[0], ring[3], ring[2], ring[1]] }
}

/// Returns the twin of each edge of the quadrangles; see [`QuadMesh`].
fn twins(corners: &[[[i32; 3]; 4]], voxels: &[usize]) -> Vec<u32> {
    // Edges are sorted by their position in the lattice; there are two or four edges at each position.
    let ends = |edge: u32| {
        let quad = &corners[edge as usize / 4];
        let (a, b) = (quad[edge as usize % 4], quad[(edge as usize + 1) % 4]);
        (a.min(b), a.max(b))
    };
    let mut edges: Vec<u32> = (0..4 * corners.len() as u32).collect();
    // Edges at the same position are sorted by voxel, so that edges of the same voxel become twins.
    edges.sort_unstable_by_key(|&edge| (ends(edge), voxels[edge as usize / 4], edge));
    let mut twins = vec![0; edges.len()];
    for pair in edges.chunks_exact(2) {
        debug_assert_eq!(ends(pair[0]), ends(pair[1]));
        twins[pair[0] as usize] = pair[1];
        twins[pair[1] as usize] = pair[0];
    }
    twins
}

/// Returns the vertex at each corner 4 q + k (corner k of quadrangle q), and the position of each vertex.
fn vertices(corners: &[[[i32; 3]; 4]], twins: &[u32]) -> (Vec<u32>, Vec<[i32; 3]>) {
    let mut of = vec![u32::MAX; twins.len()];
    let mut places = Vec::new();
    for start in 0..of.len() {
        if of[start] != u32::MAX {
            continue;
        }
        let vertex = places.len() as u32;
        places.push(corners[start / 4][start % 4]);
        // Visits the quadrangles around the vertex. The next quadrangle is the one across the edge that ends at the
        // vertex.
        let mut corner = start;
        while of[corner] == u32::MAX {
            of[corner] = vertex;
            let arriving = corner / 4 * 4 + (corner + 3) % 4;
            // The twin runs in the opposite direction, so it starts at the vertex.
            corner = twins[arriving] as usize;
        }
    }
    (of, places)
}
