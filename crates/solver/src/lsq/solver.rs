//! The strategy: conjugate gradients, a factor with refinement, or a shifted factor.

use std::ops::Range;
use std::time::Instant;

use ndarray::{Array2, s};
use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::{Monitor, Stage};

use super::cg::{Cg, CgParams, Stop};
use super::columns::norms;
use super::factor::{MadeFactor, factorise_low_degrees, factorise_shifted};
use super::normal_equations::NormalEquations;
use super::params::{LsqParams, Strategy};
use super::preconditioner::{Density, LowDegrees, Preconditioner};
use super::report::{LsqReport, LsqSeconds, LsqWarning};
use crate::cholesky::{CholeskyFactor, FactorParams, plan_factor};
use crate::gram::{GramMatrix, smoothness_penalty};
use crate::operator::Operator;
use crate::residual::ResidualNorms;
use crate::{SolverError, check};

/// Iterations after which a factor is made, where one can be: on samplings that need more, many more are needed.
const BEFORE_FACTOR: usize = 60;
/// Iterations without the optimality halving after which to give up.
const PATIENCE: usize = 250;
/// Above this reciprocal condition number few iterations are needed, and for few columns they are faster than reading a
/// stored factor.
const WELL_CONDITIONED: f64 = 1e-2;
/// Most columns for which that holds.
const FEW: usize = 12;

/// The stage of a fit but for the making of a factor; how many steps it will take isn't known.
const FIT: Stage = Stage::counted("fit", "steps");

/// The result of a least-squares fit.
#[derive(Debug, Clone)]
pub struct LsqFit {
    /// Canonical coefficients, (K, c).
    pub coefficients: Coefficients,
    /// Targets minus synthesis, (n, c).
    pub residual: Array2<f64>,
    /// How it was solved, and how close it is.
    pub report: LsqReport,
}

/// Makes the Gram matrix `A^T W A`, when a factor is needed.
pub type MakeGram<'a> = dyn Fn() -> Result<Box<dyn GramMatrix>, SolverError> + Sync + 'a;

/// Checks that the process's limits allow for so many bytes of anonymous memory beyond what it has.
pub type CheckLimits<'a> = dyn Fn(usize) -> Result<(), SolverError> + Sync + 'a;

/// Solves batch after batch on one sampling, and keeps the factor from one to the next.
pub struct LsqSolver<'a> {
    pub(super) operator: &'a dyn Operator,
    make_gram: Option<&'a MakeGram<'a>>,
    check_limits: Option<&'a CheckLimits<'a>>,
    pub(super) stored: Option<&'a dyn CholeskyFactor>,
    pub(super) params: LsqParams,
    /// Diagonal of P, (K), where there is a penalty.
    pub(super) penalty: Option<Vec<f64>>,
    pub(super) made: Option<MadeFactor>,
    low_degrees: Option<LowDegrees>,
    warnings: Vec<LsqWarning>,
    factor_seconds: f64,
}

/// How a batch was solved.
pub(super) struct Solution {
    pub(super) stop: Stop,
    /// The preconditioner of the last steps.
    pub(super) preconditioner: &'static str,
    /// Refinements with a factor; `None` where there was none.
    pub(super) refinements: Option<usize>,
    /// Targets minus synthesis, (n, c).
    pub(super) residual: Array2<f64>,
}

