//! Computes family-wise p values: how often the largest statistic of a relabelled study reaches a vertex's own
//! statistic.
//!
//! P. H. Westfall and S. S. Young, "Resampling-Based Multiple Testing" (1993): single-step max-T. The residuals of the
//! reduced model are relabelled by permutations of subjects or sign flips ([`Resampling`]): D. Freedman and D. Lane, "A
//! nonstochastic interpretation of reported significance levels", J. Bus. Econ. Stat. 1 (1983). If there are at most
//! [`PermutationParams::exact_up_to`] relabellings, all of them are used and p values are exact. With B random
//! relabellings, of which `count` reach the statistic, p is `(count + 1) / (B + 1)`.
//!
//! # Computation
//!
//! The residuals e of the reduced model are whitened once at each vertex, so that their d components are uncorrelated
//! with sums of squares of one. For a signed permutation P let `b = (P^T Q_E)^T e`, `g = (P^T Q_Z)^T e`: the product of
//! a row of length n with (n, V d). The share of the reduced model's scatter that the effect explains, `u = b (1 - g^T
//! g)^-1 b^T`, increases with |t|, F and `T^2` (`T^2 = v u / (1 - u)`), so that only u needs to be compared; g = 0 for
//! permutations if the reduced model is a constant. `welch_flips` has the statistics of unequal variances. Cost: `2 n V
//! d (q + p - q)` flops per relabelling, `2 n V d q` if the reduced model is a constant; 10,000 relabellings of 100
//! subjects at 10,242 vertices of a scalar take 2e10. Memory: `8 n V d` bytes for the residuals, and 2 MB per thread.

use ndarray::{ArrayView2, Axis};
use rayon::prelude::*;
use spharm_monitor::{Monitor, Stage};

use super::arrangements::{Arrangements, Relabelling};
use super::explained::Explained;
use super::projection::Projection;
use super::resampling::Resampling;
use super::welch_flips::WelchFlips;
use crate::ShapeError;

/// Maximum number of relabellings of a test; this many random relabellings take 2.4 GB.
pub const MAX_RELABELLINGS: usize = 100_000_000;

/// Settings of the relabellings of a study.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PermutationParams {
    /// Number of random relabellings, 1 to [`MAX_RELABELLINGS`]. Default: 10,000.
    pub count: usize,
    /// Maximum number of possible relabellings for which all are used instead; at most [`MAX_RELABELLINGS`]. Default:
    /// 20,000.
    pub exact_up_to: usize,
    /// Seed of the random relabellings. Default: 0.
    pub seed: u64,
}

impl Default for PermutationParams {
    fn default() -> Self {
        Self { count: 10_000, exact_up_to: 20_000, seed: 0 }
    }
}

/// p values by relabelling, at each of V vertices.
#[derive(Debug, Clone)]
pub struct FamilyWise {
    /// Probability, without an effect at any vertex, that the largest statistic over all vertices is at least this one,
    /// (V).
    pub p: Vec<f64>,
    /// Probability, without an effect, that the vertex's statistic is at least this one: uncorrected, without assuming
    /// normal errors, (V).
    pub pointwise: Vec<f64>,
    /// Kind of relabelling used.
    pub resampling: Resampling,
    /// Number of relabellings, including the original labels.
    pub relabellings: usize,
    /// Whether these are all relabellings.
    pub exact: bool,
    /// The smallest possible p value.
    pub floor: f64,
}

/// Number of relabellings whose products are computed together.
const BATCH: usize = 64;
/// Statistics are treated as equal if they differ by less than this, the level of rounding errors.
const TIE: f64 = 1e-9;

const STAGE: Stage = Stage::counted("permutations", "relabellings");

/// The statistic by which relabelled studies are compared.
pub(crate) enum Compared<'a> {
    /// t, F or `T^2` with pooled variances.
    Pooled(&'a Projection),
    /// Welch's t or its `T^2` of two groups, given the group of each subject.
    Welch(&'a Projection, &'a [usize]),
}

