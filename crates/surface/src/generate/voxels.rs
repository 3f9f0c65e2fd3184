//! Voxelises closed surfaces.

use ndarray::Array3;

use crate::geometry::Vec3;
use crate::mesh::Mesh;

/// Cubic voxels inside a surface.
#[derive(Debug, Clone)]
pub struct Voxels {
    /// Values indexed by x, y and z: 1 for voxels whose centre is inside the surface, 0 for others.
    pub values: Array3<u8>,
    /// Centre of voxel (0, 0, 0).
    pub origin: Vec3,
}

/// Width of the background around the surface's bounding box, in voxels.
const MARGIN: usize = 2;
/// Displacement along x and y of the tested points from the voxels' centres, relative to the voxel size. Because of it,
/// the lines along z through these points meet no edge of a mesh whose vertices have simple coordinates.
const NUDGE: [f64; 2] = [1.7e-7, 2.9e-7];

impl Voxels {
    /// Returns the voxels of edge length `size` whose centres are inside a closed mesh. The line along z through a
    /// centre is inside the mesh between its first and second crossings of the mesh, between its third and fourth, and
    /// so on.
    ///
    /// # Panics
    ///
    /// Panics if the mesh has no vertex, or the size isn't positive.
    pub fn of(mesh: &Mesh, size: f64) -> Self {
        assert!(!mesh.vertices.is_empty() && size > 0.0, "expected a mesh with vertices and a voxel size above 0");
        let extreme = |k: usize, f: fn(f64, f64) -> f64| mesh.vertices.iter().map(|x| x[k]).reduce(f).unwrap_or(0.0);
        let origin: Vec3 = std::array::from_fn(|k| ((extreme(k, f64::min) / size).floor() - MARGIN as f64) * size);
        let counts: [usize; 3] =
            std::array::from_fn(|k| ((extreme(k, f64::max) - origin[k]) / size).ceil() as usize + MARGIN + 1);
        let crossings = crossings(mesh, size, origin, counts);
        let mut values = Array3::zeros(counts);
        for (column, mut crossings) in crossings.into_iter().enumerate() {
            crossings.sort_by(f64::total_cmp);
            for inside in crossings.chunks_exact(2) {
                // Crossings are z coordinates in voxels, measured from `origin`.
                for z in inside[0].ceil() as usize..=inside[1].floor() as usize {
                    values[[column / counts[1], column % counts[1], z]] = 1;
                }
            }
        }
        Self { values, origin }
    }
}

/// Returns, for each column of voxels along z, the z coordinates at which the column's line crosses the mesh's
/// triangles. Coordinates are in voxels, measured from `origin`.
fn crossings(mesh: &Mesh, size: f64, origin: Vec3, counts: [usize; 3]) -> Vec<Vec<f64>> {
    let mut found = vec![Vec::new(); counts[0] * counts[1]];
    for face in &mesh.faces {
        let corners = face.map(|v| {
            let x = mesh.vertices[v as usize];
            std::array::from_fn::<f64, 3, _>(|k| (x[k] - origin[k]) / size)
        });
        let [low, high] = [f64::min, f64::max]
            .map(|f: fn(f64, f64) -> f64| [0, 1].map(|k| corners.iter().map(|x| x[k]).reduce(f).unwrap_or(0.0)));
        for i in low[0].floor() as usize..=high[0].ceil() as usize {
            for j in low[1].floor() as usize..=high[1].ceil() as usize {
                let at = [i as f64 + NUDGE[0], j as f64 + NUDGE[1]];
                // Twice the signed areas of the triangles formed by the point and each edge.
                let area = |a: usize, b: usize| {
                    let (a, b) = (corners[a], corners[b]);
                    (a[0] - at[0]) * (b[1] - at[1]) - (a[1] - at[1]) * (b[0] - at[0])
                };
                let areas = [area(1, 2), area(2, 0), area(0, 1)];
                if areas.iter().all(|area| *area > 0.0) || areas.iter().all(|area| *area < 0.0) {
                    let whole: f64 = areas.iter().sum();
                    let z = areas.iter().zip(&corners).map(|(area, corner)| area * corner[2]).sum::<f64>() / whole;
                    found[i * counts[1] + j].push(z);
                }
            }
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;
    use crate::geometry::{dot, scale};

    #[test]
    fn voxels_of_a_ball_are_those_nearer_than_its_radius() {
        let mut ball = icosphere(5);
        ball.vertices.iter_mut().for_each(|x| *x = scale(*x, 6.2));
        let found = Voxels::of(&ball, 0.5);
        for ((i, j, k), inside) in found.values.indexed_iter() {
            let x: Vec3 = [(i, 0), (j, 1), (k, 2)].map(|(at, axis)| found.origin[axis] + 0.5 * at as f64);
            let radius = dot(x, x).sqrt();
            // Points between the mesh's triangles and the true sphere may be either inside or outside the mesh.
            assert!((6.18..6.21).contains(&radius) || (*inside == 1) == (radius < 6.2), "{radius}");
        }
    }

    #[test]
    fn a_box_away_from_the_origin_has_its_voxels() {
        let mut body = icosphere(0);
        // A box with two triangles per side, made from its eight corners.
        body.vertices = (0..8)
            .map(|corner| [0, 1, 2].map(|k| [10.5, -7.5, 3.5][k] + [4.0, 5.0, 6.0][k] * f64::from(corner >> k & 1)))
            .collect();
        body.faces = vec![
            [0, 2, 1],
            [1, 2, 3],
            [4, 5, 6],
            [5, 7, 6],
            [0, 1, 4],
            [1, 5, 4],
            [2, 6, 3],
            [3, 6, 7],
            [0, 4, 2],
            [2, 4, 6],
            [1, 3, 5],
            [3, 7, 5],
        ];
        let found = Voxels::of(&body, 1.0);
        let inside: Vec<Vec3> = found
            .values
            .indexed_iter()
            .filter(|(_, inside)| **inside == 1)
            .map(|((i, j, k), _)| [(i, 0), (j, 1), (k, 2)].map(|(at, axis)| found.origin[axis] + at as f64))
            .collect();
        assert_eq!(inside.len(), 4 * 5 * 6);
        assert_eq!((inside[0], inside[119]), ([11.0, -7.0, 4.0], [14.0, -3.0, 9.0]));
    }
}
