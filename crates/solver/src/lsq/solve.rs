//! The exact least squares of batch after batch of targets on one sampling.
//!
//! What is done, unless the parameters ask for one way:
//!
//! 1. Conjugate gradients by fast operators. On an even sampling N is nearly a multiple of the identity and a handful of
//!    iterations is all there is to it.
//! 2. Where they are slow, the Cholesky factor of N, from the Gram matrix, and refinement: `x += N^-1 g` with the gradient
//!    `g = A^T W (f - A x) - P x` formed by the operator, until the optimality `|g| / |A^T W f|` is met or stops improving.
//!    A factor that is at hand, say in a store, is used from the start where it is faster.
//! 3. Where N is numerically singular it is shifted: `x += (N + mu)^-1 g`, iterated Tikhonov regularisation. From x = 0
//!    that tends to the minimum-norm solution; what the targets determine worse than `mu` allows for stays small instead
//!    of growing to 1e11. A. Bjorck, "Numerical methods for least squares problems" (1996), section 4.1.3.
//!
//! The report says which of it was done, and what it came to.

use std::ops::Range;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use ndarray::{Array2, s};
use serde::Serialize;
use spharm_harmonics::index::{basis_size, first_column};
use spharm_harmonics::{Coefficients, index};
use spharm_store::StoreError;

use crate::cholesky::{
    CholeskyFactor, Factor, FactorParams, GramSource, Penalised, factorise, plan_factor, smoothness_penalty,
};
use crate::lsq::cg::{Cg, CgParams, NormalEquations, Stop, relative};
use crate::lsq::columns::norms;
use crate::lsq::preconditioner::{ByFactor, Density, LowDegrees, Preconditioner};
use crate::operator::Operator;
use crate::report::Residual;
use crate::{SolverError, dense};

/// Which way to go.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Way {
    /// Iterations first, a factor where they are slow.
    Auto,
    /// Iterations without a preconditioner.
    Plain,
    /// Iterations preconditioned with the sampling's density; needs [`LsqParams::areas`].
    Density,
    /// Iterations preconditioned with the factor of the Gram matrix of the degrees up to this one.
    LowDegrees(usize),
    /// The whole factor, and refinement.
    Factor,
}

/// How to solve.
#[derive(Debug, Clone)]
pub struct LsqParams {
    /// Weight of each row, (n); all one where there are none.
    pub weights: Option<Vec<f64>>,
    /// Smoothness penalty, lambda: adds `lambda sum (l (l + 1))^2 a^2` to the squared residual.
    pub smoothness: f64,
    /// Which way to go.
    pub way: Way,
    /// Each direction's share of the sphere, in steradians, for [`Way::Density`].
    pub areas: Option<Vec<f64>>,
    /// Optimality to reach: `|A^T W r - P x| / |A^T W f|`, of every column.
    pub tolerance: f64,
    /// Most iterations.
    pub max_iterations: usize,
    /// Most bytes of memory to take for a factor, and what the caller holds of it.
    pub memory: usize,
    /// Bytes of memory that are taken already.
    pub held: usize,
    /// Threads for factors.
    pub threads: usize,
}

impl Default for LsqParams {
    fn default() -> Self {
        Self {
            weights: None,
            smoothness: 0.0,
            way: Way::Auto,
            areas: None,
            tolerance: 1e-10,
            max_iterations: 3000,
            memory: 2 << 30,
            held: 0,
            threads: rayon::current_num_threads(),
        }
    }
}

/// Iterations after which a factor is made, where one can be: on samplings that need more, many more are needed.
const BEFORE_FACTOR: usize = 60;
/// Iterations without the optimality halving after which it is given up.
const PATIENCE: usize = 250;
/// The same with a factor as the preconditioner, where each iteration is worth many.
const FACTOR_PATIENCE: usize = 30;
/// Most refinements with a factor.
const REFINEMENTS: usize = 40;
/// Below this reciprocal condition number a matrix counts as singular: nothing is left of a solve's digits.
const SINGULAR: f64 = 1e-14;
/// Above it, few iterations are needed, and for few columns they are faster than reading a factor.
const WELL_CONDITIONED: f64 = 1e-2;
/// Most columns for which that holds.
const FEW: usize = 12;

