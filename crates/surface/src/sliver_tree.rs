//! Finds the nearest triangle to a point, and the triangles along a segment, in a mesh of slivers.
//!
//! Axis-aligned boxes of long thin triangles are about as large in all directions as the triangles are long. If the
//! triangles share a pole, nearly all their boxes overlap, so a search in a tree of such boxes visits a large part of
//! the triangles. Boxes rotated to the orientation of their triangles are as thin as the triangles. In a fan of radius
//! 1, a point at distance r from the pole then lies in the boxes of 1 / r leaves. On average over the fan's area, this
//! is two leaves, for any number of triangles.
//!
//! Each node has the box of its triangles in the frame (longest edge, normal) of one of the triangles, or the
//! axis-aligned box if that is smaller (S. Gottschalk, M. Lin and D. Manocha, "OBBTree: a hierarchical structure for
//! rapid interference detection", SIGGRAPH 1996, with a triangle's frame instead of a covariance). The tree is built in
//! O(n log n) time and takes 150 bytes per triangle.

use std::cmp::Ordering;
use std::collections::BinaryHeap;

use crate::geometry::{Vec3, cross, dot, sub};

/// Largest number of triangles in a leaf.
const LEAF: usize = 2;

/// A mesh is treated as a mesh of slivers if the sum of the squared longest edges of its triangles exceeds this
/// multiple of its area. The quotient is 2.3 for equilateral triangles, and about 10 for typical meshes.
const THIN: f64 = 100.0;

/// A search tree over triangles.
pub(crate) struct SliverTree {
    nodes: Vec<Node>,
    /// Indices of the triangles. The indices of each node's triangles are contiguous.
    order: Vec<u32>,
}

struct Node {
    centre: Vec3,
    axes: [Vec3; 3],
    half: Vec3,
    /// Start and end (exclusive) of the node's triangles in `order`.
    triangles: [u32; 2],
    /// Index of the second child; 0 for a leaf. The first child directly follows its parent.
    other: u32,
}

impl Node {
    /// Returns a lower bound on the squared distance from a point to the node's triangles.
    fn bound(&self, point: Vec3) -> f64 {
        let off = sub(point, self.centre);
        (0..3).map(|k| (dot(self.axes[k], off).abs() - self.half[k]).max(0.0).powi(2)).sum()
    }
}

/// Bound on the rounding errors of points and boxes inside the unit sphere, with a margin.
const ROUNDING: f64 = 1e-14;

impl Node {
    /// Returns whether the segment from the origin to `end`, which has length at most 1, comes within `slack` of the
    /// box.
    fn is_on_the_way(&self, end: Vec3, slack: f64) -> bool {
        let slack = slack + ROUNDING;
        let (mut first, mut last) = (0.0_f64, 1.0_f64);
        for k in 0..3 {
            let (origin, step) = (-dot(self.axes[k], self.centre), dot(self.axes[k], end));
            let half = self.half[k] + slack;
            if step.abs() < f64::MIN_POSITIVE {
                if origin.abs() > half {
                    return false;
                }
                continue;
            }
            let (enters, leaves) = ((-half - origin) / step, (half - origin) / step);
            first = first.max(enters.min(leaves));
            last = last.min(enters.max(leaves));
        }
        // The tolerance covers segments that end on a corner of a triangle.
        first <= last + ROUNDING
    }
}

/// A node to be visited. Entries are ordered such that the greatest one has the smallest bound and, in case of ties,
/// the smallest index.
#[derive(PartialEq)]
struct Entry {
    bound: f64,
    node: usize,
}

impl Eq for Entry {}

