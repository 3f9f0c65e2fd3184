//! Family-wise p values: how often the largest statistic of a relabelled study reaches a vertex's own.
//!
//! P. H. Westfall and S. S. Young, "Resampling-Based Multiple Testing" (1993): single-step max-T. With covariates the
//! residuals of the reduced model are relabelled: D. Freedman and D. Lane, "A nonstochastic interpretation of reported
//! significance levels", J. Bus. Econ. Stat. 1 (1983). Where there are at most [`PermutationParams::exact_up_to`]
//! relabellings all of them are taken and p values are exact; else p is `(count + 1) / (B + 1)`.
//!
//! # Computation
//!
//! The residuals e of the reduced model are whitened once at each vertex: their d components are uncorrelated, their sums
//! of squares one. For a relabelling P let `b = (P^T Q_E)^T e`, `g = (P^T Q_Z)^T e`: a product of a row of n with (n, V d). The
//! share of the reduced model's scatter that the effect explains, `u = b (1 - g^T g)^-1 b^T`, grows with |t|, F and `T^2`
//! alike (`T^2 = v u / (1 - u)`), so that only u is compared; where the reduced model is a constant, g = 0. Cost: `2 n V d
//! (q + p - q)` flops a relabelling, `2 n V d q` with a constant alone; 10,000 of 100 subjects at 10,242 vertices of a
//! scalar are 2e10. Memory: `8 n V d` bytes for the residuals, as much again for Welch's t, and 2 MB a thread.

use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;
use spharm_monitor::{Monitor, Stage};

use super::arrangements::{Arrangements, Relabelling};
use super::design::Design;
use super::linear::{Small, floors};
use super::projection::Projection;
use crate::ShapeError;
use crate::product::product;

/// Relabellings of a study.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PermutationParams {
    /// Number of random relabellings, at least 1. Default: 10,000.
    pub count: usize,
    /// Up to this number of possible relabellings all are taken instead. Default: 20,000.
    pub exact_up_to: usize,
    /// Seed of the random ones. Default: 0.
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
    /// Probability under no effect anywhere that the largest statistic of all vertices is at least this one, (V).
    pub p: Vec<f64>,
    /// The same for the statistic of this vertex alone: uncorrected, without assuming normal errors, (V).
    pub pointwise: Vec<f64>,
    /// Number of relabellings, the labels as they are among them.
    pub relabellings: usize,
    /// Whether these are all relabellings.
    pub exact: bool,
    /// The smallest p that they can give.
    pub floor: f64,
}

/// Relabellings whose products are formed together.
const BATCH: usize = 64;
/// Columns of a product: with a batch's rows they fit the L2 cache.
const COLUMNS: usize = 768;
/// Statistics that differ by less are the same but for rounding errors.
const TIE: f64 = 1e-9;

const STAGE: Stage = Stage::counted("permutations", "relabellings");

#[allow(clippy::too_many_arguments, reason = "what a test knows")]
pub(crate) fn family_wise(
    values: ArrayView2<'_, f64>,
    components: usize,
    design: &Design,
    model: &Projection,
    welch: bool,
    params: &PermutationParams,
    monitor: &dyn Monitor,
) -> Result<FamilyWise, ShapeError> {
    if params.count == 0 {
        return Err(ShapeError::NoRelabellings);
    }
    let signs = model.of_the_mean();
    let rows = ndarray::concatenate![Axis(1), model.effect, model.nuisance];
    let arrangements = Arrangements::new(rows.view(), signs, params.count, params.exact_up_to, params.seed);
    let reduced = model.residual(values);
    let share = if welch {
        let groups = design.two_groups().ok_or(ShapeError::NotTwoGroups)?;
        Share::Welch(Groups::new(reduced, &groups, &floors(values)))
    } else {
        Share::Explained(Explained::new(reduced, values, components, model))
    };
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
    let floor = if arrangements.exact { smallest(&arrangements, model) } else { 1.0 / all };
    Ok(FamilyWise { p, pointwise, relabellings: arrangements.count, exact: arrangements.exact, floor })
}

