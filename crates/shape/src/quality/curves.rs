//! Computes compactness, generalisation and specificity from coordinates that preserve the distances between members.
//!
//! In a draw of the bootstrap, a member may occur in several rows. If the member is excluded, all its rows are
//! excluded.

use ndarray::{Array2, ArrayView1, Axis};
use rayon::prelude::*;
use spharm_linalg::{MatRef, ThinSvd};
use spharm_monitor::Monitor;

use crate::ShapeError;
use crate::pca::quality::normal;

/// Maximum number of members that are excluded one at a time. In a larger group, only every `n / 200`th member is
/// excluded.
pub(super) const LEFT_OUT: usize = 200;
/// Modes are ignored if their standard deviation is at most this fraction of the first mode's. Such modes are rounding
/// errors, without a meaningful direction.
const NEGLIGIBLE: f64 = 1e-10;

/// Compactness, generalisation and specificity of the first k modes, for k = 1 to m.
pub(super) struct Curves {
    pub(super) compactness: Vec<f64>,
    pub(super) generalisation: Vec<f64>,
    pub(super) specificity: Vec<f64>,
}

/// Principal components of a set of rows.
pub(super) struct Model {
    /// Coordinates (rows, modes) of the members' rows along the modes.
    pub(super) scores: Array2<f64>,
    /// Variances along the modes, in decreasing order.
    pub(super) variances: Vec<f64>,
    /// For each row, the index of the member to which it belongs.
    pub(super) rows: Vec<usize>,
    /// Weights (modes, rows): each mode is a weighted sum of the members' rows, with the weights in the mode's row of
    /// this matrix.
    pub(super) loadings: Array2<f64>,
}

impl Model {
    /// Computes the modes of some members, given by their indices `rows`. `scores` (n, d) has the coordinates of all
    /// members.
    pub(super) fn of(scores: &Array2<f64>, rows: &[usize]) -> Result<Self, ShapeError> {
        let own = scores.select(Axis(0), rows);
        let mean = own.mean_axis(Axis(0)).ok_or(ShapeError::TooFewMembers { found: rows.len(), least: 3 })?;
        let (u, singular) = decompose(&(&own - &mean))?;
        let least = NEGLIGIBLE * singular.first().copied().unwrap_or(0.0);
        let count = singular.len();
        let scores = Array2::from_shape_fn((rows.len(), count), |(i, k)| u[[i, k]] * singular[k]);
        let loadings =
            Array2::from_shape_fn(
                (count, rows.len()),
                |(k, i)| {
                    if singular[k] > least { u[[i, k]] / singular[k] } else { 0.0 }
                },
            );
        let variances = singular.iter().map(|s| s * s / (rows.len() - 1) as f64).collect();
        Ok(Self { scores, variances, rows: rows.to_vec(), loadings })
    }

    pub(super) fn total(&self) -> f64 {
        self.variances.iter().sum()
    }

    /// For each k from 1 to `most`, returns the fraction of the total variance that lies along the first k modes; 1 if
    /// the group has no variance.
    pub(super) fn compactness(&self, most: usize) -> Vec<f64> {
        let total = self.total();
        let mut sum = 0.0;
        let shares = (0..most).map(|k| {
            sum += self.variances.get(k).copied().unwrap_or(0.0);
            if total > 0.0 { (sum / total).min(1.0) } else { 1.0 }
        });
        shares.collect()
    }
}

/// Returns the left singular vectors (rows, modes) and the singular values of a matrix of centred rows, which has at
/// most rows - 1 modes.
fn decompose(centred: &Array2<f64>) -> Result<(Array2<f64>, Vec<f64>), ShapeError> {
    let (rows, columns) = centred.dim();
    let standard = centred.as_standard_layout();
    let slice = standard.as_slice().ok_or(ShapeError::NoDecomposition)?;
    let found =
        ThinSvd::new(MatRef::from_row_major_slice(slice, rows, columns)).map_err(|_| ShapeError::NoDecomposition)?;
    let count = (rows - 1).min(columns);
    let (u, mut singular) = (found.u(), found.singular());
    singular.truncate(count);
    Ok((Array2::from_shape_fn((rows, count), |(i, k)| u[(i, k)]), singular))
}

/// An excluded member, compared with the modes of the other members.
pub(super) struct Left {
    /// For k = 1 to m, the distance of the member from the nearest shape that the first k modes of the other members
    /// can form. If the other members have fewer than k modes, all of their modes are used.
    pub(super) distances: Vec<f64>,
    /// Index of the excluded member.
    pub(super) member: usize,
    /// For each k from 1 to m, a factor for each row of the model. The sum of the rows multiplied by these factors is
    /// the shape in the span of the first k modes that is nearest to the excluded member.
    pub(super) factors: Vec<Vec<f64>>,
}

/// Returns the members to exclude one at a time, at most `most`.
pub(super) fn left_out(members: usize, most: usize) -> impl Iterator<Item = usize> {
    (0..members).step_by(members.div_ceil(most).max(1))
}