/// Returns family-wise p values of values (n, V d); `None` if no relabelling changes the statistics.
pub(crate) fn family_wise(
    values: ArrayView2<'_, f64>,
    components: usize,
    compared: &Compared<'_>,
    params: &PermutationParams,
    monitor: &dyn Monitor,
) -> Result<Option<FamilyWise>, ShapeError> {
    for (name, found) in [("relabellings", params.count), ("exact_up_to", params.exact_up_to)] {
        if found > MAX_RELABELLINGS || (found == 0 && name == "relabellings") {
            let expected = "expected 1 to 100,000,000";
            return Err(ShapeError::Setting { name, found: found.to_string(), expected });
        }
    }
    let (model, resampling, share) = match *compared {
        Compared::Pooled(model) => {
            let resampling = Resampling::choose(model);
            let residuals = model.residual(values);
            let share = Share::Explained(Explained::new(residuals, values, components, model, resampling));
            (model, resampling, share)
        }
        Compared::Welch(model, groups) => {
            (model, Resampling::SignFlips, Share::Welch(WelchFlips::new(values, components, groups)))
        }
    };
    let rows = ndarray::concatenate![Axis(1), model.effect, model.nuisance];
    let arrangements = Arrangements::new(rows.view(), resampling, params.count, params.exact_up_to, params.seed);
    let floor = if arrangements.exact { smallest(&arrangements, model) } else { 1.0 / arrangements.count as f64 };
    if floor >= 1.0 {
        return Ok(None);
    }
    let vertices = values.ncols() / components;
    let identity: Relabelling = (0..values.nrows()).map(|i| (i as u32, 1.0)).collect();
    let mut own = vec![0.0; vertices];
    share.evaluate(std::slice::from_ref(&identity), |_, first, found| {
        own[first..first + found.len()].copy_from_slice(found)
    });
    let reached: Vec<f64> = own.iter().map(|own| own * (1.0 - TIE)).collect();

    monitor.begin(STAGE, arrangements.count as u64);
    let batches = arrangements.count.div_ceil(BATCH);
    let (largest, counts) = (0..batches)
        .into_par_iter()
        .map(|batch| {
            monitor.check()?;
            let relabellings = arrangements.range(batch * BATCH, ((batch + 1) * BATCH).min(arrangements.count));
            let mut largest = vec![0.0_f64; relabellings.len()];
            let mut counts = vec![0u32; vertices];
            share.evaluate(&relabellings, |which, first, found| {
                for ((found, reached), count) in found.iter().zip(&reached[first..]).zip(&mut counts[first..]) {
                    largest[which] = largest[which].max(*found);
                    *count += u32::from(found >= reached);
                }
            });
            monitor.step(relabellings.len() as u64);
            Ok((largest, counts))
        })
        .try_reduce(
            || (Vec::new(), vec![0u32; vertices]),
            |(mut largest, mut counts), (more, other)| {
                largest.extend(more);
                counts.iter_mut().zip(other).for_each(|(count, other)| *count += other);
                Ok::<_, ShapeError>((largest, counts))
            },
        )?;
    monitor.end();
    let mut sorted = largest;
    sorted.sort_by(f64::total_cmp);
    let all = arrangements.count as f64;
    let p = reached.iter().map(|reached| (sorted.len() - sorted.partition_point(|most| most < reached)) as f64 / all);
    let p: Vec<f64> = p.collect();
    let pointwise = counts.into_iter().map(|count| f64::from(count) / all).collect();
    Ok(Some(FamilyWise {
        p,
        pointwise,
        resampling,
        relabellings: arrangements.count,
        exact: arrangements.exact,
        floor,
    }))
}

/// Returns the fraction of all relabellings that have the same statistics as the original labels.
fn smallest(arrangements: &Arrangements, model: &Projection) -> f64 {
    let batches = (0..arrangements.count).step_by(BATCH);
    let count: usize = batches
        .map(|from| {
            let batch = arrangements.range(from, (from + BATCH).min(arrangements.count));
            batch.iter().filter(|relabelling| model.unchanged_by(relabelling)).count()
        })
        .sum();
    count.max(1) as f64 / arrangements.count as f64
}

/// Evaluator of the statistic that is compared between relabellings.
enum Share<'a> {
    Explained(Explained<'a>),
    Welch(WelchFlips),
}

impl Share<'_> {
    /// Calls `use_it(index of the relabelling, first vertex, values)` for runs of vertices.
    fn evaluate(&self, relabellings: &[Relabelling], use_it: impl FnMut(usize, usize, &[f64])) {
        match self {
            Self::Explained(explained) => explained.evaluate(relabellings, use_it),
            Self::Welch(flips) => flips.evaluate(relabellings, use_it),
        }
    }
}
