//! Spreads points evenly over the area of a mesh.

use crate::geometry::{Vec3, cross, dot, sub, unit};
use crate::mesh::Mesh;

/// Points on a mesh. Each represents an equal share of the mesh's area.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SpreadPoints {
    /// Positions of the n points.
    pub points: Vec<Vec3>,
    /// For each point, the unit normal of its triangle.
    pub normals: Vec<Vec3>,
    /// For each point, the index of its triangle, counted from 0.
    pub triangles: Vec<u32>,
    /// For each point, the weights of its triangle's corners, with sum 1.
    pub barycentric: Vec<[f64; 3]>,
}

impl SpreadPoints {
    /// Places `count` points. The area, in the order of the triangles, is divided into `count` equal shares, and each
    /// share gets a point. The position within a triangle follows the deterministic sequence R2 of M. Roberts, "The
    /// unreasonable effectiveness of quasirandom sequences" (2018), from term `seed` on. A mesh without area gets no
    /// points.
    #[must_use]
    pub fn new(mesh: &Mesh, count: usize, seed: usize) -> Self {
        let corners = |face: &[u32; 3]| face.map(|v| mesh.vertices[v as usize]);
        let normals: Vec<Vec3> = mesh.faces.iter().map(|face| normal(corners(face))).collect();
        let areas: Vec<f64> = normals.iter().map(|n| 0.5 * dot(*n, *n).sqrt()).collect();
        let step = areas.iter().sum::<f64>() / count as f64;
        let mut spread = Self::default();
        if !(step > 0.0 && step.is_finite()) {
            return spread;
        }
        let mut sum = 0.0;
        for (index, face) in mesh.faces.iter().enumerate() {
            sum += areas[index];
            while spread.points.len() < count && place(spread.points.len(), seed) * step <= sum {
                let [a, b, c] = corners(face);
                let (s, t) = in_triangle(spread.points.len() + seed);
                spread.points.push(std::array::from_fn(|k| a[k] + s * (b[k] - a[k]) + t * (c[k] - a[k])));
                spread.normals.push(normals[index].map(|v| v / (2.0 * areas[index])));
                spread.triangles.push(index as u32);
                spread.barycentric.push([1.0 - s - t, s, t]);
            }
        }
        spread
    }

    /// Returns every `step`th point.
    #[must_use]
    pub fn every(&self, step: usize) -> Self {
        Self {
            points: self.points.iter().copied().step_by(step).collect(),
            normals: self.normals.iter().copied().step_by(step).collect(),
            triangles: self.triangles.iter().copied().step_by(step).collect(),
            barycentric: self.barycentric.iter().copied().step_by(step).collect(),
        }
    }

    /// Returns the same points on a mesh whose vertices have moved: the triangles and weights stay the same.
    ///
    /// # Panics
    ///
    /// Panics if the mesh has fewer triangles or vertices than the mesh that the points were placed on.
    #[must_use]
    pub fn moved(&self, mesh: &Mesh) -> Self {
        let corners = |triangle: &u32| mesh.faces[*triangle as usize].map(|v| mesh.vertices[v as usize]);
        let points = self.triangles.iter().zip(&self.barycentric);
        let points = points.map(|(triangle, weights)| {
            let [a, b, c] = corners(triangle);
            std::array::from_fn(|k| weights[0] * a[k] + weights[1] * b[k] + weights[2] * c[k])
        });
        Self {
            points: points.collect(),
            normals: self.triangles.iter().map(|triangle| unit(normal(corners(triangle)))).collect(),
            triangles: self.triangles.clone(),
            barycentric: self.barycentric.clone(),
        }
    }
}

/// Returns the cross product of two edges of a triangle. Its length is twice the triangle's area.
fn normal([a, b, c]: [Vec3; 3]) -> Vec3 {
    cross(sub(b, a), sub(c, a))
}

/// The reciprocals of the plastic number and of its square, which generate the sequence R2.
const R2: [f64; 2] = [0.754_877_666_246_692_8, 0.569_840_290_998_053_2];

/// Returns a point's position along the cumulative area of the triangles, in units of the area that one point
/// represents. The position within the point's share of the area follows a golden-section sequence, because otherwise
/// the points could always hit the same positions of a repeating pattern of triangles.
fn place(index: usize, seed: usize) -> f64 {
    index as f64 + (0.5 + 0.618_033_988_749_894_9 * (index + seed) as f64).fract()
}

/// Returns the weights of a triangle's second and third corner for a term of the sequence R2.
fn in_triangle(term: usize) -> (f64, f64) {
    let [s, t] = R2.map(|step| (0.5 + step * term as f64).fract());
    if s + t > 1.0 { (1.0 - s, 1.0 - t) } else { (s, t) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;

    #[test]
    fn each_half_of_a_sphere_has_half_of_the_points() {
        let mesh = icosphere(3);
        for seed in [0, 1000] {
            let spread = SpreadPoints::new(&mesh, 4000, seed);
            assert_eq!(spread.points.len(), 4000);
            for axis in 0..3 {
                let above = spread.points.iter().filter(|p| p[axis] > 0.0).count();
                assert!((1950..=2050).contains(&above), "axis {axis}: {above}");
            }
            for (point, normal) in spread.points.iter().zip(&spread.normals) {
                assert!(dot(*point, *normal) > 0.98, "{point:?} {normal:?}");
            }
        }
    }

    #[test]
    fn points_lie_in_their_triangles_by_area() {
        let vertices =
            vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 5.0], [9.0, 0.0, 5.0], [0.0, 1.0, 5.0]];
        let mesh = Mesh::new(vertices, vec![[0, 1, 2], [3, 4, 5], [0, 0, 0]]);
        let spread = SpreadPoints::new(&mesh, 1000, 0);
        assert_eq!(spread.triangles.iter().filter(|t| **t == 1).count(), 900);
        assert!(
            spread
                .points
                .iter()
                .all(|[x, y, z]| *x >= 0.0 && *y >= 0.0 && x / if *z > 0.0 { 9.0 } else { 1.0 } + y <= 1.0 + 1e-12)
        );
        assert!(SpreadPoints::new(&Mesh::default(), 10, 0).points.is_empty());
        assert_eq!(spread.every(10).points.len(), 100);
        let turned = mesh.with_vertices(mesh.vertices.iter().map(|[x, y, z]| [-y, *x, z + 1.0]).collect());
        let moved = spread.moved(&turned);
        for (before, after) in spread.points.iter().zip(&moved.points) {
            assert!(
                (before[0] - after[1]).abs() + (before[1] + after[0]).abs() + (after[2] - before[2] - 1.0).abs()
                    < 1e-12
            );
        }
    }
}
