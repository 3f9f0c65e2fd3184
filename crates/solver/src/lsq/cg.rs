//! Preconditioned conjugate gradients on the normal equations, for all columns together or, with moments, for a few
//! columns at a time.
//!
//! The problem is `min |W^(1/2) (A x - f)|^2 + x^T P x` for each column f of the targets, with the basis A, the
//! diagonal weights W and the diagonal penalty P. Its normal matrix is N = A^T W A + P. Starting from x = 0:
//!
//! ```text
//! r = A^T W f,  z = M r,  p = z
//! repeat   q = N p,  alpha = r^T z / p^T q,  x += alpha p,  r -= alpha q
//!          z = M r,  beta = r^T z / (r^T z)_before,  p = z + beta p
//! ```
//!
//! with the preconditioner M. In exact arithmetic the iterates equal the iterates of LSQR with the same preconditioner,
//! but less storage is needed: four (K, c) arrays, and no (n, c) array. The normal equations square the condition
//! number, so rounding limits the attainable optimality. Therefore r is recomputed at the end unless its errors are
//! estimated to be small, and the iteration is restarted from the recomputed r as long as the optimality improves. If
//! there are many solutions, iterating from zero tends to the solution of minimum norm.
//!
//! M. R. Hestenes and E. Stiefel, "Methods of conjugate gradients for solving linear systems", J. Res. NBS 49 (1952);
//! A. Bjorck, "Numerical methods for least squares problems" (1996), section 7.4.

mod groups;

use std::ops::Range;
use std::time::Instant;

use ndarray::Array2;
use spharm_monitor::{Level, Monitor};

use super::columns::{combine, dots, norms};
use super::normal_equations::NormalEquations;
use super::preconditioner::Preconditioner;
use super::problem::{Problem, ProductError, Sampled};
use super::progress::Progress;
use crate::SolverError;

/// When the iterations end, the gradient is recomputed if the estimated error of the optimality exceeds this fraction
/// of the tolerance.
const ERROR_SHARE: f64 = 0.2;

/// Stopping rules of conjugate gradients.
#[derive(Debug, Clone, Copy)]
pub struct CgParams {
    /// Optimality `|A^T W r - P x| / |A^T W f|` that every column must reach; default 1e-10.
    pub tolerance: f64,
    /// Maximum number of iterations; default 3000.
    pub max_iterations: usize,
    /// Maximum number of iterations without a halving of the optimality; default 250.
    pub patience: usize,
}

impl Default for CgParams {
    fn default() -> Self {
        Self { tolerance: 1e-10, max_iterations: 3000, patience: 250 }
    }
}

/// The result of conjugate gradients.
#[derive(Debug, Clone)]
pub struct CgFit {
    /// Solution x (K, c).
    pub solution: Array2<f64>,
    /// Residual `f - A x` (n, c).
    pub residual: Array2<f64>,
    /// Reason why the iteration ended.
    pub stop: Stop,
    /// Number of iterations.
    pub iterations: usize,
    /// Largest relative gradient `|A^T W r - P x| / |A^T W f|` of all columns, computed from the samples.
    pub optimality: f64,
}

/// Solves the normal equations for targets f (n, c), starting from x = 0.
///
/// Reports a step and a status message to the monitor for each iteration.
///
/// # Errors
///
/// [`SolverError::Interrupted`] if the monitor cancels the iteration, and the errors of the operator and the
/// preconditioner. An iteration that doesn't converge isn't an error.
pub fn solve(
    equations: &NormalEquations<'_>,
    targets: &Array2<f64>,
    preconditioner: &dyn Preconditioner,
    params: &CgParams,
    monitor: &dyn Monitor,
) -> Result<CgFit, SolverError> {
    let problem = Sampled { equations: *equations, targets, moments: None };
    let mut cg = Cg::new(&problem)?;
    let stop = cg.run(&problem, preconditioner, params, monitor)?;
    let (stop, residual) = cg.confirm(stop, &problem, preconditioner, params, monitor)?;
    let optimality = cg.optimality();
    // A problem with samples always has a residual.
    let residual = residual.unwrap_or_default();
    Ok(CgFit { solution: cg.x, residual, stop, iterations: cg.iterations, optimality })
}