/// The share of all relabellings that have the statistics of the labels as they are: those that change the effect's sign
/// as a whole are among them.
fn smallest(arrangements: &Arrangements, model: &Projection) -> f64 {
    let same = |relabelling: &Relabelling| {
        let (effect, nuisance) = (&model.effect, &model.nuisance);
        let equal = |turn: f64| {
            relabelling.iter().enumerate().all(|(i, (from, sign))| {
                let from = *from as usize;
                let moved =
                    effect.row(from).into_iter().zip(effect.row(i)).all(|(a, b)| (sign * turn * a - b).abs() < 1e-9);
                moved && nuisance.row(from).into_iter().zip(nuisance.row(i)).all(|(a, b)| (a - b).abs() < 1e-9)
            })
        };
        equal(1.0) || equal(-1.0)
    };
    let count = arrangements.range(0, arrangements.count).iter().filter(|relabelling| same(relabelling)).count();
    count.max(1) as f64 / arrangements.count as f64
}

/// What is compared between relabellings.
enum Share<'a> {
    Explained(Explained<'a>),
    Welch(Groups),
}

impl Share<'_> {
    /// Calls `use_it(which relabelling, first vertex, values)` for runs of vertices.
    fn evaluate(&self, relabellings: &[Relabelling], use_it: impl FnMut(usize, usize, &[f64])) {
        match self {
            Self::Explained(explained) => explained.evaluate(relabellings, use_it),
            Self::Welch(groups) => groups.evaluate(relabellings, use_it),
        }
    }
}

/// The share of the scatter that the effect explains.
struct Explained<'a> {
    /// Residuals of the reduced model, whitened, (n, V d).
    whitened: Array2<f64>,
    components: usize,
    model: &'a Projection,
    /// Whether relabelling keeps the reduced model.
    constant: bool,
}

impl<'a> Explained<'a> {
    fn new(mut reduced: Array2<f64>, values: ArrayView2<'_, f64>, components: usize, model: &'a Projection) -> Self {
        let floor = floors(values);
        let floor = floor.chunks(components).map(|floor| floor.iter().copied().fold(0.0, f64::max));
        let mut blocks: Vec<_> = reduced.axis_chunks_iter_mut(Axis(1), components).zip(floor).collect();
        blocks.par_iter_mut().for_each(|(block, floor)| {
            let mut scatter = Small::gram(block.view());
            if scatter.factorise(*floor) {
                let mut row = vec![0.0; components];
                for mut values in block.rows_mut() {
                    row.iter_mut().zip(&values).for_each(|(row, value)| *row = *value);
                    scatter.whiten(&mut row);
                    values.iter_mut().zip(&row).for_each(|(value, row)| *value = *row);
                }
            } else {
                block.fill(0.0);
            }
        });
        drop(blocks);
        Self { whitened: reduced, components, model, constant: model.constant_nuisance() }
    }

    fn evaluate(&self, relabellings: &[Relabelling], mut use_it: impl FnMut(usize, usize, &[f64])) {
        let (effect, nuisance, d) = (&self.model.effect, &self.model.nuisance, self.components);
        let (q, z) = (effect.ncols(), if self.constant { 0 } else { nuisance.ncols() });
        let each = q + z;
        let n = effect.nrows();
        // A relabelling's rows: those of its effect, those of its reduced model.
        let mut rows = Array2::zeros((relabellings.len() * each, n));
        for (relabelling, mut rows) in relabellings.iter().zip(rows.axis_chunks_iter_mut(Axis(0), each)) {
            for (i, (from, sign)) in relabelling.iter().enumerate() {
                let from = *from as usize;
                (0..q).for_each(|k| rows[[k, i]] = sign * effect[[from, k]]);
                (0..z).for_each(|k| rows[[q + k, i]] = nuisance[[from, k]]);
            }
        }
        let run = (COLUMNS / d).max(1);
        let vertices = self.whitened.ncols() / d;
        let mut found = vec![0.0; run];
        for first in (0..vertices).step_by(run) {
            let count = run.min(vertices - first);
            let products = product(rows.view(), self.whitened.slice(s![.., first * d..(first + count) * d]));
            for (which, products) in products.axis_chunks_iter(Axis(0), each).enumerate() {
                let found = &mut found[..count];
                if z == 0 {
                    found.fill(0.0);
                    for row in products.rows() {
                        let row = row.to_slice().unwrap_or_default();
                        for (found, b) in found.iter_mut().zip(row.chunks_exact(d)) {
                            *found += b.iter().map(|b| b * b).sum::<f64>();
                        }
                    }
                } else {
                    for (v, found) in found.iter_mut().enumerate() {
                        *found = explained(products.slice(s![.., v * d..(v + 1) * d]), q);
                    }
                }
                use_it(which, first, found);
            }
        }
    }
}

