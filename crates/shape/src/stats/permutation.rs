//! Computes family-wise p values: the fraction of relabelled studies whose largest statistic reaches the statistic of
//! a vertex.
//!
//! The method is single-step max-T (P. H. Westfall and S. S. Young, "Resampling-Based Multiple Testing" (1993)). The
//! residuals of the reduced model are relabelled by permutations of subjects or by sign flips; see [`Resampling`]. This
//! relabelling is from D. Freedman and D. Lane, "A nonstochastic interpretation of reported significance levels", J.
//! Bus. Econ. Stat. 1 (1983). If there are at most [`PermutationParams::exact_up_to`] relabellings, all of them are
//! used and p values are exact. With B random relabellings, of which `count` reach the statistic, p is `(count + 1) /
//! (B + 1)`.
//!
//! # Computation
//!
//! The residuals e of the reduced model are whitened once at each vertex. The d components of e are then uncorrelated,
//! and each has a sum of squares of 1. The columns of Q_E (n, q) and Q_Z (n, p - q) are orthonormal bases of the tested
//! part of the design and of the reduced model. Let P be a signed permutation, `b = (P^T Q_E)^T e`, and `g = (P^T
//! Q_Z)^T e`. Both are products of rows of length n with the residuals (n, V d). The effect explains the fraction `u =
//! b (1 - g^T g)^-1 b^T` of the reduced model's scatter. This fraction u increases with |t|, F and `T^2`, so that only
//! u needs to be compared. For v degrees of freedom, `T^2 = v u / (1 - u)`. For permutations g is 0 if the reduced
//! model is a constant. `welch_flips` computes the statistics for unequal variances.
//!
//! Cost: `2 n V d p` flops per relabelling, or `2 n V d q` if the reduced model is a constant. For example, 10,000
//! relabellings of 100 subjects with one value at each of 10,242 vertices take 2e10 flops. Memory: `8 n V d` bytes for
//! the residuals, and 2 MB per thread.

use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;
use spharm_monitor::{Monitor, Stage};

use super::TestParams;
use super::arrangements::{Arrangements, Relabelling, identity};
use super::aspin_welch::AspinWelch;
use super::blocks::{Exchange, Unit, aligned, are_equal, free};
use super::design::Design;
use super::explained::Explained;
use super::linear::Statistic;
use super::projection::Projection;
use super::resampling::Resampling;
use super::spatial::{Clusters, Largest, Regions, Tfce};
use super::welch_flips::WelchFlips;
use crate::ShapeError;

/// Maximum number of relabellings of a test. The largest statistics of this many relabellings take 2.4 GB of memory.
pub const MAX_RELABELLINGS: usize = 100_000_000;

/// Settings of the permutation test.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PermutationParams {
    /// Number of random relabellings, 1 to [`MAX_RELABELLINGS`]. Default: 10,000.
    pub count: usize,
    /// If at most this many relabellings are possible, all of them are used instead of random relabellings. At most
    /// [`MAX_RELABELLINGS`]. Default: 20,000.
    pub exact_up_to: usize,
    /// Seed of the random relabellings. Default: 0.
    pub seed: u64,
}

impl Default for PermutationParams {
    fn default() -> Self {
        Self { count: 10_000, exact_up_to: 20_000, seed: 0 }
    }
}

/// P values at each of V vertices, computed from relabelled studies.
#[derive(Debug, Clone)]
pub struct FamilyWise {
    /// Family-wise p values (V). If there is no effect at any vertex, this is the probability that the largest
    /// statistic over all vertices reaches the vertex's statistic.
    pub p: Vec<f64>,
    /// Uncorrected p values (V) that don't assume normal errors. If there is no effect, this is the probability that
    /// the statistic at the vertex is at least as large as the observed statistic.
    pub pointwise: Vec<f64>,
    /// Kind of relabelling used.
    pub resampling: Resampling,
    /// Number of relabellings, including the original labels.
    pub relabellings: usize,
    /// Whether all possible relabellings were used.
    pub exact: bool,
    /// Smallest possible p value.
    pub floor: f64,
    /// Threshold-free cluster enhancement and its p values, if requested.
    pub tfce: Option<Tfce>,
    /// Clusters and their p values, if requested.
    pub clusters: Option<Clusters>,
}

