//! Moves the vertices of a wrap onto the wrapped surface.

use rayon::prelude::*;
use spharm_surface::Mesh;
use spharm_surface::geometry::{face_normal, vertex_normals};
use spharm_surface::nearest::TriangleTree;

use crate::geometry::{Vec3, dot};

/// A vertex moves onto a triangle only if the cosine of the angle between their normals exceeds this value. A triangle
/// that faces the opposite way belongs to the far side of the body or to an inner wall.
const ALIKE: f64 = 0.2;
/// A move is rejected if it turns a triangle by an angle whose cosine is below this value.
const STEADY: f64 = 0.3;
/// A move is rejected if it reduces a triangle's area to less than this share of the area before the move.
const SMALLEST: f64 = 0.05;

/// Moves each vertex to the nearest point of the given surface, if this point is at most `reach` away and faces the
/// same way. A vertex isn't moved if one of its triangles would turn by more than about 70 degrees or shrink to less
/// than a twentieth of its area. The moves therefore cause no folds.
pub(super) fn snap(wrap: &mut Mesh, given: &Mesh, tree: &TriangleTree, reach: f64) {
    let normals = vertex_normals(&wrap.vertices, &wrap.faces);
    let corners = |mesh: &Mesh, face: &[u32; 3]| face.map(|v| mesh.vertices[v as usize]);
    let target = |(&vertex, normal): (&Vec3, &Vec3)| {
        let found = tree.nearest(vertex).filter(|found| found.distance <= reach)?;
        let facing = face_normal(corners(given, &given.faces[found.triangle as usize]));
        (dot(facing, *normal) > ALIKE * (dot(facing, facing) * dot(*normal, *normal)).sqrt()).then_some(found.point)
    };
    let mut targets: Vec<Option<Vec3>> = wrap.vertices.par_iter().zip(&normals).map(target).collect();
    let before: Vec<Vec3> = wrap.faces.iter().map(|face| face_normal(corners(wrap, face))).collect();
    let place = |targets: &[Option<Vec3>], v: u32| targets[v as usize].unwrap_or(wrap.vertices[v as usize]);
    // Each round but the last undoes at least one move, so the loop ends.
    loop {
        let turned = |(face, before): (&[u32; 3], &Vec3)| {
            let now = face_normal(face.map(|v| place(&targets, v)));
            let (old, new) = (dot(*before, *before), dot(now, now));
            new < SMALLEST * SMALLEST * old || dot(now, *before) < STEADY * (new * old).sqrt()
        };
        let moved = |face: &[u32; 3]| face.iter().any(|&v| targets[v as usize].is_some());
        let folded: Vec<usize> = (0..wrap.faces.len())
            .into_par_iter()
            .filter(|&f| moved(&wrap.faces[f]) && turned((&wrap.faces[f], &before[f])))
            .collect();
        if folded.is_empty() {
            break;
        }
        for v in folded.into_iter().flat_map(|f| wrap.faces[f]) {
            targets[v as usize] = None;
        }
    }
    for (vertex, target) in wrap.vertices.iter_mut().zip(targets) {
        *vertex = target.unwrap_or(*vertex);
    }
}

#[cfg(test)]
mod tests {
    use spharm_surface::generate::icosphere;

    use super::*;
    use crate::geometry::scale;

    #[test]
    fn vertices_move_to_the_side_that_faces_as_they_do() {
        // Two spheres form a thin shell; the inner sphere is inside out. The vertices of the wrap may move to the outer
        // sphere, but not to the inner one.
        let outer = icosphere(4);
        let mut shell = outer.clone();
        let count = shell.vertices.len() as u32;
        shell.vertices.extend(outer.vertices.iter().map(|&v| scale(v, 0.98)));
        shell.faces.extend(outer.faces.iter().map(|&[a, b, c]| [a, c, b].map(|v| v + count)));
        let mut wrap = icosphere(3);
        wrap.vertices.iter_mut().for_each(|v| *v = scale(*v, 0.985));
        let tree = TriangleTree::new(&shell);
        snap(&mut wrap, &shell, &tree, 0.1);
        let radius = |v: &Vec3| dot(*v, *v).sqrt();
        assert!(wrap.vertices.iter().all(|v| (radius(v) - 0.985).abs() < 1e-12), "the back is nearer");
        wrap.vertices.iter_mut().for_each(|v| *v = scale(*v, 0.995 / 0.985));
        snap(&mut wrap, &shell, &tree, 0.1);
        assert!(wrap.vertices.iter().all(|v| radius(v) > 0.995), "the front is nearer");
        let off: f64 = wrap.vertices.iter().map(|v| tree.nearest(*v).map_or(1.0, |found| found.distance)).sum();
        assert!(off < 1e-12, "{off}");
    }
}
