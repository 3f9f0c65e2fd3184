//! Computes confidence bands for the quality measures by a bootstrap over the members.
//!
//! Members are drawn with replacement, and all measures are recomputed for each draw. If a measure excludes a member,
//! all its copies in the draw are excluded as well. A draw contains only about 63 % of the distinct members. A shape's
//! nearest member in the draw is farther away than its nearest member in the group, so a draw's measures are
//! systematically larger than the group's. Bands are therefore the quantiles of the draws relative to their median,
//! centred on the group's value. This corrects the bias caused by the resampling (B. Efron and R. J. Tibshirani, An
//! Introduction to the Bootstrap (1993), chapter 10).
//!
//! In draws from large groups, only 20 members are excluded, one at a time, and modes are computed from the leading
//! `5 m + 50` coordinates, where m is the maximum number of modes.

use ndarray::{Array2, s};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use rayon::prelude::*;
use spharm_monitor::{Monitor, Silent, Stage};

use super::curves::{Curves, Model, leave_out, mean_of, nearest};
use super::params::{Curve, QualityParams};
use crate::ShapeError;

/// Maximum number of members that are excluded, one at a time, from a draw of the bootstrap.
const LEFT_OUT: usize = 20;
/// Quantiles that bound a 95 % band.
const QUANTILES: [f64; 2] = [0.025, 0.975];
/// Index of the first stream of random numbers for the bootstrap draws. The streams of random shapes have lower
/// indices.
const STREAM: u64 = 1 << 40;

const STAGE: Stage = Stage::counted("bands", "draws");

/// Returns the curves of compactness, generalisation and specificity with their bands, for members with the coordinates
/// `scores` (n, d).
pub(super) fn bands(
    scores: &Array2<f64>,
    found: &Curves,
    most: usize,
    params: &QualityParams,
    monitor: &dyn Monitor,
) -> Result<[Curve; 3], ShapeError> {
    let (n, all) = scores.dim();
    let leading = scores.slice(s![.., ..all.min(5 * most + 50)]).to_owned();
    monitor.begin(STAGE, params.bands as u64);
    let one = |index: usize| {
        monitor.check()?;
        let rows = draw(n, params.seed, index);
        let model = Model::of(&leading, &rows)?;
        let left = leave_out(&model, most, LEFT_OUT, &Silent)?;
        let near = nearest(&model, most, params.samples, params.seed);
        monitor.step(1);
        Ok([
            model.compactness(most),
            mean_of(left.iter().map(|left| left.distances.as_slice()), most),
            mean_of(near.iter().map(|near| near.distances.as_slice()), most),
        ])
    };
    let draws: Vec<[Vec<f64>; 3]> = (0..params.bands).into_par_iter().map(one).collect::<Result<_, ShapeError>>()?;
    monitor.end();
    let curve = |which: usize, values: &[f64], highest: f64| {
        let draws: Vec<&[f64]> = draws.iter().map(|draw| draw[which].as_slice()).collect();
        about(values, &draws, highest)
    };
    Ok([
        curve(0, &found.compactness, 1.0),
        curve(1, &found.generalisation, f64::INFINITY),
        curve(2, &found.specificity, f64::INFINITY),
    ])
}

/// Returns the mean of `rows` as a curve, with a band from a bootstrap over the rows. Each row belongs to one member or
/// shape, and has `most` values, one for each number of modes.
pub(super) fn of_rows(rows: &[Vec<f64>], most: usize, params: &QualityParams) -> Curve {
    let values = mean_of(rows.iter().map(Vec::as_slice), most);
    let draws: Vec<Vec<f64>> = (0..params.bands)
        .map(|index| mean_of(draw(rows.len(), params.seed, index).into_iter().map(|row| rows[row].as_slice()), most))
        .collect();
    about(&values, &draws.iter().map(Vec::as_slice).collect::<Vec<_>>(), f64::INFINITY)
}

/// Draws n members with replacement, of which at least three are different if n is 3 or more.
pub(super) fn draw(n: usize, seed: u64, index: usize) -> Vec<usize> {
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    random.set_stream(STREAM + index as u64);
    loop {
        // The range of the random numbers far exceeds n, so the remainder is uniform to within 2^-32.
        let rows: Vec<usize> = (0..n).map(|_| (random.next_u64() % n as u64) as usize).collect();
        let mut distinct = rows.clone();
        distinct.sort_unstable();
        distinct.dedup();
        if distinct.len() >= n.min(3) {
            return rows;
        }
    }
}

/// Returns the curve of `values` with a band. The band consists of quantiles of the bootstrap draws. It is shifted so
/// that the draws' median becomes `values`, and clamped to the range from 0 to `highest`.
fn about(values: &[f64], draws: &[&[f64]], highest: f64) -> Curve {
    let mut curve = Curve { values: values.to_vec(), ..Curve::default() };
    if draws.is_empty() {
        return curve;
    }
    for (k, value) in values.iter().enumerate() {
        let mut at: Vec<f64> = draws.iter().map(|draw| draw[k]).collect();
        at.sort_by(f64::total_cmp);
        let [low, high] = QUANTILES.map(|share| quantile(&at, share) - quantile(&at, 0.5));
        curve.low.push((value + low).clamp(0.0, highest));
        curve.high.push((value + high).clamp(0.0, highest));
    }
    curve
}

/// Returns a quantile of sorted values, interpolated between neighbouring values.
pub(super) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let at = share * (sorted.len() - 1) as f64;
    let (low, rest) = (at.floor() as usize, at.fract());
    let high = (low + 1).min(sorted.len() - 1);
    sorted[low] + rest * (sorted[high] - sorted[low])
}