/// Number of relabellings whose matrix products are computed together.
const BATCH: usize = 64;
/// Number of random relabellings that are examined to estimate the fraction of all relabellings that leave the
/// statistics unchanged.
const LOOKED: usize = 1000;
/// Relative difference up to which statistics are treated as equal, because of rounding errors.
const TIE: f64 = 1e-9;

const STAGE: Stage = Stage::counted("permutations", "relabellings");

/// Statistic by which relabelled studies are compared.
pub(crate) enum Compared<'a> {
    /// The statistics t, F or `T^2` with pooled variances.
    Pooled,
    /// Welch's t or Welch's `T^2` of two groups, given the group of each subject.
    Welch(&'a [usize]),
    /// Aspin and Welch's v, or its generalisation G, given the variance group of each subject.
    VarianceGroups(&'a AspinWelch, &'a [usize]),
}

/// Returns the family-wise p values of a test of values (n, V d) with the statistic `kind`. Also returns whether whole
/// blocks are exchanged although their rows correspond only by their order. Returns `None` if no relabelling changes
/// the statistics.
pub(crate) fn family_wise(
    values: ArrayView2<'_, f64>,
    components: usize,
    (design, model, compared, kind): (&Design, &Projection, &Compared<'_>, &Statistic),
    (params, test): (&PermutationParams, &TestParams),
    monitor: &dyn Monitor,
) -> Result<Option<(FamilyWise, bool)>, ShapeError> {
    for (name, found, least, expected) in [
        ("relabellings", params.count, 1, "expected 1 to 100,000,000"),
        ("exact_up_to", params.exact_up_to, 0, "expected 0 to 100,000,000"),
    ] {
        if !(least..=MAX_RELABELLINGS).contains(&found) {
            return Err(ShapeError::Setting { name, found: found.to_string(), expected });
        }
    }
    let blocks = test.blocks.as_ref();
    let (sets, by_order) = match blocks {
        Some(blocks) if blocks.exchange() == Exchange::Whole => aligned(blocks.sets(), design.matrix()),
        Some(blocks) => (blocks.sets(), false),
        None => (free(values.nrows()), false),
    };
    let chosen = match compared {
        Compared::Pooled => Resampling::choose(model, &sets),
        Compared::Welch(_) | Compared::VarianceGroups(..) => Resampling::SignFlips,
    };
    let resampling = test.errors.unwrap_or(chosen);
    let share = match compared {
        Compared::Pooled => {
            let residuals = model.residual(values);
            let orthogonal = stays_orthogonal(model, resampling, &sets);
            Share::Explained(Explained::new(residuals, values, components, model, orthogonal))
        }
        Compared::Welch(groups) => Share::Welch(WelchFlips::new(values, components, groups)),
        Compared::VarianceGroups(prepared, _) => Share::VarianceGroups(prepared),
    };
    let mut rows = ndarray::concatenate![Axis(1), model.effect, model.nuisance];
    let groups = match compared {
        Compared::VarianceGroups(_, groups) => Some(*groups),
        Compared::Pooled | Compared::Welch(_) => None,
    };
    if let Some(groups) = groups {
        // Rows of different variance groups are treated as different, even if they are equal in the design.
        let column = Array2::from_shape_fn((groups.len(), 1), |(i, _)| groups[i] as f64);
        rows = ndarray::concatenate![Axis(1), rows, column];
    }
    if resampling != Resampling::Permutations && blocks.is_some_and(|blocks| blocks.exchange() == Exchange::Within) {
        return Err(ShapeError::FlippedRows { resampling });
    }
    let asked = blocks.is_some() || test.errors.is_some();
    if asked && resampling == Resampling::Permutations && units_are_equal(&sets, &model.tested) {
        // If blocks of different sizes have different values in the tested columns, the error asks for blocks of the
        // same size.
        let tested = model.tested.view();
        let is_in = |row: u32, unit: &Unit| unit.iter().any(|other| are_equal(&vec![row], &vec![*other], tested));
        let within = |a: &Unit, b: &Unit| a.iter().all(|row| is_in(*row, b));
        let first = &sets[0][0];
        let differ = sets.iter().any(|set| !(within(&set[0], first) && within(first, &set[0])));
        if differ && blocks.is_some_and(|blocks| blocks.exchange() == Exchange::Whole) {
            let sizes: Vec<String> = sets.iter().map(|set| set[0].len().to_string()).collect();
            return Err(ShapeError::Setting {
                name: "the number of rows of a whole block",
                found: sizes.join(" or "),
                expected: "only blocks with equal numbers of rows can be exchanged, but such blocks have equal values \
                           in the tested columns; give all blocks the same number of rows, or give one row for each \
                           block",
            });
        }
        return Err(ShapeError::NoRelabelling { resampling, blocks: blocks.is_some() });
    }
    let arrangements = Arrangements::new(rows.view(), sets, resampling, params.count, params.exact_up_to, params.seed);
    let floor = smallest(&arrangements, model, groups);
    if floor >= 1.0 {
        if asked {
            return Err(ShapeError::NoRelabelling { resampling, blocks: blocks.is_some() });
        }
        return Ok(None);
    }
    let vertices = values.ncols() / components;
    let mut own = vec![0.0; vertices];
    share.evaluate(&[identity(values.nrows())], |_, first, found| {
        own[first..first + found.len()].copy_from_slice(found)
    });
    let reached: Vec<f64> = own.iter().map(|own| own.abs() * (1.0 - TIE)).collect();
    let unscaled = |value: f64| share.statistic(kind, value);
    let regions = test.spatial.as_ref().map(|spatial| (spatial, spatial.cluster.map(|p| kind.threshold(p))));

    monitor.begin(STAGE, arrangements.count as u64);
    let batches = arrangements.count.div_ceil(BATCH);
    let (largest, counts) = (0..batches)
        .into_par_iter()
        .map(|batch| {
            monitor.check()?;
            let relabellings = arrangements.range(batch * BATCH, ((batch + 1) * BATCH).min(arrangements.count));
            let mut largest = vec![(0.0_f64, Largest::default()); relabellings.len()];
            let mut counts = vec![0u32; vertices];
            let kept = if regions.is_some() { relabellings.len() } else { 0 };
            let mut maps = Array2::zeros((kept, vertices));
            share.evaluate(&relabellings, |which, first, found| {
                for ((found, reached), count) in found.iter().zip(&reached[first..]).zip(&mut counts[first..]) {
                    let found = found.abs();
                    largest[which].0 = largest[which].0.max(found);
                    *count += u32::from(found >= *reached);
                }
                if kept > 0 {
                    let found = found.iter().map(|value| unscaled(*value));
                    maps.slice_mut(s![which, first..]).iter_mut().zip(found).for_each(|(map, value)| *map = value);
                }
            });
            if let Some((spatial, threshold)) = &regions {
                let mut forest = Regions::new(&spatial.surface);
                for (map, (_, largest)) in maps.rows().into_iter().zip(&mut largest) {
                    *largest = forest.largest(map.to_slice().unwrap_or_default(), spatial.tfce, *threshold);
                }
            }
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
    let all = arrangements.count as f64;
    let pointwise = counts.into_iter().map(|count| f64::from(count) / all).collect();
    let null = |pick: fn(&(f64, Largest)) -> f64| Null::new(largest.iter().map(pick).collect());
    let of_maps = null(|(most, _)| *most);
    let mut result = FamilyWise {
        p: own.iter().map(|own| of_maps.p(own.abs())).collect(),
        pointwise,
        resampling,
        relabellings: arrangements.count,
        exact: arrangements.exact,
        floor,
        tfce: None,
        clusters: None,
    };
    if let Some((spatial, threshold)) = regions {
        let mut forest = Regions::new(&spatial.surface);
        let map: Vec<f64> = own.iter().map(|own| unscaled(*own)).collect();
        if spatial.tfce {
            let (statistic, null) = (forest.tfce(&map), null(|(_, largest)| largest.tfce));
            let p = statistic.iter().map(|value| null.p(value.abs())).collect();
            result.tfce = Some(Tfce { statistic, p });
        }
        if let Some(threshold) = threshold {
            let (mut clusters, null) = (forest.clusters(&map, threshold), null(|(_, largest)| largest.area));
            clusters.clusters.iter_mut().for_each(|cluster| cluster.p = null.p(cluster.area));
            result.clusters = Some(clusters);
        }
    }
    // Sign flips don't exchange rows of different blocks.
    Ok(Some((result, by_order && resampling != Resampling::SignFlips)))
}

/// Largest statistic of each relabelled study, in ascending order.
struct Null(Vec<f64>);

impl Null {
    fn new(mut largest: Vec<f64>) -> Self {
        largest.sort_by(f64::total_cmp);
        Self(largest)
    }

    /// Returns the p value of a statistic: the fraction of relabelled studies whose largest statistic reaches it.
    fn p(&self, statistic: f64) -> f64 {
        let reached = statistic * (1.0 - TIE);
        (self.0.len() - self.0.partition_point(|most| *most < reached)) as f64 / self.0.len() as f64
    }
}

/// Returns whether relabelled residuals stay orthogonal to the reduced model. This is the case if the reduced model is
/// empty, or if permutations exchange only subjects that have equal rows in the reduced model.
fn stays_orthogonal(model: &Projection, resampling: Resampling, sets: &[Vec<Unit>]) -> bool {
    let exchanged = resampling == Resampling::Permutations && units_are_equal(sets, &model.nuisance);
    model.nuisance.ncols() == 0 || exchanged
}

/// Returns whether all units within each set have equal rows.
fn units_are_equal(sets: &[Vec<Unit>], rows: &Array2<f64>) -> bool {
    sets.iter().all(|set| set.iter().all(|unit| are_equal(unit, &set[0], rows.view())))
}

/// Returns the smallest possible p value: the fraction of the relabellings that have the same statistics as the
/// original labels.
fn smallest(arrangements: &Arrangements, model: &Projection, groups: Option<&[usize]>) -> f64 {
    // A relabelling may leave the statistics unchanged if it swaps whole variance groups, but not if it mixes them.
    let in_groups = |relabelling: &Relabelling| {
        let keeps = |groups: &[usize]| {
            let mut other = vec![None; groups.len()];
            groups.iter().zip(relabelling).all(|(group, (from, _))| {
                let of = groups[*from as usize];
                *other[*group].get_or_insert(of) == of
            })
        };
        groups.is_none_or(keeps)
    };
    let looked = if arrangements.exact { arrangements.count } else { arrangements.count.min(LOOKED) };
    let unchanged: usize = (0..looked)
        .step_by(BATCH)
        .map(|from| {
            let batch = arrangements.range(from, (from + BATCH).min(looked));
            batch.iter().filter(|of| in_groups(of) && model.unchanged_by(of)).count()
        })
        .sum();
    // If relabellings are random, the first one has the original labels, and the others are a sample of all possible
    // relabellings.
    let others = unchanged.saturating_sub(1) as f64 * (arrangements.count - 1) as f64 / (looked - 1).max(1) as f64;
    (1.0 + others) / arrangements.count as f64
}

/// Data prepared for computing the statistics of relabelled studies.
enum Share<'a> {
    /// Evaluates the fraction of the scatter that the effect explains, for pooled variances.
    Explained(Explained<'a>),
    /// Evaluates, for two groups, the square of Welch's t, or its multivariate form `T^2`.
    Welch(WelchFlips),
    /// Evaluates the square of Aspin and Welch's v, or G.
    VarianceGroups(&'a AspinWelch),
}

impl Share<'_> {
    /// Calls `use_it` for each relabelling and each range of vertices. The arguments are the index of the relabelling,
    /// the first vertex of the range, and the values in the range.
    fn evaluate(&self, relabellings: &[Relabelling], use_it: impl FnMut(usize, usize, &[f64])) {
        match self {
            Self::Explained(explained) => explained.evaluate(relabellings, use_it),
            Self::Welch(flips) => flips.evaluate(relabellings, use_it),
            Self::VarianceGroups(prepared) => prepared.evaluate(relabellings, use_it),
        }
    }

    /// Converts a value from [`evaluate`](Self::evaluate) to the statistic: signed t, F or `T^2`.
    fn statistic(&self, kind: &Statistic, value: f64) -> f64 {
        let t = |square: f64| square.abs().sqrt().copysign(square);
        // If u is the explained fraction of the scatter and v the degrees of freedom, t^2 or T^2 is v u / (1 - u). If
        // the effect explains all scatter, the errors have no variance, and the statistic is 0, as in the map of the
        // original study.
        let odds = |u: f64| if u.abs() < 1.0 - 1e-13 { u / (1.0 - u.abs()) } else { 0.0 };
        match (self, kind) {
            (Self::Explained(_), Statistic::T { freedom }) => t(freedom * odds(value)),
            (Self::Explained(_), Statistic::F { between, within }) => within / between * odds(value),
            (Self::Explained(_), Statistic::TSquared { freedom, .. }) => freedom * odds(value),
            (_, Statistic::T { .. }) => t(value),
            _ => value,
        }
    }
}