/// The coefficients, and how they were come by.
#[derive(Debug, Clone)]
pub struct LsqFit {
    /// Canonical coefficients, (K, c).
    pub coefficients: Coefficients,
    /// Targets minus synthesis, (n, c).
    pub residual: Array2<f64>,
    /// Report.
    pub report: LsqReport,
}

/// What a fit tells about itself.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct LsqReport {
    /// Highest degree, L.
    pub max_degree: usize,
    /// Rows, n.
    pub rows: usize,
    /// Columns of the targets, c.
    pub channels: usize,
    /// What the last steps were made with: `none`, `density`, `low-degrees`, `factor`, `stored-factor`.
    pub preconditioner: &'static str,
    /// Iterations of conjugate gradients.
    pub iterations: usize,
    /// Refinements with a factor.
    pub refinements: usize,
    /// The largest relative gradient of all columns, formed from the samples.
    pub optimality: f64,
    /// How it ended.
    pub stop: Stop,
    /// Estimated condition number of the basis matrix, with its weights and penalty; infinite (null in JSON) where it is
    /// numerically singular.
    pub condition: f64,
    /// What was added to the diagonal of a singular matrix, in relation to its largest entry; zero otherwise.
    pub shift: f64,
    /// The column and degree at which a singular matrix broke.
    pub breaks_at: Option<[usize; 2]>,
    /// The largest norm of a column of the coefficients.
    pub norm: f64,
    /// Smoothness penalty, lambda.
    pub smoothness: f64,
    /// What else is worth knowing.
    pub notes: Vec<String>,
    /// For each target: mean and maximum over the rows of the squared norm of its residual, in its own unit squared.
    pub residuals: Vec<Residual>,
    /// Wall time: making factors, all of it.
    pub seconds: LsqSeconds,
}

/// Seconds by kind of work.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct LsqSeconds {
    /// Gram matrix and its factorisation.
    pub factor: f64,
    /// All of it.
    pub total: f64,
}

/// What a solve tells while it runs.
#[derive(Debug, Clone, Copy)]
#[non_exhaustive]
pub enum LsqEvent {
    /// An iteration or a refinement is done: how many, and the optimality.
    Step(usize, f64),
    /// A factor is going to be made: its flops.
    Factor(f64),
    /// Flops of it done since the last event.
    Factored(f64),
}

/// Makes the source of the Gram matrix `A^T W A`, when it comes to that.
pub type MakeGram<'a> = dyn Fn() -> Result<Box<dyn GramSource>, SolverError> + Sync + 'a;

/// Solves batch after batch on one sampling, and keeps the factor from one to the next.
pub struct LsqSolver<'a> {
    operator: &'a dyn Operator,
    make_gram: Option<&'a MakeGram<'a>>,
    stored: Option<&'a dyn CholeskyFactor>,
    params: LsqParams,
    penalty: Option<Vec<f64>>,
    made: Option<Made>,
    low: Option<LowDegrees>,
    notes: Vec<String>,
    factor_seconds: f64,
}

struct Made {
    factor: Factor,
    shift: f64,
    breaks_at: Option<[usize; 2]>,
}

