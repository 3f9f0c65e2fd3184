//! Describes the directions at which the page evaluates a surface: an icosphere that the page generates itself, or
//! explicit directions and triangles.

use serde::Serialize;
use spharm_surface::Sphere;
use spharm_surface::generate::icosphere;

use crate::blocks::{Block, Blocks};

/// Maximum difference in each coordinate between a direction read from an f32 file and the same direction in f64.
const SAME_DIRECTION: f64 = 1.2e-7;
/// Number of subdivisions of the coarsest icosphere for models in a page.
const COARSEST: u32 = 4;

/// Directions and triangles, in the form in which the page's script reads them.
#[derive(Debug, Clone, Serialize)]
pub(crate) struct Grid {
    vertices: usize,
    /// Number of subdivisions of the icosphere with the same triangles, if any. The directions of this icosphere are
    /// used unless `directions` is set.
    icosphere: Option<u32>,
    directions: Option<Block>,
    faces: Option<Block>,
}

impl Grid {
    /// Returns the grid of a sphere.
    pub(crate) fn of_sphere(sphere: &Sphere, blocks: &mut Blocks) -> Self {
        let mut grid = Self::of_faces(sphere.directions.len(), &sphere.faces, blocks);
        let directions = sphere.directions.as_slice();
        let regular = grid.icosphere.is_some_and(|level| {
            let apart = |(a, b): (&[f64; 3], &[f64; 3])| (0..3).any(|i| (a[i] - b[i]).abs() > SAME_DIRECTION);
            !directions.iter().zip(&icosphere(level).vertices).any(apart)
        });
        if !regular {
            grid.directions = Some(blocks.f32(directions.as_flattened().iter().copied()));
        }
        grid
    }

    /// Returns the grid of a mesh whose positions are given separately.
    pub(crate) fn of_faces(vertices: usize, faces: &[[u32; 3]], blocks: &mut Blocks) -> Self {
        let level = (0..=9).find(|level| count(*level) == vertices && icosphere(*level).faces == faces);
        let given = level.is_none().then(|| blocks.faces(faces));
        Self { vertices, icosphere: level, directions: None, faces: given }
    }
}

fn count(level: u32) -> usize {
    10 * (1 << (2 * level)) + 2
}

/// Returns the icosphere at which models of a degree are evaluated. The icosphere has at least four vertices per
/// coefficient of a channel, unless `max_vertices` limits the number.
pub(crate) fn icosphere_for(max_degree: usize, max_vertices: usize) -> Sphere {
    Sphere::icosphere(level_for(max_degree, max_vertices))
}

/// Returns the number of vertices of the icosphere that [`icosphere_for`] returns.
pub(crate) fn vertices_for(max_degree: usize, max_vertices: usize) -> usize {
    count(level_for(max_degree, max_vertices))
}

fn level_for(max_degree: usize, max_vertices: usize) -> u32 {
    let wanted = 4 * (max_degree + 1).pow(2);
    let fine = (COARSEST..9).find(|level| count(*level) >= wanted).unwrap_or(9);
    (0..=fine).rev().find(|level| count(*level) <= max_vertices).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_surface::Mesh;

    #[test]
    fn an_icosphere_is_known_by_its_triangles_and_directions() {
        let mut blocks = Blocks::default();
        let grid = Grid::of_sphere(&Sphere::icosphere(2), &mut blocks);
        assert_eq!((grid.icosphere, grid.directions, grid.faces), (Some(2), None, None));
        // The directions are rounded as in an f32 file of a sphere of radius 100.
        let mesh = icosphere(2);
        let rounded = mesh.vertices.iter().map(|v| v.map(|x| f64::from((100.0 * x) as f32))).collect();
        let read = Sphere::from_mesh(&mesh.with_vertices(rounded)).unwrap();
        assert!(Grid::of_sphere(&read, &mut blocks).directions.is_none());
        let moved = mesh.vertices.iter().map(|v| [v[0] + 1e-3, v[1], v[2]]).collect();
        let moved = Grid::of_sphere(&Sphere::from_mesh(&mesh.with_vertices(moved)).unwrap(), &mut blocks);
        assert!(moved.icosphere == Some(2) && moved.directions.is_some());
        let mut faces = mesh.faces.clone();
        faces.swap(0, 1);
        let other = Sphere::from_mesh(&Mesh::new(mesh.vertices, faces)).unwrap();
        let other = Grid::of_sphere(&other, &mut blocks);
        assert!(other.icosphere.is_none() && other.faces.is_some() && other.directions.is_some());
    }

    #[test]
    fn icospheres_fit_the_degree_and_the_most_vertices() {
        for (degree, most, vertices) in [(15, 163_842, 2_562), (100, 163_842, 40_962), (100, 10_000, 2_562), (3, 5, 12)]
        {
            assert_eq!(icosphere_for(degree, most).directions.len(), vertices, "{degree}, {most}");
        }
    }
}
