//! Fills the two holes that a cut opens, one on each side.

use spharm_monitor::{Interrupted, Monitor};
use spharm_surface::nearest::TriangleTree;

use super::disc::Disc;
use super::fair::Fairing;
use super::report::Kind;
use crate::geometry::{Vec3, add, area, cross, dot, norm, scale, sub};

/// Number of sweeps that smooth the directions in which a filling continues the surface. Smoothing is needed because
/// loops of edges zigzag.
const SWEEPS: usize = 2;

/// The rim of a cut or of a hole, a closed loop of edges. A cut has separate vertices for the two sides of the loop.
pub(super) struct Rim<'a> {
    /// Vertices on the right of the loop, in the loop's order.
    pub(super) right: &'a [u32],
    /// Vertices on the left of the loop, at the same positions as those on the right; empty for a hole, which has only
    /// one side.
    pub(super) left: &'a [u32],
    /// Positions of the rim's vertices.
    pub(super) places: &'a [Vec3],
    /// Unit normals of the surface at the rim's vertices, pointing to the side from which triangles are
    /// counter-clockwise.
    pub(super) normals: &'a [Vec3],
    /// The surface before it was cut.
    pub(super) surface: &'a TriangleTree,
}

/// The fillings of the two sides of a cut.
pub(super) struct Filling {
    /// Positions of the new vertices.
    pub(super) vertices: Vec<Vec3>,
    /// Triangles over the rim's vertices and the new vertices.
    pub(super) faces: Vec<[u32; 3]>,
    /// The side of the surface on which a film spanned across the loop lies, assuming that the triangles' normals point
    /// outwards.
    pub(super) kind: Kind,
    /// Total area of the two fillings.
    pub(super) area: f64,
}

impl Rim<'_> {
    /// Fills the right side and, unless the rim belongs to a hole, also the left side. The indices of new vertices
    /// start at `first`.
    pub(super) fn fill(&self, first: u32, monitor: &dyn Monitor) -> Result<Filling, Interrupted> {
        let count = self.places.len();
        let lengths: Vec<f64> = (0..count).map(|i| norm(sub(self.places[(i + 1) % count], self.places[i]))).collect();
        let disc = Disc::new(count);
        let fairing = Fairing::new(&disc, monitor)?;
        let flat = fairing.flat(self.places);
        let inwards: Vec<Vec3> = disc.at_ring(&flat).iter().zip(self.places).map(|(p, q)| unit(sub(*p, *q))).collect();
        let beyond = self.beyond(&inwards);
        let (kind, steps) = (self.kind(&lengths, &inwards), fairing.steps(&flat));
        let mut filling = Filling { vertices: Vec::new(), faces: Vec::new(), kind, area: 0.0 };
        // The two sides face each other, so their fillings continue the surface in opposite directions.
        for (rim, sign) in [(self.right, 1.0), (self.left, -1.0)].into_iter().filter(|(rim, _)| !rim.is_empty()) {
            let positions = fairing.smooth(&flat, &self.outside(&beyond, &steps, sign));
            let new = first + filling.vertices.len() as u32;
            let vertex = |v: u32| rim.get(v as usize).copied().unwrap_or_else(|| new + v - count as u32);
            for &triangle in &disc.triangles {
                let [a, b, c] = triangle.map(vertex);
                filling.faces.push(if sign > 0.0 { [a, b, c] } else { [a, c, b] });
                filling.area += area(triangle.map(|v| positions[v as usize]));
            }
            filling.vertices.extend(&positions[count..]);
        }
        Ok(filling)
    }

    /// Returns, at each vertex of the loop, the unit vector along which the surface continues from the right of the
    /// loop to its left. The vector is perpendicular to the loop and lies in the tangent plane.
    fn beyond(&self, inwards: &[Vec3]) -> Vec<Vec3> {
        let count = self.places.len();
        let around = |i: usize| ((i + count - 1) % count, (i + 1) % count);
        let at = |i: usize| {
            let (before, after) = around(i);
            let along = sub(self.places[after], self.places[before]);
            let beyond = cross(self.normals[i], along);
            if norm(beyond) > 1e-6 * norm(along) { unit(beyond) } else { inwards[i] }
        };
        let mut beyond: Vec<Vec3> = (0..count).map(at).collect();
        for _ in 0..SWEEPS {
            let smoothed = (0..count).map(|i| {
                let (before, after) = around(i);
                let sum = add(scale(beyond[i], 2.0), add(beyond[before], beyond[after]));
                let normal = self.normals[i];
                let within = sub(sum, scale(normal, dot(sum, normal)));
                if norm(within) > 1e-6 { unit(within) } else { beyond[i] }
            });
            beyond = smoothed.collect();
        }
        beyond
    }

    /// Returns two rings of points on the surface, one and two steps away from the loop (`steps` contains the step at
    /// each vertex): on the loop's right if `sign` is 1, on its left if -1.
    fn outside(&self, beyond: &[Vec3], steps: &[f64], sign: f64) -> Vec<Vec3> {
        let ring = |number: f64| {
            let points = self.places.iter().zip(beyond).zip(steps);
            points.map(move |((&place, &beyond), step)| {
                let point = sub(place, scale(beyond, sign * number * step));
                self.surface.nearest(point).map_or(point, |nearest| nearest.point)
            })
        };
        ring(1.0).chain(ring(2.0)).collect()
    }

    fn kind(&self, lengths: &[f64], inwards: &[Vec3]) -> Kind {
        let outside: f64 =
            lengths.iter().zip(inwards).zip(self.normals).map(|((length, &d), &normal)| length * dot(d, normal)).sum();
        if outside > 0.0 { Kind::Tunnel } else { Kind::Handle }
    }
}

/// Returns a / |a|, or zero if a is zero.
fn unit(a: Vec3) -> Vec3 {
    spharm_surface::geometry::unit(a)
}