impl<'a> LsqSolver<'a> {
    /// For an operator; `make_gram`, where there is one, lets it make factors. Its Gram matrices have to have the weights
    /// of `params`, but not the penalty.
    ///
    /// # Errors
    ///
    /// What is wrong with the parameters.
    pub fn new(
        operator: &'a dyn Operator,
        make_gram: Option<&'a MakeGram<'a>>,
        params: LsqParams,
    ) -> Result<Self, SolverError> {
        let expected = operator.rows();
        if let Some(weights) = &params.weights {
            crate::fit::check_weights(weights, expected)?;
        }
        if let Some(areas) = &params.areas
            && areas.len() != expected
        {
            return Err(SolverError::Rows { what: "the list of areas", expected, found: areas.len() });
        }
        if !(params.smoothness >= 0.0 && params.smoothness.is_finite()) {
            return Err(SolverError::Smoothness { found: params.smoothness });
        }
        let penalty = (params.smoothness > 0.0).then(|| smoothness_penalty(operator.max_degree(), params.smoothness));
        Ok(Self {
            operator,
            make_gram,
            stored: None,
            params,
            penalty,
            made: None,
            low: None,
            notes: Vec::new(),
            factor_seconds: 0.0,
        })
    }

    /// Uses a factor that is at hand: of the operator's directions and degree, and of the weights and penalty of the
    /// parameters.
    #[must_use]
    pub fn with_factor(mut self, factor: &'a dyn CholeskyFactor) -> Self {
        self.stored = Some(factor);
        self
    }

    fn rows_with_weight(&self) -> usize {
        let count = |weights: &Vec<f64>| weights.iter().filter(|weight| **weight > 0.0).count();
        self.params.weights.as_ref().map_or(self.operator.rows(), count)
    }