/// Reason why an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stop {
    /// The tolerance was met.
    Converged,
    /// The optimality stopped improving.
    Stalled,
    /// The maximum number of iterations was reached.
    IterationLimit,
}

/// State of an iteration that can be resumed with another preconditioner.
pub(crate) struct Cg {
    /// Solution (K, c).
    pub(crate) x: Array2<f64>,
    /// Gradient `A^T W (f - A x) - P x`, as updated by the iteration.
    pub(crate) gradient: Array2<f64>,
    /// Norms of the columns of `A^T W f`.
    pub(crate) scale: Vec<f64>,
    pub(crate) iterations: usize,
    /// Number of the iteration at which the optimality last halved.
    pub(crate) best_at: usize,
    /// Estimated condition number of N, the maximum of the estimates for all columns. An estimate is the condition
    /// number of the preconditioned matrix, derived from alpha and beta, times the preconditioner's condition number.
    /// NaN if the preconditioner's condition number is unknown.
    pub(crate) condition: f64,
    /// Estimated error of the optimality if the iteration updated the gradient; 0 if the gradient was recomputed.
    pub(crate) doubt: f64,
    /// Wall time of the iterations in seconds.
    pub(crate) seconds: f64,
}

impl Cg {
    /// Creates the state of an iteration at x = 0.
    pub(crate) fn new(problem: &dyn Problem) -> Result<Self, SolverError> {
        Ok(Self::from_right_sides(problem.right_sides()?))
    }

    /// Creates the state of an iteration at x = 0 from right-hand sides (K, c).
    pub(crate) fn from_right_sides(gradient: Array2<f64>) -> Self {
        let scale = norms(&gradient);
        let x = Array2::zeros(gradient.dim());
        Self { x, gradient, scale, iterations: 0, best_at: 0, condition: 1.0, doubt: 0.0, seconds: 0.0 }
    }

    /// Returns the largest relative gradient of all columns, plus the estimated error of the gradient.
    pub(crate) fn optimality(&self) -> f64 {
        relative(&norms(&self.gradient), &self.scale) + self.doubt
    }

    /// Returns the largest relative gradient of the columns of each group, plus the estimated error of the gradient.
    pub(crate) fn optimalities(&self, groups: &[Range<usize>]) -> Vec<f64> {
        let norms = norms(&self.gradient);
        let of = |group: &Range<usize>| relative(&norms[group.clone()], &self.scale[group.clone()]) + self.doubt;
        groups.iter().map(of).collect()
    }

    /// Iterates until a stopping rule applies.
    pub(crate) fn run(
        &mut self,
        problem: &dyn Problem,
        preconditioner: &dyn Preconditioner,
        params: &CgParams,
        monitor: &dyn Monitor,
    ) -> Result<Stop, SolverError> {
        self.run_while(problem, preconditioner, params, None, monitor)
    }

    /// Iterates until a stopping rule applies, or until `progress` finds that the iterations converge too slowly. Slow
    /// convergence is also reported as [`Stop::IterationLimit`].
    pub(crate) fn run_while(
        &mut self,
        problem: &dyn Problem,
        preconditioner: &dyn Preconditioner,
        params: &CgParams,
        progress: Option<Progress>,
        monitor: &dyn Monitor,
    ) -> Result<Stop, SolverError> {
        let started = Instant::now();
        let before = std::mem::replace(&mut self.condition, 1.0);
        let stop = match problem.columns_together() {
            Some(width) if width < self.x.ncols() && preconditioner.takes_columns_alone() => {
                self.steps_of_groups(width, problem, preconditioner, params, progress, monitor)
            }
            _ => self.steps(problem, preconditioner, params, progress, monitor),
        };
        self.seconds += started.elapsed().as_secs_f64();
        let own = self.condition * preconditioner.condition().unwrap_or(f64::NAN);
        self.condition = if own.is_nan() { own } else { own.max(before) };
        stop
    }

