//! Improves a motion by iterative closest points, in both directions.
//!
//! Each point of either surface is paired with the nearest point of the other surface. Let p be the point of a pair on
//! the moving surface, x = scale Q p + t its position after the motion, and q the point of the pair on the fixed
//! surface. n is the unit normal at the nearest point that was found: either the normal at q, or the normal at p,
//! rotated by Q. A round minimises
//!
//! ```text
//! sum_pairs (n . (x - q))^2 + tangential |x - q|^2
//! ```
//!
//! over small motions by one Gauss-Newton step. The first term is the point-to-plane distance (Y. Chen and G. Medioni,
//! Image and Vision Computing 10, 1992), which lets surfaces slide freely along each other. The second term, with the
//! small weight `tangential`, is the point-to-point distance (P. Besl and N. McKay, IEEE TPAMI 14, 1992). It determines
//! motions that the planes leave undetermined, such as rotations of a ball. Pairs beyond the quantile `1 - trimmed` of
//! all distances are excluded from a round (D. Chetverikov et al., Image and Vision Computing 23, 2005).
//!
//! The distance of a pair is measured to a disk: each point represents a piece of the surface that extends along the
//! tangent plane by the point's radius. Therefore 256 points suffice to measure distances far below the points'
//! spacing.
//!
//! Cost of a round: 2 n searches in trees of n points, about 0.15 us each, and 200 flops per pair.

use super::surface::View;
use crate::geometry::{Vec3, add, cross, dot, scale, sub};
use crate::matrix3::{Matrix3, exponential, times};
use crate::similarity::Similarity;

/// Largest rotation of one step, in radians. Steps must be small, since they are computed to first order.
const LARGEST_TURN: f64 = 0.6;

/// In a step towards several surfaces, the distance, as a multiple of the pairs' median distance, at which a pair has
/// half of the full weight.
const HALF: f64 = 1.5;

/// Settings for the rounds that [`improved`] and [`step_to_all`] run.
#[derive(Clone, Copy)]
pub(super) struct Rounds {
    /// Largest number of rounds.
    pub(super) most: usize,
    /// Root mean square movement of the points at which rounds end, in the unit of the surfaces.
    pub(super) rest: f64,
    /// Relative decrease of the sum of squared distances below which rounds end.
    pub(super) gain: f64,
    /// Share of the pairs to exclude. Those with the largest distances are excluded.
    pub(super) trimmed: f64,
    /// Weight of the point-to-point term relative to the point-to-plane term.
    pub(super) tangential: f64,
    /// Whether the scale is an unknown as well.
    pub(super) scale: bool,
}

/// A point of the moving surface, after a motion, and the point of the fixed surface paired with it.
struct Pair {
    /// The point on the moving surface.
    place: Vec3,
    /// The vector from the fixed surface's point to the moving surface's point.
    off: Vec3,
    /// The unit normal at the point that was found as the nearest to the other point of the pair.
    normal: Vec3,
    /// The squared distance of the pair.
    square: f64,
}

/// Improves the motion `start` by rounds of the closest-point iteration, and returns the improved motion.
pub(super) fn improved(moving: View<'_>, fixed: View<'_>, start: Similarity, rounds: &Rounds) -> Similarity {
    let mut motion = start;
    let mut pairs = Vec::new();
    let mut last = f64::INFINITY;
    for _ in 0..rounds.most {
        gather(moving, fixed, &motion, &mut pairs);
        trim(&mut pairs, rounds.trimmed);
        let sum: f64 = pairs.iter().map(|pair| pair.square).sum();
        if sum > (1.0 - rounds.gain) * last {
            break;
        }
        last = sum;
        let Some((step, moved)) = Equations::of(&pairs, |_| 1.0).with_points(rounds.tangential).step(rounds.scale)
        else {
            break;
        };
        motion = motion.then(&step);
        if moved <= rounds.rest {
            break;
        }
    }
    motion
}

