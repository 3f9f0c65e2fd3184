//! Members brought together at places that correspond, and their mean.

use spharm_surface::geometry::{Vec3, add, cross, dot, scale, sub};
use spharm_surface::kabsch::kabsch;
use spharm_surface::matrix3::{Matrix3, times};
use spharm_surface::{Mesh, Similarity};

/// Rounds of Procrustes analysis; each brings members nearer to the mean by a factor of ten or so.
const ROUNDS: usize = 5;

/// Moves members, (n) places each, rigidly together, by least squares weighted by area; J. Gower, "Generalized Procrustes
/// analysis", Psychometrika 40 (1975). Returns the motion of each, and their mean. The mean keeps the pose that it had.
pub(super) fn together(members: &mut [Vec<Vec3>], faces: &[[u32; 3]], masked: &[bool]) -> (Vec<Similarity>, Vec<Vec3>) {
    let mut motions = vec![Similarity::default(); members.len()];
    let weights = weights(members, faces, masked);
    let first = mean(members);
    for _ in 0..ROUNDS {
        let middle = mean(members);
        for (member, motion) in members.iter_mut().zip(&mut motions) {
            let step = rigid(member, &middle, &weights);
            member.iter_mut().for_each(|place| *place = step.apply(*place));
            *motion = motion.then(&step);
        }
    }
    let back = rigid(&mean(members), &first, &weights);
    for (member, motion) in members.iter_mut().zip(&mut motions) {
        member.iter_mut().for_each(|place| *place = back.apply(*place));
        *motion = motion.then(&back);
    }
    (motions, mean(members))
}

/// The rigid motion that brings places nearest to others.
pub(super) fn rigid(from: &[Vec3], to: &[Vec3], weights: &[f64]) -> Similarity {
    let (a, b) = (centre(from, weights), centre(to, weights));
    let mut matrix = Matrix3::default();
    for ((p, q), weight) in from.iter().zip(to).zip(weights) {
        let (p, q) = (sub(*p, a), sub(*q, b));
        (0..3).for_each(|i| (0..3).for_each(|j| matrix[i][j] += weight * q[i] * p[j]));
    }
    let orthogonal = kabsch(&matrix, false);
    Similarity { orthogonal, scale: 1.0, translation: sub(b, times(&orthogonal, a)) }
}

fn centre(places: &[Vec3], weights: &[f64]) -> Vec3 {
    places.iter().zip(weights).fold([0.0; 3], |sum, (place, weight)| add(sum, scale(*place, *weight)))
}

/// The mean of the members at each place.
pub(super) fn mean(members: &[Vec<Vec3>]) -> Vec<Vec3> {
    let share = 1.0 / members.len() as f64;
    let at = |v: usize| members.iter().fold([0.0; 3], |sum, member| add(sum, scale(member[v], share)));
    (0..members.first().map_or(0, Vec::len)).map(at).collect()
}

/// The share of each place in the area, the mean over the members, of sum 1; 0 where masked.
pub(super) fn weights(members: &[Vec<Vec3>], faces: &[[u32; 3]], masked: &[bool]) -> Vec<f64> {
    let mut weights = vec![0.0; masked.len()];
    for member in members {
        for face in faces {
            let [a, b, c] = face.map(|v| member[v as usize]);
            let normal = cross(sub(b, a), sub(c, a));
            let area = dot(normal, normal).sqrt();
            face.iter().for_each(|v| weights[*v as usize] += area);
        }
    }
    weights.iter_mut().zip(masked).filter(|(_, masked)| **masked).for_each(|(weight, _)| *weight = 0.0);
    let total: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= total);
    weights
}

/// The root mean square distance of members from their mean, over the area.
pub(super) fn spread(members: &[Vec<Vec3>], mean: &[Vec3], weights: &[f64]) -> f64 {
    let square = |member: &Vec<Vec3>| {
        let terms = member.iter().zip(mean).zip(weights).map(|((place, mean), weight)| {
            let off = sub(*place, *mean);
            weight * dot(off, off)
        });
        terms.sum::<f64>()
    };
    (members.iter().map(square).sum::<f64>() / members.len().max(1) as f64).sqrt()
}

/// A mesh of places over the triangles of a sphere.
pub(super) fn mesh_of(places: Vec<Vec3>, faces: &[[u32; 3]]) -> Mesh {
    Mesh::new(places, faces.to_vec())
}