    fn steps(
        &mut self,
        problem: &dyn Problem,
        preconditioner: &dyn Preconditioner,
        params: &CgParams,
        mut progress: Option<Progress>,
        monitor: &dyn Monitor,
    ) -> Result<Stop, SolverError> {
        let c = self.x.ncols();
        let ones = vec![1.0; c];
        let mut best = self.optimality();
        if best <= params.tolerance {
            return Ok(Stop::Converged);
        }
        let mut z = preconditioner.apply(&self.gradient)?;
        let mut rz = dots(&self.gradient, &z);
        let mut p = z;
        let (mut since_best, mut lanczos) = (0, Lanczos::new(c));
        for iteration in 1..=params.max_iterations {
            monitor.check()?;
            let q = problem.product(&p)?;
            let alpha: Vec<f64> = dots(&p, &q).iter().zip(&rz).map(|(pq, rz)| ratio(*rz, *pq)).collect();
            combine(&mut self.x, &ones, &alpha, &p);
            let minus: Vec<f64> = alpha.iter().map(|a| -a).collect();
            combine(&mut self.gradient, &ones, &minus, &q);
            self.iterations += 1;
            let optimality = self.optimality();
            monitor.step(1);
            monitor.note(Level::Status, format_args!("iteration {}, optimality {optimality:.1e}", self.iterations));
            if optimality <= params.tolerance {
                lanczos.push(&alpha, &vec![0.0; c]);
                self.condition = self.condition.max(lanczos.condition());
                return Ok(Stop::Converged);
            }
            since_best += 1;
            if optimality <= 0.5 * best {
                (best, since_best) = (optimality, 0);
                self.best_at = self.iterations;
            } else if since_best >= params.patience {
                self.condition = self.condition.max(lanczos.condition());
                return Ok(Stop::Stalled);
            }
            if progress.as_mut().is_some_and(|progress| !progress.may_go_on(iteration, optimality)) {
                break;
            }
            z = preconditioner.apply(&self.gradient)?;
            let before = std::mem::replace(&mut rz, dots(&self.gradient, &z));
            let beta: Vec<f64> = rz.iter().zip(&before).map(|(rz, before)| ratio(*rz, *before)).collect();
            lanczos.push(&alpha, &beta);
            combine(&mut p, &beta, &ones, &z);
        }
        self.condition = self.condition.max(lanczos.condition());
        Ok(Stop::IterationLimit)
    }

    /// Recomputes the gradient from the samples, and resumes the iteration if the recomputed gradient doesn't meet the
    /// tolerance. If the errors of products are small enough, the iteration's own gradient is used instead. Without
    /// samples, the gradient is recomputed by one more product, which is no more accurate than the previous products.
    /// Returns the reason why the iteration ended, and the residual (n, c) if there are samples.
    pub(crate) fn confirm(
        &mut self,
        mut stop: Stop,
        problem: &dyn Problem,
        preconditioner: &dyn Preconditioner,
        params: &CgParams,
        monitor: &dyn Monitor,
    ) -> Result<(Stop, Option<Array2<f64>>), SolverError> {
        if stop == Stop::Converged
            && let Some(residual) = self.confirm_carried(problem, params.tolerance)?
        {
            return Ok((stop, residual));
        }
        let mut before = f64::INFINITY;
        loop {
            let (gradient, residual) = problem.gradient(&self.x)?;
            self.gradient = gradient;
            let optimality = self.optimality();
            if stop != Stop::Converged || optimality <= 1.5 * params.tolerance || optimality > 0.5 * before {
                return Ok((stop, residual));
            }
            before = optimality;
            let max_iterations = params.max_iterations.saturating_sub(self.iterations);
            stop = self.run(problem, preconditioner, &CgParams { max_iterations, ..*params }, monitor)?;
        }
    }