impl PartialOrd for Entry {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Entry {
    fn cmp(&self, other: &Self) -> Ordering {
        other.bound.total_cmp(&self.bound).then(other.node.cmp(&self.node))
    }
}

const ALONG: [Vec3; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn length(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

fn longest([a, b, c]: [Vec3; 3]) -> Vec3 {
    let edges = [sub(b, a), sub(c, b), sub(a, c)];
    edges.into_iter().fold(edges[0], |most, edge| if dot(edge, edge) > dot(most, most) { edge } else { most })
}

/// Returns whether the triangles are so thin that nearly all of their axis-aligned boxes would overlap.
pub(crate) fn is_of_slivers(triangles: &[[Vec3; 3]]) -> bool {
    let squares: f64 = triangles.iter().map(|&t| dot(longest(t), longest(t))).sum();
    let area: f64 = triangles.iter().map(|[a, b, c]| 0.5 * length(cross(sub(*b, *a), sub(*c, *a)))).sum();
    squares.is_finite() && squares > THIN * area
}

/// Returns a triangle's orthonormal frame: the direction of its longest edge, the direction perpendicular to that edge
/// in the triangle's plane, and the normal. Returns the coordinate axes for a triangle without area.
fn frame(triangle: [Vec3; 3]) -> [Vec3; 3] {
    let [a, b, c] = triangle;
    let (edge, normal) = (longest(triangle), cross(sub(b, a), sub(c, a)));
    let (l, m) = (length(edge), length(normal));
    if !(l.is_normal() && m.is_normal()) {
        return ALONG;
    }
    let edge = edge.map(|x| x / l);
    // The computed normal of a sliver is inaccurate and not exactly perpendicular to the edge, so the frame is made
    // orthogonal.
    let across = cross(normal.map(|x| x / m), edge);
    let n = length(across);
    if n.is_nan() || n <= 0.5 {
        return ALONG;
    }
    let across = across.map(|x| x / n);
    [edge, across, cross(edge, across)]
}

impl SliverTree {
    /// Builds the tree. The triangles' coordinates must be finite.
    pub(crate) fn new(triangles: &[[Vec3; 3]]) -> Self {
        let mut tree = Self { nodes: Vec::new(), order: (0..triangles.len() as u32).collect() };
        if !triangles.is_empty() {
            let centroids: Vec<Vec3> =
                triangles.iter().map(|[a, b, c]| std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0)).collect();
            tree.build(triangles, &centroids, 0, triangles.len());
        }
        tree
    }

    /// Adds a node for `order[first..end]`, and its descendants. Each range is halved, so the depth is log2 of the
    /// number of triangles.
    fn build(&mut self, triangles: &[[Vec3; 3]], centroids: &[Vec3], first: usize, end: usize) {
        let part = &mut self.order[first..end];
        let (low, high) = crate::geometry::bounds(part.iter().map(|&t| centroids[t as usize]));
        let spread = sub(high, low);
        let axis = (0..3).fold(0, |most, k| if spread[k] > spread[most] { k } else { most });
        let half = part.len() / 2;
        let key = |t: u32| centroids[t as usize][axis];
        part.select_nth_unstable_by(half, |&s, &t| key(s).total_cmp(&key(t)).then(s.cmp(&t)));
        let middle = triangles[part[half] as usize];
        let corners = || part.iter().flat_map(|&t| triangles[t as usize]);
        let box_in = |axes: [Vec3; 3]| {
            let (low, high) = crate::geometry::bounds(corners().map(|p| axes.map(|axis| dot(axis, p))));
            // Boxes are enlarged by a few rounding errors, so that they contain their triangles.
            let half: Vec3 = std::array::from_fn(|k| {
                0.5 * (high[k] - low[k]) + 8.0 * f64::EPSILON * high[k].abs().max(low[k].abs())
            });
            let middle: Vec3 = std::array::from_fn(|k| 0.5 * (low[k] + high[k]));
            let centre = std::array::from_fn(|i| (0..3).map(|k| axes[k][i] * middle[k]).sum());
            let surface = half[0] * half[1] + half[1] * half[2] + half[2] * half[0];
            (surface, centre, axes, half)
        };
        let (turned, along) = (box_in(frame(middle)), box_in(ALONG));
        let (_, centre, axes, extent) = if turned.0 < along.0 { turned } else { along };
        let node = self.nodes.len();
        self.nodes.push(Node { centre, axes, half: extent, triangles: [first as u32, end as u32], other: 0 });
        if end - first > LEAF {
            self.build(triangles, centroids, first, first + half);
            self.nodes[node].other = self.nodes.len() as u32;
            self.build(triangles, centroids, first + half, end);
        }
    }

    /// Returns the triangle for which `distance` returns the smallest distance, with the result of `distance` for this
    /// triangle; `None` if there are no triangles. `distance` must not return less than the distance from the point to
    /// the triangle.
    pub(crate) fn nearest<T>(&self, point: Vec3, mut distance: impl FnMut(u32) -> (f64, T)) -> Option<(u32, (f64, T))> {
        let mut best: Option<(u32, (f64, T))> = None;
        // Nodes are visited in order of their bounds. In another order, the search for a point next to a fan of
        // triangles would visit all triangles on the fan's far side, because they are all about as far from the point
        // as the fan's pole.
        let mut left = BinaryHeap::with_capacity(64);
        if let Some(root) = self.nodes.first() {
            left.push(Entry { bound: root.bound(point), node: 0 });
        }
        while let Some(Entry { bound, node: at }) = left.pop() {
            if best.as_ref().is_some_and(|(_, (least, _))| bound >= least * least) {
                break;
            }
            let node = &self.nodes[at];
            if node.other == 0 {
                for &triangle in &self.order[node.triangles[0] as usize..node.triangles[1] as usize] {
                    let found = distance(triangle);
                    if best.as_ref().is_none_or(|(_, (least, _))| found.0 < *least) {
                        best = Some((triangle, found));
                    }
                }
                continue;
            }
            left.extend([at + 1, node.other as usize].map(|node| Entry { bound: self.nodes[node].bound(point), node }));
        }
        best.filter(|(_, (distance, _))| distance.is_finite())
    }

    /// Visits the triangles whose boxes come within `slack` of the segment from the origin to `end`, in an unspecified
    /// order. Triangles and segment must lie inside the unit sphere.
    pub(crate) fn along(&self, end: Vec3, slack: f64, mut visit: impl FnMut(u32)) {
        // 34 entries suffice for the tree's depth, which is at most log2 of the largest number of triangles.
        let mut left = Vec::with_capacity(34);
        if !self.nodes.is_empty() {
            left.push(0);
        }
        while let Some(at) = left.pop() {
            let node: &Node = &self.nodes[at];
            if !node.is_on_the_way(end, slack) {
                continue;
            }
            if node.other == 0 {
                self.order[node.triangles[0] as usize..node.triangles[1] as usize].iter().copied().for_each(&mut visit);
            } else {
                left.extend([node.other as usize, at + 1]);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{bipyramid, icosphere};
    use crate::mesh::Mesh;
    use crate::nearest::TriangleTree;

    /// Returns a double pyramid that isn't aligned with the axes.
    fn fan(sides: u32) -> Mesh {
        let turned = |[x, y, z]: Vec3| [0.8 * x + 0.6 * z, y, 0.8 * z - 0.6 * x];
        let mesh = bipyramid(sides);
        mesh.with_vertices(mesh.vertices.iter().map(|&place| turned(place)).collect())
    }

    fn corners(mesh: &Mesh) -> Vec<[Vec3; 3]> {
        mesh.faces.iter().map(|face| face.map(|v| mesh.vertices[v as usize])).collect()
    }

    #[test]
    fn slivers_are_told_from_triangles() {
        assert!(is_of_slivers(&corners(&fan(1000))));
        assert!(!is_of_slivers(&corners(&fan(50))) && !is_of_slivers(&corners(&icosphere(2))) && !is_of_slivers(&[]));
    }

    /// The tests include triangles so thin that the computed normal isn't perpendicular to the longest edge.
    #[test]
    fn frames_are_orthonormal() {
        let mut turned = 0;
        for k in 0..2000 {
            let t = f64::from(k);
            let (b, across) = ([t.sin(), t.cos(), (1.3 * t).sin()], [(2.1 * t).cos(), (0.7 * t).sin(), 0.3]);
            let height = 10f64.powi(-(k % 16));
            let a = [0.1, -0.2, 0.3];
            let c = std::array::from_fn(|i| a[i] + 0.37 * (b[i] - a[i]) + height * across[i]);
            let axes = frame([a, b, c]);
            turned += usize::from(axes != ALONG);
            for i in 0..3 {
                for j in 0..3 {
                    let wanted = if i == j { 1.0 } else { 0.0 };
                    assert!((dot(axes[i], axes[j]) - wanted).abs() < 1e-14, "{k}: {axes:?}");
                }
            }
        }
        assert!(turned > 1500, "{turned}");
        assert_eq!(frame([[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]), ALONG);
    }

    #[test]
    fn few_triangles_are_looked_at_however_many_there_are_and_the_nearest_is_found() {
        let mut looked_at = Vec::new();
        for sides in [500, 8000] {
            let mesh = fan(sides);
            let (triangles, all) = (corners(&mesh), TriangleTree::new(&mesh));
            let tree = SliverTree::new(&triangles);
            let (mut count, points) = (0_usize, 400_u32);
            for k in 0..points {
                // The points tested are centroids of triangles, and points at a distance from the surface.
                let [a, b, c] = triangles[(k * 37 % (2 * sides)) as usize];
                let t = f64::from(k);
                let off = if k % 2 == 0 { 0.0 } else { 0.2 * t.sin() };
                let point: Vec3 = std::array::from_fn(|i| (a[i] + b[i] + c[i]) / 3.0 * (1.0 + off));
                let found = tree.nearest(point, |triangle| {
                    count += 1;
                    let found = all.on_triangle(triangle, point);
                    (found.distance, found)
                });
                let (_, (distance, found)) = found.unwrap();
                let least = (0..mesh.faces.len() as u32).step_by(if k < 20 { 1 } else { mesh.faces.len() });
                for other in least {
                    assert!(distance <= all.on_triangle(other, point).distance);
                }
                // The tolerance covers rounding errors, amplified by the thinness of a sliver.
                assert!(distance <= off.abs() + 1e-12, "{found:?}");
                assert_eq!(all.nearest(point).unwrap().distance.to_bits(), distance.to_bits());
            }
            looked_at.push(count as f64 / f64::from(points));
        }
        assert!(looked_at[1] < 12.0 && looked_at[1] < 1.5 * looked_at[0], "{looked_at:?}");
    }
}
