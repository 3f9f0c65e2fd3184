//! Fills holes of a mesh by surfaces that bend least, as cuts are filled.

use spharm_monitor::{Interrupted, Monitor};
use spharm_surface::Mesh;
use spharm_surface::geometry::{unit, vertex_normals};
use spharm_surface::nearest::TriangleTree;
use spharm_surface::repair::{MeshRepair, rims};

use super::filling::Rim;
use crate::geometry::Vec3;

/// Largest number of edges of a hole that is filled. Its filling has 22,500 vertices.
pub const LARGEST_HOLE: usize = 500;

/// Fills the holes that a repair has left, up to [`LARGEST_HOLE`] edges, and counts them in its report. Each vertex of
/// the mesh must have one fan of triangles.
///
/// # Errors
///
/// [`Interrupted`].
///
/// # Panics
///
/// When a triangle's index is out of range.
pub fn fill_holes(mesh: &mut Mesh, found: &mut MeshRepair, monitor: &dyn Monitor) -> Result<(), Interrupted> {
    let rims = rims(&mesh.faces).into_iter().filter(|rim| rim.len() <= LARGEST_HOLE).collect::<Vec<_>>();
    if rims.is_empty() {
        return Ok(());
    }
    let normals = vertex_normals(&mesh.vertices, &mesh.faces);
    let surface = TriangleTree::new(mesh);
    for rim in rims {
        let places: Vec<Vec3> = rim.iter().map(|&v| mesh.vertices[v as usize]).collect();
        let normals: Vec<Vec3> = rim.iter().map(|&v| unit(normals[v as usize])).collect();
        let rim = Rim { right: &rim, left: &[], places: &places, normals: &normals, surface: &surface };
        let filling = rim.fill(mesh.vertices.len() as u32, monitor)?;
        found.holes += 1;
        found.filled += filling.faces.len();
        mesh.vertices.extend(filling.vertices);
        mesh.faces.extend(filling.faces);
    }
    found.measure(mesh);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;
    use spharm_surface::repair::repair;
    use spharm_surface::topology::Topology;

    /// The filling of a ball without a cap continues the ball: much nearer to it than a flat lid.
    #[test]
    fn a_cap_of_a_ball_is_filled_round() {
        let mut open = icosphere(4);
        let high = |face: &[u32; 3]| face.iter().all(|&v| open.vertices[v as usize][2] > 0.7);
        let faces: Vec<[u32; 3]> = open.faces.iter().filter(|face| !high(face)).copied().collect();
        open.faces = faces;
        let (mut mesh, mut found) = repair(&open);
        assert_eq!((found.holes, rims(&mesh.faces).len()), (0, 1), "{found}");
        let before = mesh.vertices.len();
        fill_holes(&mut mesh, &mut found, &Silent).unwrap();
        assert!(Topology::of(&mesh).is_sphere(), "{found}");
        let radius = |v: &Vec3| v.iter().map(|x| x * x).sum::<f64>().sqrt();
        let off = mesh.vertices[before..].iter().map(|v| (radius(v) - 1.0).abs()).fold(0.0, f64::max);
        assert!(off < 0.02, "a flat lid is off by 0.3: {off}");
        assert!((found.filled_area - 0.14).abs() < 0.02 && found.to_string().contains("1 hole filled (1"), "{found}");
    }

    /// A smooth filling of a long straight slit would fold over the surface beside it; the flat one has its area.
    #[test]
    fn a_long_slit_is_filled_flat() {
        // A cube, cut along a straight line on one face and opened a little.
        let mut mesh = icosphere(5);
        for v in &mut mesh.vertices {
            let most = v.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            *v = v.map(|x| x / most);
        }
        let low = |v: u32| mesh.vertices[v as usize][2] < 0.0;
        let (mut faces, mut vertices) = (mesh.faces.clone(), mesh.vertices.clone());
        let count = vertices.len() as u32;
        vertices.extend(mesh.vertices.iter().map(|[x, y, z]| [*x, *y, z - 1e-3 * (1.0 - y * y)]));
        let on = |v: u32| {
            let [x, y, z] = mesh.vertices[v as usize];
            z.abs() < 1e-9 && x > 0.5 && y.abs() < 0.9
        };
        for face in &mut faces {
            if face.iter().any(|&v| low(v)) {
                *face = face.map(|v| if on(v) { v + count } else { v });
            }
        }
        (mesh.vertices, mesh.faces) = (vertices, faces);
        let (mut mesh, mut found) = repair(&mesh);
        let [rim] = &rims(&mesh.faces)[..] else { panic!("{found}") };
        assert!(rim.len() > 32, "{}", rim.len());
        fill_holes(&mut mesh, &mut found, &Silent).unwrap();
        assert!(Topology::of(&mesh).is_sphere() && found.filled_area < 2e-4, "{found}");
    }
}