    /// Accepts the iteration's own gradient if it is accurate enough, and returns the residual (n, c) if there are
    /// samples. Returns `None` if the gradient must be recomputed, at twice the cost of the residual.
    ///
    /// Products with an error of e relative to the norm of N cause an error of up to `e |N| |x|` in the gradient
    /// `b - N x`, with the right-hand side `b = A^T W f`. Rounding adds an error of about eps times `|N| |x|` in each
    /// iteration. Divided by `|b|`, these errors are errors of the optimality, and must be small compared with the
    /// tolerance. If there are samples, they serve to verify the accuracy of products in the direction of x: the
    /// residual r and the gradient g satisfy `(A x)^T W r = x^T g`.
    fn confirm_carried(
        &mut self,
        problem: &dyn Problem,
        tolerance: f64,
    ) -> Result<Option<Option<Array2<f64>>>, SolverError> {
        let Some(ProductError { relative: error, norm }) = problem.product_error() else { return Ok(None) };
        let error = error + f64::EPSILON * self.iterations as f64;
        let doubt = error * norm * relative(&norms(&self.x), &self.scale);
        if doubt > ERROR_SHARE * tolerance {
            return Ok(None);
        }
        let Some(residual) = problem.residual(&self.x)? else {
            self.doubt = doubt;
            return Ok(Some(None));
        };
        let lengths = norms(&self.x).into_iter().zip(&self.scale).map(|(x, scale)| ERROR_SHARE * tolerance * x * scale);
        let mut slopes = residual.slopes.iter().zip(dots(&self.x, &self.gradient)).zip(lengths);
        let agree = slopes.all(|((slope, carried), most)| (slope - carried).abs() <= most);
        self.doubt = if agree { doubt } else { 0.0 };
        Ok(agree.then_some(Some(residual.values)))
    }
}

/// Returns the largest ratio of a column's norm (`norms`) to its scale (`scale`). The ratio counts as 0 for columns of
/// scale 0, because their solution is zero.
pub(crate) fn relative(norms: &[f64], scale: &[f64]) -> f64 {
    norms.iter().zip(scale).map(|(norm, scale)| if *scale > 0.0 { norm / scale } else { 0.0 }).fold(0.0, f64::max)
}

/// Returns the quotient, or zero if the denominator isn't positive. The denominator is zero for a column that is
/// already solved, because its gradient and its search direction are zero.
fn ratio(numerator: f64, denominator: f64) -> f64 {
    if denominator > 0.0 { numerator / denominator } else { 0.0 }
}

/// The tridiagonal matrix that is implicit in conjugate gradients. Its eigenvalues approach the eigenvalues of the
/// preconditioned matrix from inside the spectrum. The extreme eigenvalues converge first.
struct Lanczos {
    steps: Vec<(Vec<f64>, Vec<f64>)>,
    columns: usize,
}

impl Lanczos {
    fn new(columns: usize) -> Self {
        Self { steps: Vec::new(), columns }
    }

    fn push(&mut self, alpha: &[f64], beta: &[f64]) {
        self.steps.push((alpha.to_vec(), beta.to_vec()));
    }

    fn condition(&self) -> f64 {
        (0..self.columns).map(|c| self.condition_of(c)).fold(1.0, f64::max)
    }

    fn condition_of(&self, c: usize) -> f64 {
        let (mut diagonal, mut squares) = (Vec::new(), Vec::new());
        let mut before: Option<(f64, f64)> = None;
        for (alpha, beta) in &self.steps {
            let (alpha, beta) = (alpha[c], beta[c]);
            if alpha <= 0.0 || !alpha.is_finite() {
                break;
            }
            diagonal.push(1.0 / alpha + before.map_or(0.0, |(alpha, beta)| beta / alpha));
            squares.push(beta / (alpha * alpha));
            before = Some((alpha, beta));
        }
        let Some(largest) = diagonal.iter().copied().reduce(f64::max) else { return 1.0 };
        // Bisect below Gershgorin's bound on the eigenvalues. Sturm's sequence counts the eigenvalues below a value.
        let bound = 2.0 * largest + 2.0 * squares.iter().copied().fold(0.0, f64::max).sqrt();
        let below = |value: f64| {
            let mut count = 0;
            let mut pivot = 1.0;
            for (i, d) in diagonal.iter().enumerate() {
                pivot = d - value - if i > 0 { squares[i - 1] / pivot } else { 0.0 };
                if pivot == 0.0 {
                    pivot = f64::MIN_POSITIVE;
                }
                if pivot < 0.0 {
                    count += 1;
                }
            }
            count
        };
        let find = |rank: usize| {
            // Bisect on a logarithmic scale, because the smallest eigenvalue may be 1e-16 of the largest.
            let (mut low, mut high) = (bound * 1e-20, bound);
            for _ in 0..80 {
                let middle = (low * high).sqrt();
                if below(middle) > rank { high = middle } else { low = middle }
            }
            high
        };
        find(diagonal.len() - 1) / find(0)
    }
}