impl<'a> LsqSolver<'a> {
    /// Makes a solver for an operator. With `make_gram` it can make factors; the Gram matrix has to have the weights of
    /// `params`, but not the penalty.
    ///
    /// # Errors
    ///
    /// [`SolverError::Rows`], [`SolverError::Weight`] and [`SolverError::Smoothness`] for parameters that are out of
    /// range.
    pub fn new(
        operator: &'a dyn Operator,
        make_gram: Option<&'a MakeGram<'a>>,
        params: LsqParams,
    ) -> Result<Self, SolverError> {
        let expected = operator.rows();
        if let Some(weights) = &params.weights {
            check::weights(weights, expected)?;
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
            check_limits: None,
            stored: None,
            params,
            penalty,
            made: None,
            low_degrees: None,
            warnings: Vec::new(),
            factor_seconds: 0.0,
        })
    }

    /// Uses a factor that exists already: of the operator's directions and degree, and of the weights and penalty of the
    /// parameters.
    #[must_use]
    pub fn with_factor(mut self, factor: &'a dyn CholeskyFactor) -> Self {
        self.stored = Some(factor);
        self
    }

    /// Asks before a factor is made whether the process's limits allow for it. OpenBLAS waits for ever for buffers that it
    /// can't have.
    #[must_use]
    pub fn with_limits(mut self, check: &'a CheckLimits<'a>) -> Self {
        self.check_limits = Some(check);
        self
    }

    /// Solves for targets, (n, c), of which `groups` gives the columns of each target: three for a surface, one for a
    /// signal.
    ///
    /// The monitor gets the stage `fit`, in steps whose number isn't known, with a status for each; and the stage
    /// `factor`, in flops, where one is made.
    ///
    /// # Errors
    ///
    /// [`SolverError::Rows`], [`SolverError::NotFinite`], [`SolverError::Interrupted`]; [`SolverError::NoGram`],
    /// [`SolverError::Limit`] and too small a budget for a strategy that needs a Gram matrix; those of operator, Gram matrix and stored factor. Not converging is none.
    pub fn fit(
        &mut self,
        targets: &Array2<f64>,
        groups: &[Range<usize>],
        monitor: &dyn Monitor,
    ) -> Result<LsqFit, SolverError> {
        check::targets(targets, self.operator.rows())?;
        let started = Instant::now();
        self.factor_seconds = 0.0;
        self.warnings.clear();
        monitor.begin(FIT, 0);
        let mut cg = Cg::new(&self.equations(), targets)?;
        let solution = if self.starts_with_factor(targets.ncols()) {
            self.make_factor(self.params.strategy == Strategy::Cholesky, monitor)?;
            self.refine(&mut cg, targets, monitor)?
        } else {
            match self.iterate(&mut cg, targets, monitor)? {
                Some(solution) => solution,
                None => self.refine(&mut cg, targets, monitor)?,
            }
        };
        monitor.end();
        let report = self.report(&cg, &solution, groups, started);
        Ok(LsqFit { coefficients: Coefficients::new(cg.x)?, residual: solution.residual, report })
    }

    /// Whether to use a factor from the start.
    fn starts_with_factor(&self, columns: usize) -> bool {
        let at_hand = self.stored.is_some() || self.made.is_some();
        let well = self.stored.is_some_and(|factor| factor.condition().reciprocal > WELL_CONDITIONED);
        match self.params.strategy {
            Strategy::Cholesky => true,
            Strategy::Auto => at_hand && !(well && columns <= FEW),
            _ => false,
        }
    }

    /// Runs conjugate gradients with the selected preconditioner until they end, or until a factor has been made because
    /// they are slow: then there is no solution yet.
    fn iterate(
        &mut self,
        cg: &mut Cg,
        targets: &Array2<f64>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Solution>, SolverError> {
        if let (Strategy::LowDegreesCg(degree), None) = (self.params.strategy, &self.low_degrees) {
            self.low_degrees = Some(self.make_low_degrees(degree)?);
        }
        let params = self.cg_params();
        let factor_possible = self.params.strategy == Strategy::Auto
            && (self.make_gram.is_some() || self.stored.is_some() || self.made.is_some())
            && basis_size(self.operator.max_degree()) <= self.operator.rows();
        let first = if factor_possible { BEFORE_FACTOR.min(params.max_iterations) } else { params.max_iterations };
        let first = CgParams { max_iterations: first, ..params };
        let mut stop = cg.run(&self.equations(), &*self.preconditioner(), &first, monitor)?;
        // A limit below that is a limit on all the work: no factor then.
        let more = params.max_iterations - first.max_iterations;
        if stop == Stop::IterationLimit && factor_possible && more > 0 {
            if self.make_factor(false, monitor)? {
                return Ok(None);
            }
            let rest = CgParams { max_iterations: more, ..params };
            stop = cg.run(&self.equations(), &*self.preconditioner(), &rest, monitor)?;
        }
        let preconditioner = self.preconditioner();
        let (stop, residual) = cg.confirm(stop, &self.equations(), targets, &*preconditioner, &params, monitor)?;
        Ok(Some(Solution { stop, preconditioner: preconditioner.name(), refinements: None, residual }))
    }

    /// The factor to solve with: the stored one, else the one that was made.
    pub(super) fn factor(&self) -> Result<&dyn CholeskyFactor, SolverError> {
        match (self.stored, &self.made) {
            (Some(factor), _) => Ok(factor),
            (None, Some(made)) => Ok(&made.factor),
            (None, None) => Err(SolverError::NoGram),
        }
    }

    /// Makes a factor unless there is one. False where memory or the process's limits don't allow for one; an error then
    /// where it is `required`.
    pub(super) fn make_factor(&mut self, required: bool, monitor: &dyn Monitor) -> Result<bool, SolverError> {
        if self.stored.is_some() || self.made.is_some() {
            return Ok(true);
        }
        let Some(make_gram) = self.make_gram else { return Err(SolverError::NoGram) };
        let started = Instant::now();
        let params = FactorParams {
            memory: self.params.memory,
            held: self.params.held + self.params.gram_bytes,
            threads: self.params.threads,
            ..FactorParams::default()
        };
        let size = basis_size(self.operator.max_degree());
        if let Err(error) = self.plan_factor(size, &params) {
            if required {
                return Err(error);
            }
            self.warnings.push(LsqWarning::NoFactor { reason: error.to_string() });
            return Ok(false);
        }
        let zero = vec![0.0; size];
        let penalty = self.penalty.as_deref().unwrap_or(&zero);
        self.made = Some(factorise_shifted(&*make_gram()?, penalty, &params, monitor)?);
        monitor.begin(FIT, 0);
        self.factor_seconds += started.elapsed().as_secs_f64();
        Ok(true)
    }

    fn plan_factor(&self, size: usize, params: &FactorParams) -> Result<(), SolverError> {
        let (plan, _) = plan_factor(size, params, false)?;
        // What is held is there already.
        self.check_limits.map_or(Ok(()), |check| check(plan.memory - self.params.held + plan.reserved))
    }

    fn make_low_degrees(&self, degree: usize) -> Result<LowDegrees, SolverError> {
        let make_gram = self.make_gram.ok_or(SolverError::NoGram)?;
        let degree = degree.min(self.operator.max_degree());
        factorise_low_degrees(&*make_gram()?, self.penalty.as_deref(), degree, self.equations().diagonal())
    }

    fn preconditioner(&self) -> Box<dyn Preconditioner + '_> {
        match (self.params.strategy, &self.params.areas, &self.low_degrees) {
            (Strategy::DensityCg, Some(areas), _) => {
                Box::new(Density::new(self.operator, areas, self.params.weights.as_deref()))
            }
            (Strategy::LowDegreesCg(_), _, Some(low_degrees)) => Box::new(low_degrees),
            _ => Box::new(self.equations().diagonal()),
        }
    }

    fn cg_params(&self) -> CgParams {
        let LsqParams { tolerance, max_iterations, .. } = self.params;
        CgParams { tolerance, max_iterations, patience: PATIENCE }
    }

    pub(super) fn equations(&self) -> NormalEquations<'_> {
        NormalEquations {
            operator: self.operator,
            weights: self.params.weights.as_deref(),
            penalty: self.penalty.as_deref(),
        }
    }

    pub(super) fn rows_with_weight(&self) -> usize {
        let count = |weights: &Vec<f64>| weights.iter().filter(|weight| **weight > 0.0).count();
        self.params.weights.as_ref().map_or(self.operator.rows(), count)
    }

    fn report(&mut self, cg: &Cg, solution: &Solution, groups: &[Range<usize>], started: Instant) -> LsqReport {
        let optimality = cg.optimality();
        let converged = solution.stop == Stop::Converged && optimality <= 2.0 * self.params.tolerance;
        let stop = match solution.stop {
            Stop::Converged if !converged => Stop::Stalled,
            stop => stop,
        };
        let norm = norms(&cg.x).into_iter().fold(0.0, f64::max);
        let made = self.made.as_ref().filter(|_| solution.refinements.is_some());
        let shift = made.map_or(0.0, |made| made.shift);
        let breaks_at = made.and_then(|made| made.breaks_at);
        let (rows, columns) = (self.rows_with_weight(), cg.x.nrows());
        if rows < columns && self.penalty.is_none() && shift == 0.0 {
            self.warnings.push(LsqWarning::Underdetermined { rows, columns, norm });
        }
        LsqReport {
            max_degree: self.operator.max_degree(),
            rows: self.operator.rows(),
            channels: cg.x.ncols(),
            preconditioner: solution.preconditioner,
            iterations: cg.iterations,
            refinements: solution.refinements.unwrap_or(0),
            optimality,
            stop,
            condition: self.condition(cg, solution),
            shift,
            breaks_at,
            norm,
            smoothness: self.params.smoothness,
            warnings: self.warnings.clone(),
            residuals: groups
                .iter()
                .map(|group| ResidualNorms::of(solution.residual.slice(s![.., group.clone()])))
                .collect(),
            seconds: LsqSeconds { factor: self.factor_seconds, total: started.elapsed().as_secs_f64() },
        }
    }

    /// Condition number of `W^(1/2) A`, stacked on `P^(1/2)`.
    fn condition(&self, cg: &Cg, solution: &Solution) -> f64 {
        let of = |reciprocal: f64| if reciprocal > 0.0 { (1.0 / reciprocal).sqrt() } else { f64::INFINITY };
        match (self.stored, &self.made) {
            (Some(factor), _) => of(factor.condition().reciprocal),
            (None, Some(made)) if made.shift > 0.0 => f64::INFINITY,
            (None, Some(made)) => of(made.factor.condition().reciprocal),
            // Preconditioned by more than a number it isn't the matrix's own.
            (None, None) if solution.preconditioner == "none" && self.penalty.is_none() => cg.condition.sqrt(),
            (None, None) => f64::NAN,
        }
    }
}

/// Fits the columns of targets, (n, c), as one target: [`LsqSolver::new`] without a Gram matrix, and [`LsqSolver::fit`].
///
/// # Errors
///
/// Those of the two.
pub fn solve(
    operator: &dyn Operator,
    targets: &Array2<f64>,
    params: &LsqParams,
    monitor: &dyn Monitor,
) -> Result<LsqFit, SolverError> {
    let columns = 0..targets.ncols();
    LsqSolver::new(operator, None, params.clone())?.fit(targets, std::slice::from_ref(&columns), monitor)
}
