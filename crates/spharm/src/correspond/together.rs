//! Aligns members rigidly at corresponding points, and computes their mean.

use std::borrow::Cow;

use spharm_surface::geometry::{Vec3, add, cross, dot, scale, sub};
use spharm_surface::kabsch::kabsch;
use spharm_surface::matrix3::{Matrix3, times};
use spharm_surface::{Mesh, Similarity};

/// Number of rounds of Procrustes analysis; each reduces the misalignment by a factor of about ten.
const ROUNDS: usize = 5;
/// The variance that is added to each point's variance, as a multiple of the median variance. It limits the weight of
/// points that hardly vary.
const ADDED_VARIANCE: f64 = 1.0;

/// Aligns members rigidly by their n corresponding points. Each point is weighted by its area and by the inverse of
/// its variance (D. Theobald and D. Wuttke, "Empirical Bayes hierarchical models for regularizing maximum likelihood
/// estimation in the matrix Gaussian Procrustes problem", PNAS 103, 2006). Least squares weighted by area alone would
/// rotate members with a bump relative to members without it, and the members would then differ away from the bump.
/// Returns the motion of each member and the members' mean, whose pose is unchanged.
pub(super) fn together(members: &mut [Vec<Vec3>], faces: &[[u32; 3]], masked: &[bool]) -> (Vec<Similarity>, Vec<Vec3>) {
    let mut motions = vec![Similarity::default(); members.len()];
    let areas = weights(members, faces, masked);
    let first = mean(members);
    for _ in 0..ROUNDS {
        let middle = mean(members);
        step_to(&middle, members, &mut motions, &areas);
    }
    let back = rigid(&mean(members), &first, &areas);
    for (member, motion) in members.iter_mut().zip(&mut motions) {
        member.iter_mut().for_each(|place| *place = back.apply(*place));
        *motion = motion.then(&back);
    }
    (motions, mean(members))
}

/// Aligns a member rigidly with a fixed mean, with the weights of [`together`]. Returns the member's motion.
pub(super) fn to_mean(mean: &[Vec3], member: &mut Vec<Vec3>, areas: &[f64]) -> Similarity {
    let mut motion = Similarity::default();
    for _ in 0..ROUNDS {
        step_to(mean, std::slice::from_mut(member), std::slice::from_mut(&mut motion), areas);
    }
    motion
}

/// Moves each member one step towards the mean.
fn step_to(mean: &[Vec3], members: &mut [Vec<Vec3>], motions: &mut [Similarity], areas: &[f64]) {
    let weights = by_variance(members, mean, areas);
    for (member, motion) in members.iter_mut().zip(motions) {
        let step = rigid(member, mean, &weights);
        member.iter_mut().for_each(|place| *place = step.apply(*place));
        *motion = motion.then(&step);
    }
}

/// Returns a weight for each point: its area divided by the variance of the members' positions of this point about the
/// mean. The weights are normalised to sum 1.
fn by_variance(members: &[Vec<Vec3>], mean: &[Vec3], areas: &[f64]) -> Vec<f64> {
    let square = |member: &Vec<Vec3>, v: usize| {
        let off = sub(member[v], mean[v]);
        dot(off, off)
    };
    let variance = |v: usize| members.iter().map(|member| square(member, v)).sum::<f64>() / members.len() as f64;
    let variances: Vec<f64> = (0..areas.len()).map(variance).collect();
    let mut compared: Vec<f64> =
        variances.iter().zip(areas).filter(|(_, area)| **area > 0.0).map(|(v, _)| *v).collect();
    let half = compared.len() / 2;
    if compared.is_empty() {
        return areas.to_vec();
    }
    let (_, &mut median, _) = compared.select_nth_unstable_by(half, f64::total_cmp);
    let added = ADDED_VARIANCE * median;
    if added == 0.0 {
        return areas.to_vec();
    }
    let mut weights: Vec<f64> =
        areas.iter().zip(&variances).map(|(area, variance)| area / (variance + added)).collect();
    let total: f64 = weights.iter().sum();
    weights.iter_mut().for_each(|weight| *weight /= total);
    weights
}

/// Returns the rigid motion that best aligns the points `from` with the points `to`.
fn rigid(from: &[Vec3], to: &[Vec3], weights: &[f64]) -> Similarity {
    motion(from, to, Some(weights), false, false)
}

