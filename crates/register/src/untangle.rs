//! Vertices projected onto a surface, without triangles that are turned over.
//!
//! A triangle is turned over where its normal points against that of the subject's triangle that is nearest to its centre.
//! Around such triangles vertices move halfway to the mean of their neighbours a few times, and are projected again.
//! Free vertices stay where the thin plate left them.

use rayon::prelude::*;
use spharm_monitor::Monitor;
use spharm_surface::geometry::{Vec3, add, dot, scale};

use crate::error::RegisterError;
use crate::subject::Subject;
use crate::template::{Template, doubled_normal};

/// Times that vertices move in a round.
const MOVES: usize = 5;
/// Rings around turned triangles that move, round by round.
const RINGS: [usize; 4] = [2, 1, 2, 3];

/// Returns the vertices projected onto the subject, and the triangles that are still turned over.
///
/// # Errors
///
/// [`RegisterError::Interrupted`].
pub fn untangle(
    template: &Template,
    vertices: &[Vec3],
    free: &[bool],
    subject: &Subject,
    rounds: usize,
    monitor: &dyn Monitor,
) -> Result<(Vec<Vec3>, Vec<u32>), RegisterError> {
    let all: Vec<usize> = (0..vertices.len()).filter(|v| !free[*v]).collect();
    let mut vertices = vertices.to_vec();
    project(&mut vertices, &all, subject);
    let mut best: Option<(Vec<u32>, Vec<Vec3>)> = None;
    for round in 0..=rounds {
        monitor.check()?;
        let turned = turned_faces(template, &vertices, free, subject);
        let done = turned.is_empty() || round == rounds;
        let around = around(template, &turned, free, RINGS[round % RINGS.len()]);
        if best.as_ref().is_none_or(|(least, _)| turned.len() < least.len()) {
            best = Some((turned, vertices.clone()));
        }
        if done {
            break;
        }
        for _ in 0..MOVES {
            let moves: Vec<Vec3> = around.iter().map(|v| template.plate.to_mean(*v, &vertices)).collect();
            around.iter().zip(moves).for_each(|(v, to)| vertices[*v] = add(vertices[*v], scale(to, 0.5)));
        }
        project(&mut vertices, &around, subject);
    }
    Ok(best.map_or_else(|| (vertices, Vec::new()), |(least, vertices)| (vertices, least)))
}

/// Projects some of the vertices.
fn project(vertices: &mut [Vec3], some: &[usize], subject: &Subject) {
    let nearest = |v: &usize| subject.tree.nearest(vertices[*v]).map_or(vertices[*v], |found| found.point);
    let moved: Vec<Vec3> = some.par_iter().map(nearest).collect();
    some.iter().zip(moved).for_each(|(v, to)| vertices[*v] = to);
}

/// The triangles that are turned over, but for free ones.
fn turned_faces(template: &Template, vertices: &[Vec3], free: &[bool], subject: &Subject) -> Vec<u32> {
    let turned = |face: &[u32; 3]| {
        if face.iter().any(|v| free[*v as usize]) {
            return false;
        }
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        let centre = std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0);
        let Some(found) = subject.tree.nearest(centre) else { return false };
        let theirs = doubled_normal(&subject.mesh.vertices, subject.mesh.faces[found.triangle as usize]);
        dot(doubled_normal(vertices, *face), theirs) < 0.0
    };
    let faces = &template.mesh.faces;
    let all = (0..faces.len() as u32).into_par_iter();
    all.filter(|face| turned(&faces[*face as usize])).collect()
}

/// The vertices of triangles and of so many rings around them that aren't free, in order.
fn around(template: &Template, faces: &[u32], free: &[bool], rings: usize) -> Vec<usize> {
    let mut near = vec![false; template.mesh.vertices.len()];
    let mut border: Vec<usize> =
        faces.iter().flat_map(|face| template.mesh.faces[*face as usize]).map(|v| v as usize).collect();
    border.iter().for_each(|v| near[*v] = true);
    for _ in 0..rings {
        let mut next = Vec::new();
        for v in border {
            for w in template.plate.rings.row(v).iter().map(|w| *w as usize) {
                if !near[w] {
                    near[w] = true;
                    next.push(w);
                }
            }
        }
        border = next;
    }
    (0..near.len()).filter(|v| near[*v] && !free[*v]).collect()
}
