//! Rejects a mesh if a small part of it lies so far from the rest that the voxels of the grid are too coarse for the
//! rest.

use spharm_surface::Mesh;
use spharm_surface::repair::bulk;

use super::limits::VOXELS;
use crate::error::ParametrizeError;
use crate::flaws::used_vertices;
use crate::geometry::{Vec3, add, norm, scale, sub};

/// If a wrap loses more than [`LOSS`] of a mesh, the mesh is refused unless the rest of it, without the far vertices,
/// spans at least this number of voxels along its longest side.
const LEAST: f64 = 8.0;
/// A mesh is refused if the part without the far vertices spans fewer voxels than this along its longest side. With so
/// few voxels, the wrap shows nothing of this part's shape, even if no part of the mesh is lost.
const FEWEST: f64 = 2.0;
/// If a wrap loses more than this share of a mesh, the rest of the mesh must span [`LEAST`] voxels instead of
/// [`FEWEST`]. A wrap that loses only a long thin tail stays below this limit, because the tail makes up a smaller
/// share of the mesh.
const LOSS: f64 = 0.05;

/// Checks that the rest of a mesh has enough voxels, given the share of the mesh that a wrap loses. `given` is the mesh
/// with coordinates in voxels, `surface` the same mesh with coordinates in its own unit.
///
/// The rest is the smaller of two boxes: one around the bulk of the area, the other around most vertices. Both boxes
/// are needed, because the triangles of a far vertex may have most of the area, and a far part may have many vertices.
///
/// # Errors
///
/// [`FarVertex`](ParametrizeError::FarVertex), with the vertex farthest from the rest.
pub(super) fn check_rest(given: &Mesh, surface: &Mesh, voxels: usize, loss: f64) -> Result<(), ParametrizeError> {
    let used = used_vertices(given);
    let percent = used.len() / 100;
    let (least, left_out) = if loss > LOSS { (LEAST, percent) } else { (FEWEST, percent.min(1)) };
    let by_area = bulk(&given.vertices, &given.faces);
    // The box is empty only for a mesh without area, which encloses no voxel.
    if longest(by_area) == 0.0 {
        return Ok(());
    }
    let by_vertices = inner_box(&used, left_out);
    let rest = if longest(by_vertices) < longest(by_area) { by_vertices } else { by_area };
    let middle = scale(add(rest.0, rest.1), 0.5);
    let off = |v: Vec3| norm(sub(v, middle));
    let farthest = used.iter().max_by(|a, b| off(a.1).total_cmp(&off(b.1)));
    let rest = longest(rest);
    let Some(&(vertex, _)) = farthest.filter(|_| rest < least) else { return Ok(()) };
    let enough = (LEAST * voxels as f64 / rest).ceil() as usize;
    Err(ParametrizeError::FarVertex {
        vertex,
        position: surface.vertices[vertex],
        rest,
        voxels,
        enough: Some(enough).filter(|enough| VOXELS.contains(enough)),
    })
}

fn longest((low, high): (Vec3, Vec3)) -> f64 {
    sub(high, low).into_iter().fold(0.0, f64::max)
}

/// Returns the lowest and the highest corner of the box that leaves out the `left_out` outermost vertices at each end
/// of each axis. `left_out` must be less than half of the number of vertices.
fn inner_box(used: &[(usize, Vec3)], left_out: usize) -> (Vec3, Vec3) {
    let sides = [0, 1, 2].map(|axis| {
        let mut values: Vec<f64> = used.iter().map(|(_, v)| v[axis]).collect();
        values.sort_unstable_by(f64::total_cmp);
        (values[left_out], values[values.len() - 1 - left_out])
    });
    (sides.map(|side| side.0), sides.map(|side| side.1))
}