/// Returns the motion after one step towards several surfaces at once, each in the pose given by its own motion.
///
/// Pairs have Cauchy's weights `1 / (1 + d^2 / (1.5 m)^2)`, where m is the median of their distances d (P. Holland and
/// R. Welsch, "Robust regression using iteratively reweighted least-squares", Communications in Statistics 6, 1977).
/// With these weights, a bump on only some of the surfaces doesn't rotate those surfaces relative to the others.
pub(super) fn step_to_all(
    moving: View<'_>,
    fixed: &[(View<'_>, Similarity)],
    motion: &Similarity,
    rounds: &Rounds,
) -> Similarity {
    let (mut pairs, mut all) = (Vec::new(), Vec::new());
    for (view, own) in fixed {
        gather(moving, *view, &motion.then(&own.inverse()), &mut pairs);
        trim(&mut pairs, rounds.trimmed);
        all.extend(pairs.drain(..).map(|pair| Pair {
            place: own.apply(pair.place),
            off: scale(times(&own.orthogonal, pair.off), own.scale),
            normal: times(&own.orthogonal, pair.normal),
            square: own.scale * own.scale * pair.square,
        }));
    }
    let half = HALF * HALF * median_square(&all);
    let weight = |pair: &Pair| if half > 0.0 { half / (half + pair.square) } else { 1.0 };
    let equations = Equations::of(&all, weight).with_points(rounds.tangential);
    equations.step(rounds.scale).map_or(*motion, |(step, _)| motion.then(&step))
}

/// Returns the root mean square distance in both directions after a motion. The share `trimmed` of the pairs, those
/// with the largest distances, is excluded.
pub(super) fn distance(moving: View<'_>, fixed: View<'_>, motion: &Similarity, trimmed: f64) -> f64 {
    let mut pairs = Vec::new();
    gather(moving, fixed, motion, &mut pairs);
    trim(&mut pairs, trimmed);
    (pairs.iter().map(|pair| pair.square).sum::<f64>() / pairs.len().max(1) as f64).sqrt()
}

/// Pairs each point of either surface with the nearest point of the other surface.
fn gather(moving: View<'_>, fixed: View<'_>, motion: &Similarity, pairs: &mut Vec<Pair>) {
    pairs.clear();
    for p in &moving.asking.points {
        let place = motion.apply(*p);
        let found = fixed.nearest(place);
        pairs.push(pair(place, fixed.pieces.points[found], fixed.pieces.normals[found], fixed.pieces.radius));
    }
    let (back, reach) = (motion.inverse(), motion.scale * moving.pieces.radius);
    for q in &fixed.asking.points {
        let found = moving.nearest(back.apply(*q));
        let normal = times(&motion.orthogonal, moving.pieces.normals[found]);
        pairs.push(pair(motion.apply(moving.pieces.points[found]), *q, normal, reach));
    }
}

fn pair(place: Vec3, other: Vec3, normal: Vec3, radius: f64) -> Pair {
    let off = sub(place, other);
    let across = dot(off, normal);
    let along = (dot(off, off) - across * across).max(0.0).sqrt();
    let beyond = (along - radius).max(0.0);
    Pair { place, off, normal, square: across * across + beyond * beyond }
}

/// Removes the share `trimmed` of the pairs with the largest distances. The remaining pairs keep their order.
fn trim(pairs: &mut Vec<Pair>, trimmed: f64) {
    let keep = ((1.0 - trimmed) * pairs.len() as f64).ceil() as usize;
    if keep == 0 || keep >= pairs.len() {
        return;
    }
    let mut squares: Vec<f64> = pairs.iter().map(|pair| pair.square).collect();
    let (_, &mut limit, _) = squares.select_nth_unstable_by(keep - 1, f64::total_cmp);
    pairs.retain(|pair| pair.square <= limit);
}

/// Returns the median of the squared distances; 0 if there are no pairs.
fn median_square(pairs: &[Pair]) -> f64 {
    let mut squares: Vec<f64> = pairs.iter().map(|pair| pair.square).collect();
    let half = squares.len() / 2;
    if squares.is_empty() { 0.0 } else { *squares.select_nth_unstable_by(half, f64::total_cmp).1 }
}

/// Number of unknowns: a rotation vector, a translation, and the logarithm of a scale factor, all about a centre.
const UNKNOWNS: usize = 7;

/// The normal equations of a step: the point-to-plane terms, and the sums from which point-to-point terms are computed.
struct Equations {
    centre: Vec3,
    matrix: [[f64; UNKNOWNS]; UNKNOWNS],
    right: [f64; UNKNOWNS],
    /// Weighted sums over pairs of a a^T (`arms`), off (`offs`), a x off (`turns`) and a . off (`growth`), where a is
    /// the vector from the centre to the pair's point `place` and off is the pair's vector `off` (see [`Pair`]). The
    /// centre is the weighted mean of the points, so the sum of a is zero.
    arms: Matrix3,
    offs: Vec3,
    turns: Vec3,
    growth: f64,
    /// Sum of the weights of the pairs.
    total: f64,
}

impl Equations {
    /// Returns the equations for pairs with the given nonnegative weights.
    fn of(pairs: &[Pair], weight: impl Fn(&Pair) -> f64) -> Self {
        let (mut sum, mut total) = ([0.0; 3], 0.0);
        for pair in pairs {
            let weight = weight(pair);
            (sum, total) = (add(sum, scale(pair.place, weight)), total + weight);
        }
        let (matrix, right) = Default::default();
        let (arms, offs, turns) = Default::default();
        let centre = scale(sum, 1.0 / f64::max(total, f64::MIN_POSITIVE));
        let mut equations = Self { centre, matrix, right, arms, offs, turns, growth: 0.0, total };
        pairs.iter().for_each(|pair| equations.add(pair, weight(pair)));
        equations
    }

    /// Adds a pair. Only the lower triangles of the matrices are filled.
    fn add(&mut self, Pair { place, off, normal, .. }: &Pair, weight: f64) {
        let arm = sub(*place, self.centre);
        let turn = cross(arm, *normal);
        let row = [turn[0], turn[1], turn[2], normal[0], normal[1], normal[2], dot(*normal, arm)];
        let across = dot(*normal, *off);
        for i in 0..UNKNOWNS {
            self.right[i] -= weight * row[i] * across;
            for j in 0..=i {
                self.matrix[i][j] += weight * row[i] * row[j];
            }
        }
        let weighted_off = scale(*off, weight);
        for i in 0..3 {
            for j in 0..=i {
                self.arms[i][j] += weight * arm[i] * arm[j];
            }
        }
        (self.offs, self.turns) = (add(self.offs, weighted_off), add(self.turns, cross(arm, weighted_off)));
        self.growth += dot(arm, weighted_off);
    }

    /// Adds the point-to-point term of each pair, multiplied by a weight. This term equals the sum of three
    /// point-to-plane terms whose normals are the coordinate axes.
    fn with_points(mut self, weight: f64) -> Self {
        let square = self.spread();
        for i in 0..3 {
            for j in 0..=i {
                let unit = if i == j { square } else { 0.0 };
                self.matrix[i][j] += weight * (unit - self.arms[i][j]);
            }
            self.matrix[3 + i][3 + i] += weight * self.total;
            self.right[i] -= weight * self.turns[i];
            self.right[3 + i] -= weight * self.offs[i];
        }
        self.matrix[6][6] += weight * square;
        self.right[6] -= weight * self.growth;
        self
    }

    /// Returns the weighted sum of the points' squared distances from the centre.
    fn spread(&self) -> f64 {
        self.arms[0][0] + self.arms[1][1] + self.arms[2][2]
    }

    /// Returns the motion that minimises the sum of squares, and an upper bound on the root mean square distance by
    /// which it moves the points. Returns `None` if the motion is undetermined or not finite.
    fn step(&self, with_scale: bool) -> Option<(Similarity, f64)> {
        let unknowns = if with_scale { UNKNOWNS } else { UNKNOWNS - 1 };
        let x = solved(&self.matrix, &self.right, unknowns)?;
        let (mut turn, shift) = ([x[0], x[1], x[2]], [x[3], x[4], x[5]]);
        let angle = dot(turn, turn).sqrt();
        if angle > LARGEST_TURN {
            turn = scale(turn, LARGEST_TURN / angle);
        }
        let factor = if with_scale { x[6].clamp(-0.5, 0.5).exp() } else { 1.0 };
        let orthogonal = exponential(turn);
        let translation = sub(add(self.centre, shift), scale(times(&orthogonal, self.centre), factor));
        let reach = (self.spread() / self.total).sqrt();
        let moved = angle.min(LARGEST_TURN) * reach + dot(shift, shift).sqrt() + (factor - 1.0).abs() * reach;
        let step = Similarity { orthogonal, scale: factor, translation };
        moved.is_finite().then_some((step, moved))
    }
}

/// Solves the first `unknowns` equations by Cholesky factorisation of the lower triangle.
fn solved(matrix: &[[f64; UNKNOWNS]; UNKNOWNS], right: &[f64; UNKNOWNS], unknowns: usize) -> Option<[f64; UNKNOWNS]> {
    let mut l = *matrix;
    for j in 0..unknowns {
        let diagonal = l[j][j];
        for k in 0..j {
            for i in j..unknowns {
                l[i][j] -= l[i][k] * l[j][k];
            }
        }
        // If a pivot is below the rounding error of the numbers subtracted from it, the unknown is undetermined.
        if l[j][j].is_nan() || l[j][j] <= 1e-13 * diagonal {
            return None;
        }
        let root = l[j][j].sqrt();
        (j..unknowns).for_each(|i| l[i][j] /= root);
    }
    let mut x = *right;
    for i in 0..unknowns {
        x[i] = (x[i] - (0..i).map(|k| l[i][k] * x[k]).sum::<f64>()) / l[i][i];
    }
    for i in (0..unknowns).rev() {
        x[i] = (x[i] - (i + 1..unknowns).map(|k| l[k][i] * x[k]).sum::<f64>()) / l[i][i];
    }
    Some(x)
}
