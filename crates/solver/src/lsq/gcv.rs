//! Chooses the smoothness of a fit (the weight lambda of the penalty) by generalised cross-validation (GCV).
//!
//! ```text
//! GCV(lambda) = n |W^(1/2) (f - A x_lambda)|^2 / (n - tr H)^2,   H = A (A^T W A + P)^-1 A^T W
//! tr H = K - tr(P N^-1) = K - E[ z^T P^(1/2) N^-1 P^(1/2) z ]
//! ```
//!
//! Here x_lambda is the solution for the smoothness lambda, P is the penalty, H is the hat matrix, and N = A^T W A + P.
//! The expected value E is estimated from a few probes z, which are vectors of independent signs (M. F. Hutchinson,
//! Commun. Stat. Simul. 19, 1990). The same probes are used for every lambda, so that GCV is a smooth function of
//! lambda, whose minimum can be searched for. G. H. Golub, M. Heath, G. Wahba, "Generalized cross-validation as a
//! method for choosing a good ridge parameter", Technometrics 21 (1979). All columns of a target share one lambda, so
//! the squares of their residuals are summed. Degree 0 has no penalty, so GCV doesn't depend on the mean of a column.
//! The mean is subtracted, because the error of a solve is proportional to the norm of the column.
//!
//! For each of 23 values of lambda, conjugate gradients solve once for the columns of the target and the probes.

use ndarray::{Array2, ArrayView2, s};
use serde::Serialize;
use spharm_harmonics::basis_size;
use spharm_monitor::{Monitor, OnlyCancel, Stage};

use super::cg::{Cg, CgParams};
use super::columns::scale_rows;
use super::moments::{MomentProblem, Summed};
use super::preconditioner::Diagonal;
use super::problem::Problem;
use super::signs::sign;
use crate::SolverError;
use crate::gram::smoothness_penalty;

/// Number of random vectors z from which the trace `tr(P N^-1)` is estimated. The error of the estimate, a few percent,
/// decreases with the square root of this number.
pub const PROBES: usize = 3;
/// Number of values of lambda on the coarse grid.
const COARSE: usize = 13;
/// Number of values of lambda in the golden-section search that follows the coarse grid. The search reduces the ratio
/// of neighbouring lambdas from 30 on the grid to 1.1.
const FINE: usize = 10;

/// The result of a search for the smoothness.
#[derive(Debug, Clone, Serialize)]
pub struct Gcv {
    /// The lambda that minimises GCV.
    pub smoothness: f64,
    /// All values that were tried, in the order of the search: (lambda, GCV, tr H).
    pub tried: Vec<[f64; 3]>,
    /// Whether the minimum is at the lower end of the search range, which means that the targets need no penalty at
    /// all.
    pub at_the_end: bool,
    /// The lambda of each channel, if lambda was searched for each channel separately. The other fields then describe
    /// the channel with the largest lambda. Empty if all columns share lambda.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub by_channel: Vec<f64>,
}

/// Chooses the smoothness lambda for a problem given by its moments; all columns share lambda. Trying 23 values costs
/// about as much as a few hundred products of [`MomentProblem::operator`].
///
/// Reports one stage, `smoothness`, counted in values of lambda, to the monitor.
///
/// # Errors
///
/// [`SolverError::Interrupted`] if the monitor cancels the search; [`SolverError::LostResidual`] if rounding errors of
/// the moments hide the residual.
pub fn choose_smoothness_by_moments(problem: &MomentProblem, monitor: &dyn Monitor) -> Result<Gcv, SolverError> {
    let centred = problem.centred();
    let adjoint = Summed { problem: &centred, penalty: None }.right_sides()?;
    let found = search(&centred, adjoint, monitor)?;
    match problem.lost_together(found.square(problem.rows())) {
        Some(column) => Err(SolverError::LostResidual { column }),
        None => Ok(found),
    }
}

impl Gcv {
    /// Returns the residual's sum of squares at the chosen smoothness, for n rows. The result isn't finite if GCV isn't
    /// finite.
    fn square(&self, rows: usize) -> f64 {
        let (least, rows) = (least(&self.tried), rows as f64);
        least[1] * (rows - least[2]).powi(2) / rows
    }
}

/// Returns the entry of `tried` with the smallest generalised cross-validation score.
fn least(tried: &[[f64; 3]]) -> [f64; 3] {
    tried.iter().copied().min_by(|x, y| x[1].total_cmp(&y[1])).unwrap_or_default()
}

/// The operations that cross-validation requires of a problem.
pub(super) trait Validated {
    fn max_degree(&self) -> usize;
    /// Returns the number of rows with nonzero weight.
    fn rows(&self) -> usize;
    /// Returns the sum of the weights.
    fn weight(&self) -> f64;
    /// Solves the normal equations for right-hand sides (K, c), with a penalty whose diagonal is `penalty` (K).
    fn solve(&self, right: Array2<f64>, penalty: &[f64], monitor: &dyn Monitor) -> Result<Array2<f64>, SolverError>;
    /// Returns `|W^(1/2) (f - A x)|^2`, summed over all columns.
    fn square(&self, x: ArrayView2<'_, f64>) -> Result<f64, SolverError>;
}

pub(super) const CG: CgParams = CgParams { tolerance: 1e-7, max_iterations: 300, patience: 100 };

impl Validated for MomentProblem {
    fn max_degree(&self) -> usize {
        MomentProblem::max_degree(self)
    }

    fn rows(&self) -> usize {
        MomentProblem::rows(self)
    }

    fn weight(&self) -> f64 {
        MomentProblem::weight(self)
    }

