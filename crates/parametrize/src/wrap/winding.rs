//! Computes generalized winding numbers. The winding number of a point is the number of times that a surface encloses
//! the point. The winding number is defined even for surfaces with holes, overlapping pieces or self-intersections.
//!
//! The winding number of a closed surface is 1 inside and 0 outside. The winding number of an open surface is the solid
//! angle that the surface covers as seen from the point, divided by 4 pi. Near a hole the winding number changes
//! gradually, and the points with the winding number 0.5 form a surface that closes the hole. Source: Jacobson, Kavan
//! and Sorkine-Hornung, "Robust inside-outside segmentation using generalized winding numbers", ACM Trans. Graphics 32
//! (2013), equation 5.
//!
//! Triangles far from a point are summed up as one dipole: Barill, Dickson, Schmidt, Levin and Jacobson, "Fast winding
//! numbers for soups and clouds", ACM Trans. Graphics 37 (2018), equation 13. A point near the surface takes O(log n)
//! steps for n triangles.

use std::f64::consts::PI;

use spharm_surface::Mesh;
use spharm_surface::geometry::{bounds, face_normal};

use crate::geometry::{Vec3, add, cross, dot, scale, sub};

/// Largest number of triangles in a leaf of the tree.
const LEAF: usize = 8;
/// A group of triangles is treated as a dipole for points farther from its centre than this multiple of its radius. The
/// error of the winding number is then below 0.02 for each of the few groups nearest to the point. This error is small
/// enough to distinguish the winding numbers 0, 0.5 and 1.
const FAR: f64 = 2.5;

/// A group of triangles.
struct Node {
    /// Mean of the triangles' centroids, weighted by area.
    centre: Vec3,
    /// Square of the distance from `centre` beyond which the group is treated as a dipole.
    far: f64,
    /// Sum of the triangles' normals, whose lengths are the triangles' areas.
    dipole: Vec3,
    /// Number of nodes of this group and all its subgroups. In the list of nodes, the next node outside of the group
    /// comes this many places later.
    nodes: usize,
    /// Indices of the triangles of this group if the node is a leaf; empty otherwise.
    triangles: std::ops::Range<usize>,
}

/// A search tree of a surface's triangles. Nodes are in depth-first order.
pub(super) struct WindingNumbers {
    nodes: Vec<Node>,
    triangles: Vec<[Vec3; 3]>,
}

impl WindingNumbers {
    /// Builds the search tree in O(n log n) time.
    pub(super) fn new(mesh: &Mesh) -> Self {
        let triangles = mesh.faces.iter().map(|face| face.map(|v| mesh.vertices[v as usize])).collect();
        let mut tree = Self { nodes: Vec::with_capacity(mesh.faces.len() / 2), triangles };
        tree.add(0..mesh.faces.len());
        tree
    }

    /// Adds a node for a group of triangles. If the group is too large for a leaf, it is halved along its longest side,
    /// and nodes for both halves are added, too.
    fn add(&mut self, range: std::ops::Range<usize>) {
        let own = &mut self.triangles[range.clone()];
        let mut node = Node { centre: [0.0; 3], far: 0.0, dipole: [0.0; 3], nodes: 1, triangles: range.clone() };
        let mut area = 0.0;
        for corners in &*own {
            let normal = scale(face_normal(*corners), 0.5);
            let size = dot(normal, normal).sqrt();
            area += size;
            node.dipole = add(node.dipole, normal);
            node.centre = add(node.centre, [0, 1, 2].map(|k| size * centroid(corners, k)));
        }
        let count = own.len().max(1) as f64;
        for k in 0..3 {
            let mean = own.iter().map(|corners| centroid(corners, k)).sum::<f64>() / count;
            node.centre[k] = if area > 0.0 { node.centre[k] / area } else { mean };
        }
        let radius = own.as_flattened().iter().map(|&corner| square(sub(corner, node.centre))).fold(0.0, f64::max);
        node.far = FAR * FAR * radius;
        let at = self.nodes.len();
        self.nodes.push(node);
        if range.len() > LEAF {
            let own = &mut self.triangles[range.clone()];
            let (low, high) = bounds(own.as_flattened().iter().copied());
            let axis = (0..3).max_by(|&a, &b| (high[a] - low[a]).total_cmp(&(high[b] - low[b]))).unwrap_or(0);
            let middle = own.len() / 2;
            own.select_nth_unstable_by(middle, |a, b| centroid(a, axis).total_cmp(&centroid(b, axis)));
            self.nodes[at].triangles = 0..0;
            self.add(range.start..range.start + middle);
            self.add(range.start + middle..range.end);
        }
        self.nodes[at].nodes = self.nodes.len() - at;
    }

