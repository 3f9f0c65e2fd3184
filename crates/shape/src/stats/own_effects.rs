//! Tests whether an effect within blocks differs between blocks, for example, whether the rate of growth differs
//! between children.
//!
//! Relabellings within blocks assume that the effect is equal in all blocks. Otherwise, differences between the blocks'
//! effects add to the estimate's variance, but not to the variance of the relabelled estimates. The model is compared
//! with a model in which each block has its own mean and its own effect. The comparison uses a single F statistic for
//! all values together. The degrees of freedom of F are multiplied by the effective number of independent values, `(tr
//! G)^2 / tr G^2`, where `G = E E^T` for the residuals E (S. Greenhouse and S. Geisser, "On methods in the analysis of
//! profile data", Psychometrika 24 (1959)). Because G is an (n, n) matrix, this number can't exceed n minus the rank of
//! the model. For rough maps it is therefore only a lower bound of the number of independent values.

use ndarray::{Array2, ArrayView2, Axis, concatenate, s};

use super::blocks::Blocks;
use super::design::{Design, orthonormalise};
use super::distributions::p_of_f;
use super::linear::floors;
use super::projection::{Projection, without};
use crate::product::{COLUMNS, product};

/// Each column of the effect, over the rows of the design, is a unit vector. A block's part of such a vector is treated
/// as a rounding error if its norm is at most this value.
const SMALLEST: f64 = 1e-6;

/// The comparison is skipped if there are more rows than this, because G, a square matrix with as many rows, would take
/// more than 32 MB.
const MOST_ROWS: usize = 2000;

/// Returns F and its p value for the hypothesis that the effect is equal in all blocks. Returns `None` if the effect
/// doesn't vary within blocks, if the blocks have too few rows (for example two rows each), or if there are more than
/// [`MOST_ROWS`] rows.
pub(crate) fn differ(
    values: ArrayView2<'_, f64>,
    design: &Design,
    model: &Projection,
    blocks: &Blocks,
) -> Option<[f64; 2]> {
    let (n, count) = (values.nrows(), blocks.count());
    if n > MOST_ROWS {
        return None;
    }
    let means = Array2::from_shape_fn((n, count), |(i, block)| f64::from(blocks.of()[i] == block));
    let sizes = means.sum_axis(Axis(0));
    let mut own: Vec<Vec<f64>> = Vec::new();
    for effect in model.effect.columns() {
        for (member, size) in means.columns().into_iter().zip(&sizes) {
            let mean = effect.iter().zip(member).map(|(value, member)| value * member).sum::<f64>() / size;
            let part: Vec<f64> = effect.iter().zip(member).map(|(value, member)| (value - mean) * member).collect();
            if part.iter().map(|value| value * value).sum::<f64>().sqrt() > SMALLEST {
                own.push(part);
            }
        }
    }
    // If the effect has one column, the columns of `own` are orthogonal to each other and to the blocks' means. The
    // rank of these columns together is therefore known before the decomposition: `count + own.len()`.
    if own.is_empty() || model.effect.ncols() == 1 && count + own.len() >= n {
        return None;
    }
    let (common, _) = orthonormalise(concatenate![Axis(1), design.matrix(), means].view());
    let own = Array2::from_shape_fn((n, own.len()), |(i, k)| own[k][i]);
    let (all, _) = orthonormalise(concatenate![Axis(1), common, own].view());
    let (between, within) = (all.ncols() - common.ncols(), n - all.ncols());
    if between == 0 || within == 0 {
        return None;
    }
    let mut gram = Array2::<f64>::zeros((n, n));
    let mut floor = 0.0;
    for part in values.axis_chunks_iter(Axis(1), COLUMNS) {
        let errors = without(common.view(), part.to_owned());
        gram += &product(errors.view(), errors.t());
        floor += floors(part).into_iter().sum::<f64>();
    }
    let own = all.slice(s![.., common.ncols()..]);
    let explained = (&product(gram.view(), own) * &own).sum();
    let total: f64 = gram.diag().sum();
    if total <= floor {
        return None;
    }
    let independent = (total * total / gram.iter().map(|value| value * value).sum::<f64>()).max(1.0);
    let (between, within) = (between as f64, within as f64);
    let f = explained / between / ((total - explained).max(0.0) / within);
    Some([f, p_of_f(f, independent * between, independent * within)])
}