    fn solve(&self, right: Array2<f64>, penalty: &[f64], monitor: &dyn Monitor) -> Result<Array2<f64>, SolverError> {
        let preconditioner = Diagonal::new(self.max_degree(), self.weight(), Some(penalty));
        let mut cg = Cg::from_right_sides(right);
        cg.run(&Summed { problem: self, penalty: Some(penalty) }, &preconditioner, &CG, monitor)?;
        Ok(cg.x)
    }

    fn square(&self, x: ArrayView2<'_, f64>) -> Result<f64, SolverError> {
        Ok(self.residual_squares(&x.to_owned())?.into_iter().sum())
    }
}

/// Chooses the smoothness lambda for a problem with the right-hand sides `adjoint` (K, c).
pub(super) fn search(problem: &dyn Validated, adjoint: Array2<f64>, monitor: &dyn Monitor) -> Result<Gcv, SolverError> {
    let probes = probes(problem.max_degree());
    let terms = |smoothness: f64| terms(problem, &adjoint, &probes, smoothness, &OnlyCancel(monitor));
    choose_smoothness_by(problem.max_degree(), problem.weight(), terms, monitor)
}

/// The terms of GCV at one smoothness.
#[derive(Debug, Clone, Copy)]
pub struct GcvTerms {
    /// Sum of the squares of the residual.
    pub square: f64,
    /// Trace of the hat matrix.
    pub trace: f64,
    /// Number of data points, n.
    pub rows: f64,
}

impl GcvTerms {
    fn score(self) -> f64 {
        let Self { square, trace, rows } = self;
        // With more coefficients than data, a fit reproduces the data and GCV is meaningless, unless the penalty is
        // large enough to leave a residual.
        let left = rows - trace.clamp(0.0, rows);
        if left > 1e-3 * rows { rows * square / (left * left) } else { f64::INFINITY }
    }
}

/// Chooses the smoothness lambda for fits whose hat matrix isn't `A (A^T W A + P)^-1 A^T W`. `terms` computes the terms
/// of GCV for a given lambda. `weight` is the sum of the weights; the range of the search depends on it.
///
/// Reports one stage, `smoothness`, counted in values of lambda, to the monitor.
///
/// # Errors
///
/// The errors of `terms`.
pub fn choose_smoothness_by<E>(
    max_degree: usize,
    weight: f64,
    mut terms: impl FnMut(f64) -> Result<GcvTerms, E>,
    monitor: &dyn Monitor,
) -> Result<Gcv, E> {
    let even = weight / (4.0 * std::f64::consts::PI);
    let top = ((max_degree * (max_degree + 1)) as f64).max(2.0).powi(2);
    // Search from a negligible penalty, 1e-6 of the highest degree's diagonal, to a penalty that suppresses degree 2.
    let (low, high) = ((1e-6 * even / top).ln(), (even / 36.0).ln());
    monitor.begin(Stage::counted("smoothness", "values"), (COARSE + FINE) as u64);
    let mut tried = Vec::new();
    let mut gcv = |logarithm: f64| -> Result<f64, E> {
        let smoothness = logarithm.exp();
        let found = terms(smoothness)?;
        tried.push([smoothness, found.score(), found.trace.clamp(0.0, found.rows)]);
        monitor.step(1);
        Ok(found.score())
    };
    let step = (high - low) / (COARSE - 1) as f64;
    let mut best = (0, f64::INFINITY);
    for i in 0..COARSE {
        let value = gcv(low + step * i as f64)?;
        if value < best.1 {
            best = (i, value);
        }
    }
    let at_the_end = best.0 == 0;
    let centre = low + step * best.0 as f64;
    let (mut a, mut b) = ((centre - step).max(low), (centre + step).min(high));
    let golden = (5f64.sqrt() - 1.0) / 2.0;
    let (mut c, mut d) = (b - golden * (b - a), a + golden * (b - a));
    let (mut at_c, mut at_d) = (gcv(c)?, gcv(d)?);
    for _ in 0..FINE - 2 {
        if at_c < at_d {
            (b, d, at_d) = (d, c, at_c);
            c = b - golden * (b - a);
            at_c = gcv(c)?;
        } else {
            (a, c, at_c) = (c, d, at_d);
            d = a + golden * (b - a);
            at_d = gcv(d)?;
        }
    }
    monitor.end();
    Ok(Gcv { smoothness: least(&tried)[0], tried, at_the_end, by_channel: Vec::new() })
}

/// Returns the terms of GCV for a problem with the right-hand sides `adjoint` (K, c).
fn terms(
    problem: &dyn Validated,
    adjoint: &Array2<f64>,
    probes: &Array2<f64>,
    smoothness: f64,
    monitor: &dyn Monitor,
) -> Result<GcvTerms, SolverError> {
    let (max_degree, c) = (problem.max_degree(), adjoint.ncols());
    let penalty = smoothness_penalty(max_degree, smoothness);
    let roots: Vec<f64> = penalty.iter().map(|p| p.sqrt()).collect();
    let mut probes = probes.clone();
    scale_rows(&mut probes, &roots);
    let mut right = Array2::zeros((adjoint.nrows(), c + PROBES));
    right.slice_mut(s![.., ..c]).assign(adjoint);
    right.slice_mut(s![.., c..]).assign(&probes);
    let x = problem.solve(right, &penalty, monitor)?;
    let square = problem.square(x.slice(s![.., ..c]))?;
    let lost = (&probes * &x.slice(s![.., c..])).sum() / PROBES as f64;
    Ok(GcvTerms { square, trace: basis_size(max_degree) as f64 - lost, rows: problem.rows() as f64 })
}

/// Returns the probes (K, PROBES): signs generated from a counter.
fn probes(max_degree: usize) -> Array2<f64> {
    Array2::from_shape_fn((basis_size(max_degree), PROBES), |(k, c)| sign((k * PROBES + c) as u64))
}