    /// Returns the winding number of the surface around a point.
    pub(super) fn at(&self, point: Vec3) -> f64 {
        let (mut sum, mut next) = (0.0, 0);
        while let Some(node) = self.nodes.get(next) {
            let to = sub(node.centre, point);
            let distance = square(to);
            if distance > node.far {
                sum += dot(to, node.dipole) / (distance * distance.sqrt());
                next += node.nodes;
            } else {
                sum += self.triangles[node.triangles.clone()]
                    .iter()
                    .map(|corners| solid_angle(corners, point))
                    .sum::<f64>();
                next += 1;
            }
        }
        sum / (4.0 * PI)
    }
}

fn square(v: Vec3) -> f64 {
    dot(v, v)
}

fn centroid(corners: &[Vec3; 3], k: usize) -> f64 {
    (corners[0][k] + corners[1][k] + corners[2][k]) / 3.0
}

/// Returns the solid angle that a triangle covers as seen from a point, positive if the triangle is clockwise as seen
/// from the point. Source: van Oosterom and Strackee, "The solid angle of a plane triangle", IEEE Trans. Biomedical
/// Engineering 30 (1983), equation 8.
fn solid_angle(corners: &[Vec3; 3], point: Vec3) -> f64 {
    let [a, b, c] = corners.map(|corner| sub(corner, point));
    let [la, lb, lc] = [a, b, c].map(|v| square(v).sqrt());
    let above = dot(a, cross(b, c));
    let below = la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb;
    2.0 * above.atan2(below)
}

#[cfg(test)]
mod tests {
    use spharm_surface::generate::icosphere;

    use super::*;

    #[test]
    fn a_closed_surface_winds_once_around_its_inside() {
        let sphere = icosphere(4);
        let tree = WindingNumbers::new(&sphere);
        for radius in [0.0, 0.3, 0.9, 0.99, 1.01, 1.2, 3.0, 40.0] {
            for direction in [[1.0, 0.0, 0.0], [0.6, -0.48, 0.64], [-0.36, 0.48, 0.8]] {
                let found = tree.at(direction.map(|x| radius * x));
                let expected = f64::from(u8::from(radius < 1.0));
                assert!((found - expected).abs() < 0.03, "{found} at {radius}");
            }
        }
    }

    #[test]
    fn the_tree_gives_the_sum_over_all_triangles() {
        // The surface is half of a sphere. The winding numbers of this surface are the solid angles that it covers,
        // divided by 4 pi.
        let mut half = icosphere(4);
        half.faces.retain(|face| face.iter().all(|&v| half.vertices[v as usize][2] > -0.01));
        let tree = WindingNumbers::new(&half);
        for i in 0..200 {
            let t = f64::from(i);
            let point = [1.5 * t.sin(), 1.5 * (2.3 * t).cos(), 1.2 * (0.7 * t).sin()];
            let triangles = half.faces.iter().map(|face| face.map(|v| half.vertices[v as usize]));
            let expected = triangles.map(|corners| solid_angle(&corners, point)).sum::<f64>() / (4.0 * PI);
            assert!((tree.at(point) - expected).abs() < 0.02, "{} for {expected} at {point:?}", tree.at(point));
        }
    }
}