/// Returns the motion that best aligns the points `from` with the points `to`. `weights` have sum 1; `None` gives all
/// points equal weights. The motion includes a change of size if `scaled` is set, and may include a reflection if
/// `mirror` is set.
pub(super) fn motion(from: &[Vec3], to: &[Vec3], weights: Option<&[f64]>, scaled: bool, mirror: bool) -> Similarity {
    let equal = || vec![1.0 / from.len().max(1) as f64; from.len()];
    let weights = weights.map_or_else(|| Cow::Owned(equal()), Cow::Borrowed);
    let (a, b) = (centre(from, &weights), centre(to, &weights));
    let (mut matrix, mut square) = (Matrix3::default(), 0.0);
    for ((p, q), weight) in from.iter().zip(to).zip(weights.iter()) {
        let (p, q) = (sub(*p, a), sub(*q, b));
        square += weight * dot(p, p);
        (0..3).for_each(|i| (0..3).for_each(|j| matrix[i][j] += weight * q[i] * p[j]));
    }
    let orthogonal = kabsch(&matrix, mirror);
    let along: f64 = orthogonal.as_flattened().iter().zip(matrix.as_flattened()).map(|(q, m)| q * m).sum();
    let size = if scaled && square > 0.0 { along / square } else { 1.0 };
    Similarity { orthogonal, scale: size, translation: sub(b, scale(times(&orthogonal, a), size)) }
}

/// Returns the weighted mean of points. `weights` have sum 1.
pub(super) fn centre(places: &[Vec3], weights: &[f64]) -> Vec3 {
    places.iter().zip(weights).fold([0.0; 3], |sum, (place, weight)| add(sum, scale(*place, *weight)))
}

/// Returns the mean of the members at each corresponding point.
pub(super) fn mean(members: &[Vec<Vec3>]) -> Vec<Vec3> {
    let share = 1.0 / members.len() as f64;
    let at = |v: usize| members.iter().fold([0.0; 3], |sum, member| add(sum, scale(member[v], share)));
    (0..members.first().map_or(0, Vec::len)).map(at).collect()
}

/// Returns each point's share of the surface's area, averaged over the members. The shares have sum 1, and are 0 for
/// masked points.
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

/// Returns the root mean square distance of members from their mean, weighted by area.
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

/// Returns a mesh with the given points as vertices and the triangles of a sphere.
pub(super) fn mesh_of(places: Vec<Vec3>, faces: &[[u32; 3]]) -> Mesh {
    Mesh::new(places, faces.to_vec())
}

#[cfg(test)]
mod tests {
    use spharm_surface::generate::icosphere;

    use super::*;

    #[test]
    fn a_bump_that_half_of_the_members_have_turns_no_one() {
        let ball = icosphere(3);
        let masked = vec![false; ball.vertices.len()];
        let body = |height: f64| -> Vec<Vec3> {
            let place = |v: &Vec3| {
                let bump = 1.0 + height * (12.0 * (dot(*v, [0.48, 0.64, 0.6]) - 1.0)).exp();
                [12.0 * v[0], bump * 7.0 * v[1], bump * 6.0 * v[2]]
            };
            ball.vertices.iter().map(place).collect()
        };
        let mut members: Vec<_> = [0.0, 0.3, 0.0, 0.3].map(body).into();
        let (motions, mean) = together(&mut members, &ball.faces, &masked);
        // Distance between the images of the point (0, 7, 0) under two motions.
        let apart = |a: &Similarity, b: &Similarity| {
            let off = sub(a.apply([0.0, 7.0, 0.0]), b.apply([0.0, 7.0, 0.0]));
            dot(off, off).sqrt()
        };
        assert!(apart(&motions[0], &motions[1]) < 0.001, "{}", apart(&motions[0], &motions[1]));
        let least_squares = rigid(&body(0.3), &body(0.0), &weights(&members, &ball.faces, &masked));
        assert!(apart(&Similarity::default(), &least_squares) > 0.05);
        // The alignment of a single member with the mean gives the same motion as the alignment of the whole group.
        let mut one = body(0.3);
        let areas = weights(std::slice::from_ref(&mean), &ball.faces, &masked);
        let motion = to_mean(&mean, &mut one, &areas);
        assert!(apart(&motion, &motions[1]) < 0.001, "{}", apart(&motion, &motions[1]));
    }

    #[test]
    fn equal_members_stay_where_they_are() {
        let ball = icosphere(2);
        let mut members = vec![ball.vertices.clone(); 3];
        let (motions, mean) = together(&mut members, &ball.faces, &vec![false; ball.vertices.len()]);
        let far = mean.iter().zip(&ball.vertices).map(|(a, b)| dot(sub(*a, *b), sub(*a, *b))).fold(0.0, f64::max);
        assert!(far < 1e-24 && motions.iter().all(|motion| (motion.orthogonal[0][0] - 1.0).abs() < 1e-12));
    }
}
