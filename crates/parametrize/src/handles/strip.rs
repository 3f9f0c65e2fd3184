//! Triangulates the rim of a hole without new vertices and with short interior edges. If the hole is a slit, the
//! triangles form a strip.

use spharm_surface::repair::LEAST_AREA;

use crate::geometry::{Vec3, area, norm, sub};

/// Returns the triangulation of a closed polygon of n vertices with the least total length of its interior edges (G.
/// Klincsek, Ann. Discrete Math. 9, 1980): n - 2 triangles, each over three vertices in the polygon's order. Interior
/// edges (i, j) for which `taken` returns true aren't used. Returns `None` if every triangulation has such an edge or a
/// triangle without area.
///
/// Cost: about n^3 / 6 steps, and 10 n^2 bytes of memory.
pub(super) fn triangulated(places: &[Vec3], taken: impl Fn(usize, usize) -> bool) -> Option<Vec<[usize; 3]>> {
    let count = places.len();
    let length = |i: usize, j: usize| norm(sub(places[i], places[j]));
    // For the part of the polygon from vertex i to vertex j, closed by edge ij: the least total length of interior
    // edges, including edge ij, and the third vertex of the triangle at edge ij.
    let mut least = vec![0.0; count * count];
    let mut third = vec![0_u16; count * count];
    for span in 2..count {
        for i in 0..count - span {
            let j = i + span;
            let is_rim = i == 0 && j == count - 1;
            let mut best = f64::INFINITY;
            if is_rim || !taken(i, j) {
                let edge = length(i, j);
                for k in i + 1..j {
                    let total = least[i * count + k] + least[k * count + j];
                    if total < best {
                        let longest = edge.max(length(i, k)).max(length(k, j));
                        if area([places[i], places[k], places[j]]) > LEAST_AREA * longest * longest {
                            best = total;
                            third[i * count + j] = k as u16;
                        }
                    }
                }
                best += if is_rim { 0.0 } else { edge };
            }
            least[i * count + j] = best;
        }
    }
    if count < 3 || least[count - 1].is_infinite() {
        return None;
    }
    let (mut triangles, mut parts) = (Vec::with_capacity(count - 2), vec![(0, count - 1)]);
    while let Some((i, j)) = parts.pop() {
        if j > i + 1 {
            let k = usize::from(third[i * count + j]);
            triangles.push([i, k, j]);
            parts.extend([(i, k), (k, j)]);
        }
    }
    Some(triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn total(places: &[Vec3], triangles: &[[usize; 3]]) -> f64 {
        triangles.iter().map(|triangle| area(triangle.map(|v| places[v]))).sum()
    }

    /// The triangulation of a polygon with straight sides consists of n - 2 triangles, none of them flat, which
    /// together have the polygon's area.
    #[test]
    fn a_rectangle_with_points_on_its_sides_is_covered_once() {
        let mut places = Vec::new();
        for i in 0..10 {
            places.push([f64::from(i), 0.0, 0.0]);
        }
        for i in 0..4 {
            places.push([10.0, f64::from(i), 0.0]);
        }
        for i in 0..10 {
            places.push([10.0 - f64::from(i), 4.0, 0.0]);
        }
        for i in 0..4 {
            places.push([0.0, 4.0 - f64::from(i), 0.0]);
        }
        let triangles = triangulated(&places, |_, _| false).unwrap();
        assert_eq!(triangles.len(), places.len() - 2);
        assert!((total(&places, &triangles) - 40.0).abs() < 1e-12);
        assert!(triangles.iter().all(|triangle| area(triangle.map(|v| places[v])) > 0.4));
    }

    /// A slit along half a circle is filled by a strip. A flat disc would have the area of half the circle.
    #[test]
    fn a_curved_slit_gets_a_strip() {
        let at = |i: u32, radius: f64| {
            let angle = std::f64::consts::PI * f64::from(i) / 40.0;
            [radius * angle.cos(), radius * angle.sin(), 0.0]
        };
        let places: Vec<Vec3> = (0..41).map(|i| at(i, 1.0)).chain((0..41).rev().map(|i| at(i, 0.99))).collect();
        let triangles = triangulated(&places, |_, _| false).unwrap();
        let strip = 0.5 * std::f64::consts::PI * (1.0 - 0.99_f64.powi(2));
        assert!((total(&places, &triangles) / strip - 1.0).abs() < 0.01);
        // An edge that already exists isn't used, even if it is the shortest edge across the slit.
        let avoided = triangulated(&places, |i, j| (i, j) == (20, 61)).unwrap();
        let has_edge = |triangles: &[[usize; 3]]| triangles.iter().any(|t| t.contains(&20) && t.contains(&61));
        assert!(has_edge(&triangles) && !has_edge(&avoided));
        assert!(
            triangulated(&places[..4], |_, _| true).is_none() && triangulated(&places[..2], |_, _| false).is_none()
        );
    }
}