    fn equations(&self) -> NormalEquations<'_> {
        NormalEquations {
            operator: self.operator,
            weights: self.params.weights.as_deref(),
            penalty: self.penalty.as_deref(),
        }
    }

    /// Solves for targets, (n, c), whose columns belong together as `groups` says.
    ///
    /// # Errors
    ///
    /// [`SolverError::Rows`], [`SolverError::NotFinite`], [`SolverError::Interrupted`] when `cancel` was set; those of
    /// operator, Gram matrix and stored factor. Not converging is none.
    pub fn fit(
        &mut self,
        targets: &Array2<f64>,
        groups: &[Range<usize>],
        cancel: &AtomicBool,
        event: &(dyn Fn(LsqEvent) + Sync),
    ) -> Result<LsqFit, SolverError> {
        let started = Instant::now();
        self.factor_seconds = 0.0;
        self.notes.clear();
        let expected = self.operator.rows();
        if targets.nrows() != expected {
            return Err(SolverError::Rows { what: "the target", expected, found: targets.nrows() });
        }
        if !targets.iter().all(|value| value.is_finite())
            && let Some(((row, column), _)) = targets.indexed_iter().find(|(_, value)| !value.is_finite())
        {
            return Err(SolverError::NotFinite { row, column });
        }
        let mut cg = Cg::new(&self.equations(), targets)?;
        let mut outcome = self.iterate(&mut cg, cancel, event)?;
        let residual = if outcome.stop == Stop::Converged && !outcome.refine {
            self.confirm(&mut cg, targets, &mut outcome, cancel, event)?
        } else if outcome.refine {
            self.refine(&mut cg, targets, &mut outcome, cancel, event)?
        } else {
            let (gradient, residual) = self.equations().gradient(targets, &cg.x)?;
            cg.gradient = gradient;
            residual
        };
        let optimality = cg.optimality();
        if outcome.stop == Stop::Converged && optimality > 2.0 * self.params.tolerance {
            outcome.stop = Stop::Stalled;
        }
        let condition = self.condition(&cg, &outcome);
        let norm = norms(&cg.x).into_iter().fold(0.0, f64::max);
        let shift = self.made.as_ref().filter(|_| outcome.refine).map_or(0.0, |made| made.shift);
        let (seen, columns) = (self.rows_with_weight(), cg.x.nrows());
        if seen < columns && self.penalty.is_none() && shift == 0.0 {
            self.notes.push(format!(
                "{seen} vertices don't determine {columns} coefficients; took the solution of least norm, {norm:.3e}"
            ));
        }
        let report = LsqReport {
            max_degree: self.operator.max_degree(),
            rows: expected,
            channels: targets.ncols(),
            preconditioner: outcome.preconditioner,
            iterations: cg.iterations,
            refinements: outcome.refinements,
            optimality,
            stop: outcome.stop,
            condition,
            shift,
            breaks_at: self.made.as_ref().filter(|_| outcome.refine).and_then(|made| made.breaks_at),
            norm,
            smoothness: self.params.smoothness,
            notes: self.notes.clone(),
            residuals: groups.iter().map(|group| Residual::of(residual.slice(s![.., group.clone()]))).collect(),
            seconds: LsqSeconds { factor: self.factor_seconds, total: started.elapsed().as_secs_f64() },
        };
        Ok(LsqFit { coefficients: Coefficients::new(cg.x)?, residual, report })
    }

    /// Goes the chosen way as far as conjugate gradients go.
    fn iterate(
        &mut self,
        cg: &mut Cg,
        cancel: &AtomicBool,
        event: &(dyn Fn(LsqEvent) + Sync),
    ) -> Result<Outcome, SolverError> {
        let params = CgParams {
            tolerance: self.params.tolerance,
            max_iterations: self.params.max_iterations,
            patience: PATIENCE,
        };
        let at_hand = self.stored.is_some() || self.made.is_some();
        let well = self.stored.is_some_and(|factor| factor.condition().reciprocal > WELL_CONDITIONED);
        let by_factor = match self.params.way {
            Way::Factor => true,
            Way::Auto => at_hand && !(well && cg.x.ncols() <= FEW),
            _ => false,
        };
        if by_factor {
            self.prepare(cancel, event)?;
            return Ok(self.to_refine());
        }
        if let Way::LowDegrees(degree) = self.params.way
            && self.low.is_none()
        {
            self.low = Some(self.make_low(degree)?);
        }
        let diagonal = self.equations().diagonal();
        let density = match (self.params.way, &self.params.areas) {
            (Way::Density, Some(areas)) => Some(Density::new(self.operator, areas, self.params.weights.as_deref())),
            _ => None,
        };
        let preconditioner: &dyn Preconditioner = match (&density, &self.low) {
            (Some(density), _) => density,
            (None, Some(low)) => low,
            (None, None) => &diagonal,
        };
        let columns = basis_size(self.operator.max_degree());
        let factor_helps =
            self.params.way == Way::Auto && (self.make_gram.is_some() || at_hand) && columns <= self.operator.rows();
        let first = if factor_helps { BEFORE_FACTOR.min(params.max_iterations) } else { params.max_iterations };
        let tell = |step, optimality| event(LsqEvent::Step(step, optimality));
        let equations = self.equations();
        let mut stop =
            cg.run(&equations, preconditioner, &CgParams { max_iterations: first, ..params }, cancel, &tell)?;
        let name = preconditioner.name();
        // A limit below that is a limit on all the work: no factor then.
        if stop == Stop::IterationLimit && factor_helps && first < params.max_iterations {
            if self.prepare(cancel, event)? {
                return Ok(self.to_refine());
            }
            let rest = CgParams { max_iterations: params.max_iterations - first, ..params };
            stop = cg.run(&self.equations(), &diagonal, &rest, cancel, &tell)?;
        }
        Ok(Outcome { stop, preconditioner: name, refine: false, refinements: 0 })
    }

    fn to_refine(&self) -> Outcome {
        let preconditioner = if self.stored.is_some() { "stored-factor" } else { "factor" };
        Outcome { stop: Stop::IterationLimit, preconditioner, refine: true, refinements: 0 }
    }

    /// Sees to it that there is a factor; false where memory doesn't allow for one.
    fn prepare(&mut self, cancel: &AtomicBool, event: &(dyn Fn(LsqEvent) + Sync)) -> Result<bool, SolverError> {
        if self.stored.is_some() || self.made.is_some() {
            return Ok(true);
        }
        let Some(make_gram) = self.make_gram else { return Err(SolverError::NoGram) };
        let started = Instant::now();
        let params = FactorParams {
            memory: self.params.memory,
            held: self.params.held,
            threads: self.params.threads,
            ..FactorParams::default()
        };
        let size = basis_size(self.operator.max_degree());
        if let Err(error) = plan_factor(size, &params, false) {
            if self.params.way == Way::Factor {
                return Err(error);
            }
            self.notes.push(format!("no factor was made: {error}"));
            return Ok(false);
        }
        let gram = make_gram()?;
        let tell = |factor_event: crate::cholesky::FactorEvent<'_>| match factor_event {
            crate::cholesky::FactorEvent::Planned(_, flops) => event(LsqEvent::Factor(flops)),
            crate::cholesky::FactorEvent::Progress(flops) => event(LsqEvent::Factored(flops)),
            _ => {}
        };
        let zero = vec![0.0; size];
        let penalty = self.penalty.as_deref().unwrap_or(&zero);
        let factor = |shift: f64| {
            let penalised = Penalised::new(&*gram, penalty.iter().map(|p| p + shift).collect());
            factorise(&penalised, &params, cancel, &tell).map_err(|error| match error {
                SolverError::Store(StoreError::Interrupted(_)) => SolverError::Interrupted,
                error => error,
            })
        };
        let mut breaks_at = None;
        let made = match factor(0.0) {
            Ok(made) if made.condition().reciprocal > SINGULAR => Made { factor: made, shift: 0.0, breaks_at },
            Err(error) if !matches!(error, SolverError::NotPositiveDefinite { .. }) => return Err(error),
            other => {
                if let Err(SolverError::NotPositiveDefinite { column, degree }) = other {
                    breaks_at = Some([column, degree]);
                }
                // As small as rounding errors of the matrix allow.
                let largest = largest_diagonal(&*gram, penalty)?;
                let mut shift = f64::EPSILON * size as f64;
                loop {
                    match factor(shift * largest) {
                        Ok(made) => break Made { factor: made, shift, breaks_at },
                        Err(SolverError::NotPositiveDefinite { .. }) if shift < 1e-3 => shift *= 10.0,
                        Err(error) => return Err(error),
                    }
                }
            }
        };
        self.made = Some(made);
        self.factor_seconds += started.elapsed().as_secs_f64();
        Ok(true)
    }

    /// `x += M g` until it is good or gets no better; returns the residual.
    fn refine(
        &self,
        cg: &mut Cg,
        targets: &Array2<f64>,
        outcome: &mut Outcome,
        cancel: &AtomicBool,
        event: &(dyn Fn(LsqEvent) + Sync),
    ) -> Result<Array2<f64>, SolverError> {
        let factor: &dyn CholeskyFactor = match (self.stored, &self.made) {
            (Some(factor), _) => factor,
            (None, Some(made)) => &made.factor,
            (None, None) => return Err(SolverError::NoGram),
        };
        let equations = self.equations();
        let shifted = self.made.as_ref().is_some_and(|made| made.shift > 0.0);
        if shifted && cg.iterations > 0 {
            // From zero, for the sake of the minimum norm.
            *cg = Cg::new(&equations, targets)?;
        }
        let mut residual = None;
        let mut optimality = cg.optimality();
        while outcome.refinements < REFINEMENTS {
            if cancel.load(Ordering::Relaxed) {
                return Err(SolverError::Interrupted);
            }
            let mut step = cg.gradient.clone();
            factor.solve(&mut step)?;
            let x = &cg.x + &step;
            let (gradient, new_residual) = equations.gradient(targets, &x)?;
            let improved = relative(&norms(&gradient), &cg.scale);
            // A step that makes it worse isn't taken.
            if improved >= optimality && improved > self.params.tolerance {
                outcome.stop = Stop::Stalled;
                break;
            }
            outcome.refinements += 1;
            (cg.x, cg.gradient) = (x, gradient);
            residual = Some(new_residual);
            event(LsqEvent::Step(outcome.refinements, improved));
            if improved <= self.params.tolerance {
                outcome.stop = Stop::Converged;
                break;
            }
            if improved > 0.5 * optimality {
                outcome.stop = Stop::Stalled;
                break;
            }
            optimality = improved;
        }
        if residual.is_none() {
            let (gradient, formed) = equations.gradient(targets, &cg.x)?;
            (cg.gradient, residual) = (gradient, Some(formed));
        }
        // A factor with fewer digits than the condition takes is a good preconditioner yet.
        let rest = self.params.max_iterations.saturating_sub(cg.iterations);
        if outcome.stop != Stop::Converged && !shifted && cg.optimality() > ROUNDING && rest > 0 {
            let before = (cg.x.clone(), cg.gradient.clone());
            let optimality = cg.optimality();
            let params = CgParams { tolerance: self.params.tolerance, max_iterations: rest, patience: FACTOR_PATIENCE };
            let tell = |step, optimality| event(LsqEvent::Step(step, optimality));
            outcome.stop = cg.run(&equations, &ByFactor(factor), &params, cancel, &tell)?;
            let (gradient, formed) = equations.gradient(targets, &cg.x)?;
            cg.gradient = gradient;
            if cg.optimality() < optimality {
                residual = Some(formed);
            } else {
                (cg.x, cg.gradient) = before;
                outcome.stop = Stop::Stalled;
            }
        }
        // As far as rounding goes is where it was to go: the factor is exact.
        if outcome.stop == Stop::Stalled && cg.optimality() <= ROUNDING {
            outcome.stop = Stop::Converged;
        }
        match residual {
            Some(residual) => Ok(residual),
            None => Ok(equations.gradient(targets, &cg.x)?.1),
        }
    }

    /// Forms the gradient from the samples, and goes on from there where it isn't what the iteration believes.
    fn confirm(
        &self,
        cg: &mut Cg,
        targets: &Array2<f64>,
        outcome: &mut Outcome,
        cancel: &AtomicBool,
        event: &(dyn Fn(LsqEvent) + Sync),
    ) -> Result<Array2<f64>, SolverError> {
        let equations = self.equations();
        let diagonal = equations.diagonal();
        let mut before = f64::INFINITY;
        loop {
            let (gradient, residual) = equations.gradient(targets, &cg.x)?;
            cg.gradient = gradient;
            let optimality = cg.optimality();
            if optimality <= 1.5 * self.params.tolerance || optimality > 0.5 * before {
                return Ok(residual);
            }
            before = optimality;
            let params = CgParams {
                tolerance: self.params.tolerance,
                max_iterations: self.params.max_iterations.saturating_sub(cg.iterations),
                patience: PATIENCE,
            };
            let tell = |step, optimality| event(LsqEvent::Step(step, optimality));
            outcome.stop = cg.run(&equations, &diagonal, &params, cancel, &tell)?;
            if outcome.stop != Stop::Converged {
                return Ok(equations.gradient(targets, &cg.x)?.1);
            }
        }
    }

    fn condition(&self, cg: &Cg, outcome: &Outcome) -> f64 {
        let of = |reciprocal: f64| if reciprocal > 0.0 { (1.0 / reciprocal).sqrt() } else { f64::INFINITY };
        match (self.stored, &self.made) {
            (Some(factor), _) => of(factor.condition().reciprocal),
            (None, Some(made)) if made.shift > 0.0 => f64::INFINITY,
            (None, Some(made)) => of(made.factor.condition().reciprocal),
            // Preconditioned by more than a number it isn't the matrix's own.
            (None, None) if outcome.preconditioner == "none" && self.penalty.is_none() => cg.condition.sqrt(),
            (None, None) => f64::NAN,
        }
    }

    fn make_low(&self, degree: usize) -> Result<LowDegrees, SolverError> {
        let degree = degree.min(self.operator.max_degree());
        let make_gram = self.make_gram.ok_or(SolverError::NoGram)?;
        let size = basis_size(degree);
        let mut gram = vec![0.0; size * size];
        make_gram()?.tile(0..size, 0..size, &mut gram, size)?;
        if let Some(penalty) = &self.penalty {
            (0..size).for_each(|j| gram[j * size + j] += penalty[j]);
        }
        dense::set_blas_threads(self.params.threads);
        let reciprocal = dense::cholesky(&mut gram, size);
        dense::set_blas_threads(1);
        if reciprocal.is_none_or(|reciprocal| reciprocal < SINGULAR) {
            return Err(SolverError::LowDegrees { degree });
        }
        Ok(LowDegrees::new(gram, first_column(degree + 1), self.equations().diagonal()))
    }

    /// Standard errors of the coefficients, (K, c): `sigma sqrt(diag N^-1)`, with `sigma^2` the residual's weighted sum of
    /// squares over the rows with weight less the trace of the hat matrix `A N^-1 A^T W`, which is K without a penalty.
    /// `diag N^-1` needs the whole factor.
    ///
    /// # Errors
    ///
    /// [`SolverError::NoGram`], [`SolverError::Underdetermined`], and what keeps a factor from being made.
    pub fn standard_errors(
        &mut self,
        residual: &Array2<f64>,
        cancel: &AtomicBool,
        event: &(dyn Fn(LsqEvent) + Sync),
    ) -> Result<Array2<f64>, SolverError> {
        let columns = basis_size(self.operator.max_degree());
        let rows = self.rows_with_weight();
        if rows <= columns && self.penalty.is_none() {
            return Err(SolverError::Underdetermined { rows, columns });
        }
        let way = std::mem::replace(&mut self.params.way, Way::Factor);
        let prepared = self.prepare(cancel, event);
        self.params.way = way;
        prepared?;
        let diagonal = match (self.stored, &self.made) {
            (Some(factor), _) => factor.inverse_diagonal()?,
            (None, Some(made)) if made.shift > 0.0 => return Err(SolverError::Underdetermined { rows, columns }),
            (None, Some(made)) => made.factor.inverse_diagonal()?,
            (None, None) => return Err(SolverError::NoGram),
        };
        // tr H = K - tr(P N^-1), and P is diagonal.
        let held = self.penalty.iter().flatten().zip(&diagonal).map(|(p, d)| p * d).sum::<f64>();
        let degrees_of_freedom = rows as f64 - (columns as f64 - held);
        if degrees_of_freedom <= 0.0 {
            return Err(SolverError::Underdetermined { rows, columns });
        }
        let weight = |i: usize| self.params.weights.as_ref().map_or(1.0, |w| w[i]);
        let sigma: Vec<f64> = residual
            .columns()
            .into_iter()
            .map(|r| (r.iter().enumerate().map(|(i, r)| weight(i) * r * r).sum::<f64>() / degrees_of_freedom).sqrt())
            .collect();
        Ok(Array2::from_shape_fn((columns, residual.ncols()), |(k, c)| sigma[c] * diagonal[k].max(0.0).sqrt()))
    }
}

/// Optimality that rounding errors of targets and transforms leave.
const ROUNDING: f64 = 1e-9;

struct Outcome {
    stop: Stop,
    preconditioner: &'static str,
    /// Whether refinements with a factor come next.
    refine: bool,
    refinements: usize,
}

fn largest_diagonal(gram: &dyn GramSource, penalty: &[f64]) -> Result<f64, SolverError> {
    let mut largest = 0.0f64;
    let max_degree = index::max_degree_of(gram.size()).unwrap_or(0);
    for l in 0..=max_degree {
        let columns = first_column(l)..first_column(l + 1);
        let k = columns.len();
        let mut tile = vec![0.0; k * k];
        gram.tile(columns.clone(), columns.clone(), &mut tile, k)?;
        for (i, column) in columns.enumerate() {
            largest = largest.max(tile[i * k + i] + penalty[column]);
        }
    }
    Ok(largest)
}
