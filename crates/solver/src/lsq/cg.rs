//! Preconditioned conjugate gradients on the normal equations, all columns in step.
//!
//! Problem: `min |W^(1/2) (A x - f)|^2 + x^T P x` for each column f of the targets; N = A^T W A + P. From x = 0:
//!
//! ```text
//! r = A^T W f,  z = M r,  p = z
//! repeat   q = N p,  alpha = r^T z / p^T q,  x += alpha p,  r -= alpha q
//!          z = M r,  beta = r^T z / (r^T z)_before,  p = z + beta p
//! ```
//!
//! with M the preconditioner. In exact arithmetic the same iterates as LSQR's with the same preconditioner, at less
//! storage: four (K, c) arrays, no (n, c) one. The normal equations square the condition, which bounds the optimality
//! that can be reached by rounding; so r is formed anew from the samples now and then, and the iteration is started
//! again from there while that gains something. From zero it tends to the minimum-norm solution where there are many.
//!
//! M. R. Hestenes and E. Stiefel, "Methods of conjugate gradients for solving linear systems", J. Res. NBS 49 (1952);
//! A. Bjorck, "Numerical methods for least squares problems" (1996), section 7.4.

use std::sync::atomic::{AtomicBool, Ordering};

use ndarray::Array2;

use crate::SolverError;
use crate::lsq::columns::{add_scaled_rows, combine, dots, norms};
use crate::lsq::preconditioner::{Diagonal, Preconditioner};
use crate::operator::Operator;

/// The normal equations of a weighted and penalised least squares.
#[derive(Clone, Copy)]
pub struct NormalEquations<'a> {
    /// A.
    pub operator: &'a dyn Operator,
    /// w, (n); all one where there are none.
    pub weights: Option<&'a [f64]>,
    /// Diagonal of P, (K); zero where there is none.
    pub penalty: Option<&'a [f64]>,
}

impl NormalEquations<'_> {
    /// `N x`.
    pub(crate) fn apply(&self, x: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        let mut y = self.operator.normal(x.view(), self.weights)?;
        if let Some(penalty) = self.penalty {
            add_scaled_rows(&mut y, penalty, x);
        }
        Ok(y)
    }

    /// The inverse of the diagonal that N would have on an even sampling.
    pub(crate) fn diagonal(&self) -> Diagonal {
        let weight = self.weights.map_or(self.operator.rows() as f64, |weights| weights.iter().sum());
        Diagonal::new(self.operator.max_degree(), weight, self.penalty)
    }

    /// `A^T W s`.
    pub(crate) fn adjoint(&self, samples: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        let Some(weights) = self.weights else { return self.operator.apply_adjoint(samples.view()) };
        let mut weighted = samples.clone();
        super::columns::scale_rows(&mut weighted, weights);
        self.operator.apply_adjoint(weighted.view())
    }

    /// `A^T W (f - A x) - P x` and the residual `f - A x`.
    pub(crate) fn gradient(
        &self,
        targets: &Array2<f64>,
        x: &Array2<f64>,
    ) -> Result<(Array2<f64>, Array2<f64>), SolverError> {
        let mut residual = self.operator.apply(x.view())?;
        ndarray::Zip::from(&mut residual).and(targets).par_for_each(|residual, target| *residual = target - *residual);
        let mut gradient = self.adjoint(&residual)?;
        if let Some(penalty) = self.penalty {
            let minus: Vec<f64> = penalty.iter().map(|p| -p).collect();
            add_scaled_rows(&mut gradient, &minus, x);
        }
        Ok((gradient, residual))
    }
}

/// When to stop.
#[derive(Debug, Clone, Copy)]
pub struct CgParams {
    /// Optimality, `|A^T W r - P x| / |A^T W f|`, of every column.
    pub tolerance: f64,
    /// Most iterations.
    pub max_iterations: usize,
    /// Iterations without the optimality halving after which it is given up.
    pub patience: usize,
}

/// How an iteration ended.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stop {
    /// The tolerance was met.
    Converged,
    /// The optimality stopped improving.
    Stalled,
    /// The iterations were used up.
    IterationLimit,
}

/// State of an iteration that can go on with another preconditioner.
pub(crate) struct Cg {
    /// Solution, (K, c).
    pub(crate) x: Array2<f64>,
    /// `A^T W (f - A x) - P x`, as the iteration carries it.
    pub(crate) gradient: Array2<f64>,
    /// Norms of `A^T W f`.
    pub(crate) scale: Vec<f64>,
    pub(crate) iterations: usize,
    /// Of N preconditioned, from the iteration's own coefficients; of the column with the largest.
    pub(crate) condition: f64,
}

impl Cg {
    pub(crate) fn new(equations: &NormalEquations<'_>, targets: &Array2<f64>) -> Result<Self, SolverError> {
        let gradient = equations.adjoint(targets)?;
        let scale = norms(&gradient);
        Ok(Self { x: Array2::zeros(gradient.dim()), gradient, scale, iterations: 0, condition: 1.0 })
    }

    /// The largest relative gradient of all columns.
    pub(crate) fn optimality(&self) -> f64 {
        relative(&norms(&self.gradient), &self.scale)
    }

    /// Iterates until a stopping rule applies.
    pub(crate) fn run(
        &mut self,
        equations: &NormalEquations<'_>,
        preconditioner: &dyn Preconditioner,
        params: &CgParams,
        cancel: &AtomicBool,
        event: &dyn Fn(usize, f64),
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
        for _ in 0..params.max_iterations {
            if cancel.load(Ordering::Relaxed) {
                return Err(SolverError::Interrupted);
            }
            let q = equations.apply(&p)?;
            let alpha: Vec<f64> = dots(&p, &q).iter().zip(&rz).map(|(pq, rz)| ratio(*rz, *pq)).collect();
            combine(&mut self.x, &ones, &alpha, &p);
            let minus: Vec<f64> = alpha.iter().map(|a| -a).collect();
            combine(&mut self.gradient, &ones, &minus, &q);
            self.iterations += 1;
            let optimality = self.optimality();
            event(self.iterations, optimality);
            if optimality <= params.tolerance {
                lanczos.push(&alpha, &vec![0.0; c]);
                self.condition = self.condition.max(lanczos.condition());
                return Ok(Stop::Converged);
            }
            since_best += 1;
            if optimality <= 0.5 * best {
                (best, since_best) = (optimality, 0);
            } else if since_best >= params.patience {
                self.condition = self.condition.max(lanczos.condition());
                return Ok(Stop::Stalled);
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
}

/// The largest of the quotients; a column that is zero is solved.
pub(crate) fn relative(norms: &[f64], scale: &[f64]) -> f64 {
    norms.iter().zip(scale).map(|(norm, scale)| if *scale > 0.0 { norm / scale } else { 0.0 }).fold(0.0, f64::max)
}

/// A column that is solved has no direction left to go.
fn ratio(numerator: f64, denominator: f64) -> f64 {
    if denominator > 0.0 { numerator / denominator } else { 0.0 }
}

/// The tridiagonal matrix that conjugate gradients know implicitly: its eigenvalues approach those of the preconditioned
/// matrix from inside, the extreme ones first.
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
        // Gershgorin's bound, then bisection with Sturm's count of the eigenvalues below.
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
            // On a logarithmic scale: the smallest may be 1e-16 of the largest.
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
