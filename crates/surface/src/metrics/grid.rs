//! Spreads sample points evenly over a surface.

use crate::geometry::{Vec3, add, dot, face_normal, scale, sub};
use crate::mesh::Mesh;

/// The division of a mesh's triangles into pieces of similar size, each with a sample point.
pub(super) struct Grid {
    /// The corners of each triangle, and the number of pieces along each of its edges.
    pub(super) triangles: Vec<([Vec3; 3], u32)>,
    pub(super) areas: Vec<f64>,
    pub(super) area: f64,
    pub(super) spacing: f64,
}

impl Grid {
    pub(super) fn new(mesh: &Mesh, wanted: usize) -> Self {
        let corners = |face: &[u32; 3]| face.map(|v| mesh.vertices[v as usize]);
        let area_of = |face: &[u32; 3]| {
            let normal = face_normal(corners(face));
            0.5 * dot(normal, normal).sqrt()
        };
        let longest = |face: &[u32; 3]| {
            let [a, b, c] = corners(face);
            let length = |u: Vec3, v: Vec3| dot(sub(u, v), sub(u, v)).sqrt();
            length(a, b).max(length(b, c)).max(length(c, a))
        };
        let areas: Vec<f64> = mesh.faces.iter().map(area_of).collect();
        let edges: Vec<f64> = mesh.faces.iter().map(longest).collect();
        let area: f64 = areas.iter().sum();
        let wanted = wanted.max(1);
        // Edge length of an equilateral triangle whose area is the total area divided by the number of points.
        let mut step = (4.0 / 3.0_f64.sqrt() * area / wanted as f64).sqrt();
        let pieces = |edge: f64, step: f64| (edge / step).round().clamp(1.0, 4096.0) as u32;
        let count = |step: f64| edges.iter().map(|&e| u64::from(pieces(e, step)).pow(2)).sum::<u64>();
        let most = (wanted.max(mesh.faces.len()) as u64).saturating_mul(8);
        // Slivers have long edges and almost no area, so a mesh with slivers could get too many points. In this case,
        // the step is increased. For a surface without area, `is_normal` ends the loop.
        while step.is_normal() && count(step) > most {
            step *= std::f64::consts::SQRT_2;
        }
        let numbers = edges.iter().map(|&e| if step.is_normal() { pieces(e, step) } else { 1 });
        let triangles: Vec<_> = mesh.faces.iter().map(corners).zip(numbers).collect();
        let spacing = triangles.iter().zip(&edges).map(|((_, n), e)| e / f64::from(*n)).fold(0.0, f64::max);
        Self { triangles, areas, area, spacing }
    }
}

/// Returns the centroids of a triangle's n^2 congruent pieces.
pub(super) fn centroids([a, b, c]: [Vec3; 3], n: u32) -> impl Iterator<Item = Vec3> {
    let (u, v) = (scale(sub(b, a), 1.0 / f64::from(n)), scale(sub(c, a), 1.0 / f64::from(n)));
    let at = move |s: f64, t: f64| add(a, add(scale(u, s), scale(v, t)));
    (0..n).flat_map(move |i| {
        (0..n - i).flat_map(move |j| {
            let (s, t) = (f64::from(i), f64::from(j));
            let upright = at(s + 1.0 / 3.0, t + 1.0 / 3.0);
            let turned = (i + j + 1 < n).then(|| at(s + 2.0 / 3.0, t + 2.0 / 3.0));
            std::iter::once(upright).chain(turned)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangles_points_are_the_centroids_of_its_pieces() {
        let corners = [[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]];
        for n in 1..6 {
            let points: Vec<Vec3> = centroids(corners, n).collect();
            assert_eq!(points.len(), (n * n) as usize);
            let mean = scale(points.iter().copied().fold([0.0; 3], add), 1.0 / points.len() as f64);
            assert!((mean[0] - 1.0).abs() < 1e-14 && (mean[1] - 1.0).abs() < 1e-14, "{mean:?}");
            assert!(points.iter().all(|p| p[0] > 0.0 && p[1] > 0.0 && p[0] + p[1] < 3.0));
        }
    }
}
