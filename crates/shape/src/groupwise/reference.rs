//! Compares a new member with a finished group, which is described by its mean, modes, and the residual variance delta.
//!
//! The member's values x have the Mahalanobis distance
//!
//! ```text
//! M = sum_k <x - m, e_k>^2 / (lambda_k + delta) + (|x - m|^2 - sum_k <x - m, e_k>^2) / delta
//! ```
//!
//! from the group's mean m, where e_k are the modes of the N members, and lambda_k are the variances along these modes.
//! In the inner products, a direction is weighted by its fraction of a member's area, averaged over the members (M.
//! Tipping and C. Bishop, "Probabilistic principal component analysis", J. R. Stat. Soc. B 61, 1999). The member's cost
//! is `log(1 + M / N)`. This is the member's contribution to the description length `log det(G + delta 1)` of the
//! group, if nothing else changes. The member's points therefore move as if the member were refined together with the
//! group, but the group is unchanged.
//!
//! Cost of a comparison: 4 flops per mode, channel and direction. Memory: one value per mode, channel and direction.

use ndarray::{Array2, Axis};
use rayon::prelude::*;
use spharm_linalg::{Mat, SymmetricEigen};

use super::objective::Objective;
use crate::error::ShapeError;
use crate::product::product;

/// Modes are treated as part of the residual term if their variance is below this fraction of delta, the constant that
/// the objective adds to every variance.
const LEAST: f64 = 0.02;
/// Maximum number of modes. If a group has more modes, the modes with the largest variances are kept.
const MODES: usize = 64;

/// Description of a finished group, truncated to the degree of one stage.
pub(super) struct Reference {
    /// Mean of the group, m (n C).
    mean: Vec<f64>,
    /// Weights of the directions, w (n).
    weights: Vec<f64>,
    /// Modes e_k (modes, n C), with n directions and C channels, orthonormal in the inner product with the directions'
    /// weights w.
    modes: Array2<f64>,
    /// For each mode k, the factor `1 / delta - 1 / (lambda_k + delta)` of its squared score, which is subtracted from
    /// `|x - m|^2 / delta` to give M (see the [module](self)).
    gains: Vec<f64>,
    delta: f64,
    members: f64,
}

impl Reference {
    /// Computes the reference from the values (N, n C) of all members. Delta is the fraction `share` of the variance.
    pub(super) fn new(values: Array2<f64>, objective: &Objective<'_>, share: f64) -> Result<Self, ShapeError> {
        let covariance = objective.covariance(values)?;
        let (members, delta) = (covariance.gram.nrows(), covariance.delta(share));
        let gram = Mat::from_fn(members, members, |i, j| covariance.gram[[i, j]]);
        let found = SymmetricEigen::new(gram.as_ref()).map_err(|_| ShapeError::NoDecomposition)?;
        let (variances, vectors) = (found.values(), found.vectors());
        let enough = |k: &usize| variances[*k] > LEAST * delta && variances[*k] > 0.0;
        // The variances are in ascending order, so the last modes are kept.
        let kept: Vec<usize> = (0..members).rev().filter(enough).take(MODES).collect();
        // The modes are e_k = sum_i u_ik y_i / sqrt(N lambda_k).
        let shares = Array2::from_shape_fn((kept.len(), members), |(row, i)| {
            vectors[(i, kept[row])] / (members as f64 * variances[kept[row]]).sqrt()
        });
        let modes = product(shares.view(), covariance.centred.view());
        let gains = kept.iter().map(|k| 1.0 / delta - 1.0 / (variances[*k] + delta)).collect();
        let (mean, weights) = (covariance.mean, covariance.weights);
        Ok(Self { mean, weights, modes, gains, delta, members: members as f64 })
    }

    /// Returns the cost of a member's values (n C), the derivatives (n C) of the cost with respect to the values, and
    /// the variance of the values about the mean.
    pub(super) fn cost(&self, values: &[f64]) -> (f64, Vec<f64>, f64) {
        let channels = self.mean.len() / self.weights.len();
        let off: Vec<f64> = values.iter().zip(&self.mean).map(|(x, m)| x - m).collect();
        let weighted = |row: &[f64]| -> Vec<f64> {
            let rows = row.chunks_exact(channels).zip(&self.weights);
            rows.flat_map(|(row, w)| row.iter().map(move |x| w * x)).collect()
        };
        let pulled = weighted(&off);
        let inner = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let variance = inner(&off, &pulled);
        let mut distance = variance / self.delta;
        let mut slope: Vec<f64> = off.iter().map(|x| x / self.delta).collect();
        let scores: Vec<f64> = self
            .modes
            .axis_iter(Axis(0))
            .into_par_iter()
            .map(|mode| inner(mode.as_slice().unwrap_or_default(), &pulled))
            .collect();
        for ((mode, score), gain) in self.modes.rows().into_iter().zip(scores).zip(&self.gains) {
            distance -= gain * score * score;
            slope.iter_mut().zip(mode).for_each(|(slope, e)| *slope -= gain * score * e);
        }
        let share = distance / self.members;
        let factor = 2.0 / (self.members * (1.0 + share));
        let slope = weighted(&slope).into_iter().map(|slope| factor * slope).collect();
        (share.ln_1p(), slope, variance)
    }
}