/// `u = b (1 - g^T g)^-1 b^T` of the rows b, the first q, and g; summed over rows b of one component.
fn explained(products: ArrayView2<'_, f64>, q: usize) -> f64 {
    let d = products.ncols();
    if d == 1 {
        let square = |row: usize| products[[row, 0]].powi(2);
        let left = 1.0 - (q..products.nrows()).map(square).sum::<f64>();
        return if left > 1e-13 { (0..q).map(square).sum::<f64>() / left } else { 0.0 };
    }
    let rows: Vec<Vec<f64>> = products.rows().into_iter().map(|row| row.to_vec()).collect();
    if rows.iter().flatten().all(|value| *value == 0.0) {
        return 0.0;
    }
    let mut scatter = Small::unit_without(d, rows[q..].iter().map(Vec::as_slice));
    if scatter.factorise(0.0) { rows[..q].iter().map(|b| scatter.quotient(b)).sum() } else { 0.0 }
}

/// Welch's `t^2`.
struct Groups {
    /// Values less their mean, and their squares, (n, V).
    values: Array2<f64>,
    squares: Array2<f64>,
    /// Sums of the columns of squares.
    totals: Vec<f64>,
    floor: Vec<f64>,
    first: Vec<bool>,
}

impl Groups {
    fn new(values: Array2<f64>, groups: &[usize], floor: &[f64]) -> Self {
        let squares = values.mapv(|value| value * value);
        let totals = squares.sum_axis(Axis(0)).to_vec();
        Self { values, squares, totals, floor: floor.to_vec(), first: groups.iter().map(|group| *group == 0).collect() }
    }

    fn evaluate(&self, relabellings: &[Relabelling], mut use_it: impl FnMut(usize, usize, &[f64])) {
        let n = self.first.len();
        let ones = |(which, i): (usize, usize)| f64::from(self.first[relabellings[which][i].0 as usize]);
        let rows = Array2::from_shape_fn((relabellings.len(), n), ones);
        let n1 = self.first.iter().filter(|first| **first).count() as f64;
        let n2 = n as f64 - n1;
        let vertices = self.values.ncols();
        let mut found = vec![0.0; COLUMNS];
        for first in (0..vertices).step_by(COLUMNS) {
            let columns = first..(first + COLUMNS).min(vertices);
            let sums = product(rows.view(), self.values.slice(s![.., columns.clone()]));
            let squares = product(rows.view(), self.squares.slice(s![.., columns.clone()]));
            for which in 0..relabellings.len() {
                let found = &mut found[..columns.len()];
                for (v, found) in found.iter_mut().enumerate() {
                    let (sum, square, total) = (sums[[which, v]], squares[[which, v]], self.totals[first + v]);
                    // The mean of all is zero: the other group's sum is the negative.
                    let within = (square - sum * sum / n1, total - square - sum * sum / n2);
                    let error = within.0.max(0.0) / (n1 - 1.0) / n1 + within.1.max(0.0) / (n2 - 1.0) / n2;
                    let difference = sum / n1 + sum / n2;
                    *found = if total > self.floor[first + v] { difference * difference / error } else { 0.0 };
                }
                use_it(which, first, found);
            }
        }
    }
}
