//! Projects vertices onto a surface, and repairs triangles that the projection turns over.
//!
//! A triangle is turned over if its normal points against the normal of the subject's triangle that is nearest to its
//! centre. Vertices around such triangles are moved halfway to the mean of their neighbours and projected again,
//! several times. Triangles that are still turned over are then treated vertex by vertex: each corner is tried at
//! several positions towards its neighbours, and moved to the position with the fewest turned triangles around it. Free
//! vertices, which the subject doesn't pull, keep their positions.

use rayon::prelude::*;
use spharm_monitor::Monitor;
use spharm_surface::geometry::{Vec3, add, dot, scale};

use crate::error::RegisterError;
use crate::subject::Subject;
use crate::template::{Template, doubled_normal};

/// Number of times that vertices are moved and projected in a round.
const MOVES: usize = 12;
/// Number of rings of vertices, around turned triangles, that are moved in each round. After the last entry, the
/// sequence starts again.
const RINGS: [usize; 6] = [1, 2, 1, 3, 2, 4];
/// Maximum number of sweeps over the corners of triangles that are still turned over after the rounds.
const SWEEPS: usize = 12;
/// Positions that are tried for a corner, as fractions of the distance to each neighbour.
const TOWARDS: [f64; 3] = [0.25, 0.5, 0.9];

/// Projects the vertices onto the subject. Returns the projected vertices, and the triangles that are still turned
/// over.
///
/// # Errors
///
/// [`RegisterError::Interrupted`] if `monitor` cancels the registration.
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
            project(&mut vertices, &around, subject);
        }
    }
    let (mut left, mut vertices) = best.unwrap_or((Vec::new(), vertices));
    for sweep in 0..SWEEPS {
        monitor.check()?;
        if left.is_empty() {
            break;
        }
        one_by_one(template, &mut vertices, free, subject, &left, sweep % 3);
        left = turned_faces(template, &vertices, free, subject);
    }
    Ok((vertices, left))
}

/// Moves the corners of turned triangles, and the vertices of `rings` rings around them, one by one to positions with
/// fewer turned triangles.
fn one_by_one(
    template: &Template,
    vertices: &mut [Vec3],
    free: &[bool],
    subject: &Subject,
    turned: &[u32],
    rings: usize,
) {
    let faces = &template.mesh.faces;
    for v in around(template, turned, free, rings) {
        let near: Vec<usize> = template.plate.faces_of(v).iter().map(|face| *face as usize).collect();
        let cost = |vertices: &[Vec3]| {
            let own = near.iter().filter(|face| is_turned(faces[**face], vertices, free, subject));
            own.count()
        };
        let (mut least, mut place) = (cost(vertices), vertices[v]);
        let before = least;
        let ring = template.plate.rings.row(v);
        let middle = add(vertices[v], template.plate.to_mean(v, vertices));
        let towards = ring.iter().flat_map(|w| TOWARDS.map(|share| between(vertices[v], vertices[*w as usize], share)));
        let tried: Vec<Vec3> = std::iter::once(middle).chain(towards).collect();
        let start = vertices[v];
        for place_tried in tried {
            let Some(found) = subject.tree.nearest(place_tried) else { continue };
            vertices[v] = found.point;
            let found_cost = cost(vertices);
            if found_cost < least {
                (least, place) = (found_cost, found.point);
            }
        }
        vertices[v] = if least < before { place } else { start };
    }
}

fn between(from: Vec3, to: Vec3, share: f64) -> Vec3 {
    std::array::from_fn(|k| from[k] + share * (to[k] - from[k]))
}

/// Projects the vertices with the indices `some` onto the subject.
fn project(vertices: &mut [Vec3], some: &[usize], subject: &Subject) {
    let nearest = |v: &usize| subject.tree.nearest(vertices[*v]).map_or(vertices[*v], |found| found.point);
    let moved: Vec<Vec3> = some.par_iter().map(nearest).collect();
    some.iter().zip(moved).for_each(|(v, to)| vertices[*v] = to);
}

/// Returns whether a triangle is turned over. A triangle with a free corner isn't regarded as turned over.
fn is_turned(face: [u32; 3], vertices: &[Vec3], free: &[bool], subject: &Subject) -> bool {
    if face.iter().any(|v| free[*v as usize]) {
        return false;
    }
    let [a, b, c] = face.map(|v| vertices[v as usize]);
    let centre = std::array::from_fn(|k| (a[k] + b[k] + c[k]) / 3.0);
    let Some(found) = subject.tree.nearest(centre) else { return false };
    let theirs = doubled_normal(&subject.mesh.vertices, subject.mesh.faces[found.triangle as usize]);
    dot(doubled_normal(vertices, face), theirs) < 0.0
}

/// Returns the triangles that are turned over, except those with free corners.
fn turned_faces(template: &Template, vertices: &[Vec3], free: &[bool], subject: &Subject) -> Vec<u32> {
    let faces = &template.mesh.faces;
    let all = (0..faces.len() as u32).into_par_iter();
    all.filter(|face| is_turned(faces[*face as usize], vertices, free, subject)).collect()
}

/// Returns the vertices of the given triangles and of `rings` rings around them, in ascending order and without free
/// vertices.
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