/// Excludes members one at a time, and compares each excluded member with the modes of the other members.
pub(super) fn leave_out(
    model: &Model,
    most: usize,
    members: usize,
    monitor: &dyn Monitor,
) -> Result<Vec<Left>, ShapeError> {
    let mut distinct = model.rows.clone();
    distinct.sort_unstable();
    distinct.dedup();
    let chosen: Vec<usize> = left_out(distinct.len(), members).map(|index| distinct[index]).collect();
    let one = |member: usize| {
        monitor.check()?;
        let left = leave_one(model, member, most)?;
        monitor.step(1);
        Ok(left)
    };
    chosen.into_par_iter().map(one).collect()
}

fn leave_one(model: &Model, member: usize, most: usize) -> Result<Left, ShapeError> {
    let others: Vec<usize> = (0..model.rows.len()).filter(|&row| model.rows[row] != member).collect();
    let own = model.rows.iter().position(|&row| row == member).ok_or(ShapeError::NoDecomposition)?;
    let there = model.scores.select(Axis(0), &others);
    let mean = there.mean_axis(Axis(0)).ok_or(ShapeError::NoDecomposition)?;
    let centred = &there - &mean;
    let (u, singular) =
        if others.len() > 1 { decompose(&centred)? } else { (Array2::zeros((others.len(), 0)), vec![]) };
    let rest = &model.scores.row(own) - &mean;
    let least = NEGLIGIBLE * singular.first().copied().unwrap_or(0.0);
    let mut square: f64 = rest.iter().map(|value| value * value).sum();
    // C is `centred`, with left singular vectors u_k and singular values s_k. Mode k is `u_k^T C / s_k`, so the
    // coordinate of the remainder r (`rest`) along mode k is `u_k . (C r) / s_k`.
    let products: Vec<f64> =
        centred.rows().into_iter().map(|row| row.iter().zip(&rest).map(|(a, b)| a * b).sum()).collect();
    let mut factors = vec![0.0; model.rows.len()];
    others.iter().for_each(|&row| factors[row] = 1.0 / others.len() as f64);
    let (mut distances, mut all) = (Vec::with_capacity(most), Vec::with_capacity(most));
    for k in 0..most {
        if k < singular.len() && singular[k] > least {
            let along: f64 = u.column(k).iter().zip(&products).map(|(u, value)| u * value).sum::<f64>() / singular[k];
            square -= along * along;
            others.iter().enumerate().for_each(|(i, &row)| factors[row] += along * u[[i, k]] / singular[k]);
        }
        distances.push(square.max(0.0).sqrt());
        all.push(factors.clone());
    }
    Ok(Left { distances, member, factors: all })
}

/// A random shape and the members nearest to it.
pub(super) struct Near {
    /// For k = 1 to m, the distance of the shape from the nearest member, with the shape truncated to the first k
    /// modes.
    pub(super) distances: Vec<f64>,
    /// Coordinates of the shape along all modes.
    pub(super) along: Vec<f64>,
    /// For k = 1 to m, the two members nearest to the shape truncated to the first k modes, the nearest first. Members
    /// are given as row indices of the model's scores.
    pub(super) rows: Vec<[usize; 2]>,
}

/// Generates random shapes from a seed and finds the members nearest to them.
pub(super) fn nearest(model: &Model, most: usize, samples: usize, seed: u64) -> Vec<Near> {
    let m = most.min(model.variances.len());
    let tail = |row: ArrayView1<'_, f64>, k: usize| row.iter().skip(k + 1).map(|s| s * s).sum::<f64>();
    let tails = Array2::from_shape_fn((model.rows.len(), m), |(i, k)| tail(model.scores.row(i), k));
    (0..samples)
        .into_par_iter()
        .map(|sample| {
            let deviations = normal(seed, sample as u64, m);
            let along: Vec<f64> = deviations.iter().zip(&model.variances).map(|(z, v)| z * v.sqrt()).collect();
            let mut least = vec![[(f64::INFINITY, 0); 2]; m];
            for (row, (scores, tails)) in model.scores.rows().into_iter().zip(tails.rows()).enumerate() {
                let mut square = 0.0;
                for k in 0..m {
                    square += (along[k] - scores[k]).powi(2);
                    let found = (square + tails[k], row);
                    if found.0 < least[k][0].0 {
                        least[k] = [found, least[k][0]];
                    } else if found.0 < least[k][1].0 {
                        least[k][1] = found;
                    }
                }
            }
            // If k exceeds the number of modes, the values for all modes are used.
            let filled = |k: usize| least[k.min(m.saturating_sub(1))];
            let distances = (0..most).map(|k| filled(k)[0].0.sqrt()).collect();
            Near { distances, along, rows: (0..most).map(|k| filled(k).map(|(_, row)| row)).collect() }
        })
        .collect()
}

/// Returns the elementwise mean of `rows`, each of which has `most` numbers.
pub(super) fn mean_of<'a>(rows: impl Iterator<Item = &'a [f64]>, most: usize) -> Vec<f64> {
    let (mut sum, mut count) = (vec![0.0; most], 0_usize);
    for row in rows {
        sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        count += 1;
    }
    sum.into_iter().map(|sum| sum / count.max(1) as f64).collect()
}
