//! Fills holes in a mesh with surfaces of least bending, like those that close the cuts through handles.

use std::collections::{HashMap, HashSet};

use spharm_monitor::{Interrupted, Monitor};
use spharm_surface::Mesh;
use spharm_surface::geometry::{unit, vertex_normals};
use spharm_surface::nearest::TriangleTree;
use spharm_surface::repair::{MeshRepair, rims, turn_closed_outward};

use super::filling::Rim;
use super::strip::triangulated;
use crate::geometry::{Vec3, area};

/// Largest number of edges of a hole that [`fill_holes`] fills. The filling of a hole with this number of edges has
/// 22,500 vertices.
pub const LARGEST_HOLE: usize = 500;

/// A hole is filled by the triangulation of its rim if the area of the smooth filling exceeds this multiple of the
/// triangulation's area. A dome over a round hole has at most twice the hole's area. The smooth filling of a slit can
/// be much larger, because it folds over the surface next to the slit or bridges the slit's bends.
const LARGEST_DOME: f64 = 3.0;

/// Fills the holes of at most [`LARGEST_HOLE`] edges that a repair has left in a mesh. If the mesh is then closed and
/// wound inwards, its triangles are reversed. The changes are added to `found`, the repair's report. Returns the
/// [`rims`] of the larger holes, which stay open. The triangles around each vertex of the mesh must form a single fan.
///
/// # Errors
///
/// [`Interrupted`].
///
/// # Panics
///
/// When a triangle's index is out of range.
pub fn fill_holes(
    mesh: &mut Mesh,
    found: &mut MeshRepair,
    monitor: &dyn Monitor,
) -> Result<Vec<Vec<u32>>, Interrupted> {
    let (rims, open): (Vec<_>, Vec<_>) = rims(&mesh.faces).into_iter().partition(|rim| rim.len() <= LARGEST_HOLE);
    if rims.is_empty() {
        return Ok(open);
    }
    let normals = vertex_normals(&mesh.vertices, &mesh.faces);
    let surface = TriangleTree::new(mesh);
    for rim in rims {
        let places: Vec<Vec3> = rim.iter().map(|&v| mesh.vertices[v as usize]).collect();
        let normals: Vec<Vec3> = rim.iter().map(|&v| unit(normals[v as usize])).collect();
        let both = Rim { right: &rim, left: &[], places: &places, normals: &normals, surface: &surface };
        let mut filling = both.fill(mesh.vertices.len() as u32, monitor)?;
        if let Some(strip) = strip(&rim, &places, &mesh.faces) {
            let of_strip: f64 = strip.iter().map(|face| area(face.map(|v| mesh.vertices[v as usize]))).sum();
            if filling.area > LARGEST_DOME * of_strip {
                (filling.vertices, filling.faces) = (Vec::new(), strip);
            }
        }
        found.holes += 1;
        found.filled += filling.faces.len();
        mesh.vertices.extend(filling.vertices);
        mesh.faces.extend(filling.faces);
    }
    turn_closed_outward(mesh, found);
    found.measure(mesh);
    Ok(open)
}

/// Triangulates a rim without new vertices; if the hole is a slit, the triangles form a strip. Existing edges of the
/// mesh aren't used as interior edges, since more than two triangles would meet there. Returns `None` if no such
/// triangulation exists.
fn strip(rim: &[u32], places: &[Vec3], faces: &[[u32; 3]]) -> Option<Vec<[u32; 3]>> {
    let number: HashMap<u32, usize> = rim.iter().zip(0..).map(|(&v, i)| (v, i)).collect();
    let on_rim = |v: u32| number.get(&v).copied();
    let edges = faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let edges = edges.filter_map(|[a, b]| Some((on_rim(a)?, on_rim(b)?)));
    let taken: HashSet<(usize, usize)> = edges.map(|(i, j)| (i.min(j), i.max(j))).collect();
    let triangles = triangulated(places, |i, j| taken.contains(&(i, j)))?;
    Some(triangles.into_iter().map(|triangle| triangle.map(|i| rim[i])).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;
    use spharm_surface::repair::repair;
    use spharm_surface::topology::Topology;

    /// If a cap is removed from a ball, the surface that fills the hole continues the ball, so this surface is much
    /// nearer to the ball than a flat lid would be.
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

    /// A smooth filling of a slit would fold over the surface next to the slit, or bridge the slit's bend. A slit is
    /// therefore filled by a strip, which has the slit's area. One slit of this test is straight, across a face of a
    /// cube; the other slit follows half of a ball's equator.
    #[test]
    fn slits_are_filled_by_strips() {
        let ball = icosphere(5);
        let mut cube = ball.clone();
        for v in &mut cube.vertices {
            let most = v.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
            *v = v.map(|x| x / most);
        }
        for (closed, end) in [(&cube, 0.9), (&ball, 0.99)] {
            let (mut faces, mut vertices) = (closed.faces.clone(), closed.vertices.clone());
            let count = vertices.len() as u32;
            vertices.extend(closed.vertices.iter().map(|[x, y, z]| [*x, *y, z - 1e-3 * (1.0 - y * y)]));
            let low = |v: u32| closed.vertices[v as usize][2] < 0.0;
            let on = |v: u32| {
                let [x, y, z] = closed.vertices[v as usize];
                z.abs() < 1e-9 && x > 0.0 && y.abs() < end
            };
            for face in &mut faces {
                if face.iter().any(|&v| low(v)) {
                    *face = face.map(|v| if on(v) { v + count } else { v });
                }
            }
            let (mut mesh, mut found) = repair(&Mesh::new(vertices, faces));
            let [rim] = &rims(&mesh.faces)[..] else { panic!("{found}") };
            assert!(rim.len() > 32, "{}", rim.len());
            let before = (mesh.vertices.len(), mesh.faces.len(), rim.len());
            fill_holes(&mut mesh, &mut found, &Silent).unwrap();
            assert!(Topology::of(&mesh).is_sphere() && found.filled_area < 3e-4, "{found}");
            assert_eq!((mesh.vertices.len(), mesh.faces.len()), (before.0, before.1 + before.2 - 2));
        }
    }
}
