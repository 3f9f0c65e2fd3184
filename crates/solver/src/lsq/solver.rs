//! Defines the solver and the sequence of a fit, from the plan to the report. Module `run` executes the steps.

use std::ops::Range;
use std::sync::Arc;
use std::time::Instant;

use ndarray::Array2;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::{Monitor, Stage};

use super::cg::Stop;
use super::cost::moment_accuracy;
use super::factor::{MadeFactor, factorise_shifted};
use super::moments::{MomentProblem, Summed};
use super::normal_equations::NormalEquations;
use super::params::{LsqParams, Strategy};
use super::plan::{self, Plan};
use super::problem::{Moments, Problem, Sampled};
use super::report::{LsqReport, LsqWarning};
use super::strategy::choose;
use crate::cholesky::{CholeskyFactor, FactorParams, plan_factor};
use crate::gram::{GramMatrix, degree_penalty, smoothness_penalty};
use crate::operator::Operator;
use crate::{MomentNormal, SolverError, check};

/// The stage reported to the monitor during a fit, except while a factor is computed. Its number of steps is unknown in
/// advance.
pub(super) const FIT: Stage = Stage::counted("fit", "steps");

/// The result of a least-squares fit.
#[derive(Debug, Clone)]
pub struct LsqFit {
    /// Canonical coefficients (K, c).
    pub coefficients: Coefficients,
    /// Residual (n, c): targets minus the values of the fit.
    pub residual: Array2<f64>,
    /// Report on the fit.
    pub report: LsqReport,
}

/// Function that computes the Gram matrix `A^T W A`; called when a factor is needed.
pub type MakeGram<'a> = dyn Fn() -> Result<Box<dyn GramMatrix>, SolverError> + Sync + 'a;

/// Function that checks whether the process's limits allow the given number of additional bytes of anonymous memory.
pub type CheckLimits<'a> = dyn Fn(usize) -> Result<(), SolverError> + Sync + 'a;

/// Function that computes the normal matrix from moments of at least the given relative accuracy; called when
/// iterations are faster with moments. Also returns the right-hand sides `A^T W f` of the given targets (n, c) if they
/// are obtained at the same time.
pub type MakeMoments<'a> = dyn Fn(f64, Option<&Array2<f64>>) -> Result<MomentsAndRightSides, SolverError> + Sync + 'a;

/// The normal matrix from moments, and the right-hand sides (K, c) if they were computed at the same time.
pub type MomentsAndRightSides = (Arc<MomentNormal>, Option<Array2<f64>>);

/// The data source of a solver.
#[derive(Clone, Copy)]
pub(super) enum Source<'a> {
    /// An operator at the directions of the samples.
    Samples(&'a dyn Operator),
    /// Moments of samples, without the samples themselves.
    Moments(&'a MomentProblem),
}

impl Source<'_> {
    pub(super) fn max_degree(&self) -> usize {
        match self {
            Self::Samples(operator) => operator.max_degree(),
            Self::Moments(problem) => problem.max_degree(),
        }
    }

    pub(super) fn rows(&self) -> usize {
        match self {
            Self::Samples(operator) => operator.rows(),
            Self::Moments(problem) => problem.rows(),
        }
    }
}

/// The problem to solve.
#[derive(Clone, Copy)]
pub(super) enum Given<'a> {
    /// Targets (n, c) at the directions of an operator.
    Targets(&'a dyn Operator, &'a Array2<f64>),
    /// Sums over samples.
    Sums(&'a MomentProblem),
}

/// Fits batches of targets on one sampling, and keeps the moments and the factor between batches.
pub struct LsqSolver<'a> {
    pub(super) source: Source<'a>,
    pub(super) make_gram: Option<&'a MakeGram<'a>>,
    pub(super) make_moments: Option<&'a MakeMoments<'a>>,
    check_limits: Option<&'a CheckLimits<'a>>,
    pub(super) stored: Option<&'a dyn CholeskyFactor>,
    pub(super) params: LsqParams,
    /// Diagonal (K) of the penalty P; `None` without a penalty.
    pub(super) penalty: Option<Vec<f64>>,
    pub(super) made: Option<MadeFactor>,
    pub(super) moments: Option<Moments>,
    pub(super) warnings: Vec<LsqWarning>,
    /// Whether to log the plan of each fit.
    pub(super) notes_plans: bool,
    pub(super) factor_seconds: f64,
    pub(super) moment_seconds: f64,
}

/// The solution of a batch.
pub(super) struct Solution {
    pub(super) stop: Stop,
    /// Name of the last steps' preconditioner.
    pub(super) preconditioner: &'static str,
    /// Number of refinements with a factor; `None` without a factor.
    pub(super) refinements: Option<usize>,
    /// Residual (n, c): targets minus the fit's values at the samples. `None` for fits from moments.
    pub(super) residual: Option<Array2<f64>>,
}

impl<'a> LsqSolver<'a> {
    /// Creates a solver for an operator. With `make_gram`, the solver can compute factors; the Gram matrix must include
    /// the weights of `params`, but not the penalty.
    ///
    /// # Errors
    ///
    /// [`SolverError::Rows`], [`SolverError::Weight`], [`SolverError::Smoothness`], [`SolverError::Penalties`] or
    /// [`SolverError::Penalty`] if a parameter is invalid.
    pub fn new(
        operator: &'a dyn Operator,
        make_gram: Option<&'a MakeGram<'a>>,
        params: LsqParams,
    ) -> Result<Self, SolverError> {
        let expected = operator.rows();
        if let Some(weights) = &params.weights {
            check::weights(weights, expected)?;
        }
        check::unread(params.unread.as_ref(), expected)?;
        Self::of(Source::Samples(operator), make_gram, params)
    }

    /// Creates a solver for a data source.
    pub(super) fn of(
        source: Source<'a>,
        make_gram: Option<&'a MakeGram<'a>>,
        params: LsqParams,
    ) -> Result<Self, SolverError> {
        let penalty = penalty(source.max_degree(), &params)?;
        Ok(Self {
            source,
            make_gram,
            make_moments: None,
            check_limits: None,
            stored: None,
            params,
            penalty,
            made: None,
            moments: None,
            warnings: Vec::new(),
            notes_plans: true,
            factor_seconds: 0.0,
            moment_seconds: 0.0,
        })
    }

    /// Uses an existing factor. The factor must have been computed for the operator's directions and degree, and for
    /// the weights and penalty of the parameters.
    #[must_use]
    pub fn with_factor(mut self, factor: &'a dyn CholeskyFactor) -> Self {
        self.stored = Some(factor);
        self
    }

    /// Lets iterations use the normal matrix from moments if that is faster. `make` must compute the normal matrix for
    /// the operator's directions and degree, and for the weights of the parameters.
    #[must_use]
    pub fn with_moments(mut self, make: &'a MakeMoments<'a>) -> Self {
        self.make_moments = Some(make);
        self
    }

    /// Uses moments of an earlier solver for iterations. `normal` must be the normal matrix for the operator's
    /// directions and degree, and for the weights of the parameters. The moments are ignored if their relative
    /// accuracy is below [`moment_accuracy`], if the memory budget has no room for them, or if the strategy requires a
    /// factor.
    #[must_use]
    pub fn with_made_moments(mut self, normal: Arc<MomentNormal>, accuracy: f64) -> Self {
        let fits = self.params.moment_bytes <= self.room();
        let iterates = self.params.strategy != Strategy::Cholesky;
        if accuracy <= moment_accuracy(self.params.tolerance) && fits && iterates {
            self.moments = Some(Moments { normal, accuracy });
        }
        self
    }

    /// Sets a check of the process's limits that is called before a factor is computed. Without it, OpenBLAS would wait
    /// forever for buffers that it can't allocate.
    #[must_use]
    pub fn with_limits(mut self, check: &'a CheckLimits<'a>) -> Self {
        self.check_limits = Some(check);
        self
    }

    /// Changes the smoothness for the fits that follow. Moments are kept, and a computed factor is dropped.
    ///
    /// # Errors
    ///
    /// [`SolverError::Smoothness`] if `smoothness` is negative or not finite.
    pub fn set_smoothness(&mut self, smoothness: f64) -> Result<(), SolverError> {
        let params = LsqParams { smoothness, ..self.params.clone() };
        self.penalty = penalty(self.source.max_degree(), &params)?;
        (self.params, self.made) = (params, None);
        Ok(())
    }

    /// Fits targets (n, c). `groups` gives the columns of each target: three for a surface, one for a signal.
    ///
    /// Reports the stage `fit` to the monitor, counted in steps whose number is unknown, with a status message for each
    /// step. If a factor is computed, also reports the stage `factor`, counted in flops.
    ///
    /// # Errors
    ///
    /// [`SolverError::Rows`] or [`SolverError::NotFinite`] if the targets are invalid, [`SolverError::Interrupted`] if
    /// the monitor cancels the fit, and the errors of the operator, the Gram matrix and the stored factor. If the
    /// strategy requires a factor, also [`SolverError::NoGram`] if there is no Gram matrix from which the factor can be
    /// computed, and an error if the memory budget or a limit of the process is too low for the factor. A fit that
    /// doesn't converge isn't an error.
    pub fn fit(
        &mut self,
        targets: &Array2<f64>,
        groups: &[Range<usize>],
        monitor: &dyn Monitor,
    ) -> Result<LsqFit, SolverError> {
        // Solvers without samples are only used by `solve_moments` and `solve_moments_of_groups`, which don't call
        // `fit`.
        let Source::Samples(operator) = self.source else { return Err(SolverError::NoGram) };
        check::targets(targets, operator.rows())?;
        let (coefficients, residual, report) = self.solve(Given::Targets(operator, targets), groups, monitor)?;
        Ok(LsqFit { coefficients, residual: residual.unwrap_or_default(), report })
    }

    /// Solves a problem. Returns the coefficients (K, c), the residual (n, c) if there are samples, and a report.
    pub(super) fn solve(
        &mut self,
        given: Given<'_>,
        groups: &[Range<usize>],
        monitor: &dyn Monitor,
    ) -> Result<(Coefficients, Option<Array2<f64>>, LsqReport), SolverError> {
        let started = Instant::now();
        (self.factor_seconds, self.moment_seconds) = (0.0, 0.0);
        self.warnings.clear();
        monitor.begin(FIT, 0);
        let columns = match given {
            Given::Targets(_, targets) => targets.ncols(),
            Given::Sums(problem) => problem.channels(),
        };
        let plan = self.plan(given, columns);
        if self.notes_plans {
            plan.note(monitor);
        }
        let (cg, solution, steps) = self.run(&plan, given, monitor)?;
        monitor.end();
        let report = self.report(&cg, &solution, steps, groups, started);
        Ok((Coefficients::new(cg.x)?, solution.residual, report))
    }

    /// Returns the plan for solving a problem with `columns` columns of targets.
    pub(super) fn plan(&mut self, given: Given<'_>, columns: usize) -> Plan {
        let available = self.available(given);
        if self.params.strategy == Strategy::DensityCg && available.moments == plan::Moments::None {
            self.warnings.push(LsqWarning::NoDensity { reason: self.why_no_moments() });
        }
        let (sizes, request) = (self.sizes(columns), self.request());
        if request.strategy == Strategy::Cholesky && sizes.are_underdetermined(&request) {
            let reason = "there are fewer vertices than coefficients, and iterations then give the solution of minimum \
                          norm more accurately; with a smoothness penalty, the factor can be computed";
            self.warnings.push(LsqWarning::NoFactor { reason: reason.to_owned() });
        }
        choose(&sizes, &available, &request)
    }

    /// Returns the factor to solve with: the stored factor if there is one, else the computed factor.
    pub(super) fn factor(&self) -> Result<&dyn CholeskyFactor, SolverError> {
        match (self.stored, &self.made) {
            (Some(factor), _) => Ok(factor),
            (None, Some(made)) => Ok(&made.factor),
            (None, None) => Err(SolverError::NoGram),
        }
    }

    /// Computes a factor unless one exists. If the memory budget or the process's limits are too low, returns an error
    /// if the factor is `required`, otherwise false.
    pub(super) fn make_factor(&mut self, required: bool, monitor: &dyn Monitor) -> Result<bool, SolverError> {
        if self.stored.is_some() || self.made.is_some() {
            return Ok(true);
        }
        let Some(make_gram) = self.make_gram else { return Err(SolverError::NoGram) };
        let started = Instant::now();
        let params = self.factor_params();
        let size = basis_size(self.source.max_degree());
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

    pub(super) fn factor_params(&self) -> FactorParams {
        let held_by_moments = if self.moments.is_some() { self.params.moment_bytes } else { 0 };
        FactorParams {
            memory: self.params.memory,
            held: self.params.held + self.params.gram_bytes + held_by_moments,
            threads: self.params.threads,
            ..FactorParams::default()
        }
    }

    /// Checks that the budget and the process's limits allow a factorisation.
    fn plan_factor(&self, size: usize, params: &FactorParams) -> Result<(), SolverError> {
        let (plan, _) = plan_factor(size, params, false)?;
        // The memory in `held` is already in use, so it isn't checked against the limits again.
        self.check_limits.map_or(Ok(()), |check| check(plan.memory - self.params.held + plan.reserved))
    }

    pub(super) fn problem<'s>(&'s self, given: Given<'s>) -> Box<dyn Problem + 's> {
        let penalty = self.penalty.as_deref();
        match given {
            Given::Targets(operator, targets) => Box::new(Sampled {
                equations: NormalEquations { operator, weights: self.params.weights.as_deref(), penalty },
                targets,
                moments: self.moments.as_ref(),
            }),
            Given::Sums(problem) => Box::new(Summed { problem, penalty }),
        }
    }

    /// Returns the number of rows with nonzero weight.
    pub(super) fn rows_with_weight(&self) -> usize {
        let count = |weights: &Vec<f64>| weights.iter().filter(|weight| **weight > 0.0).count();
        self.params.weights.as_ref().map_or(self.source.rows(), count)
    }
}

/// Returns the diagonal (K) of the penalty P: the sum of the smoothness penalty and the penalties by degree. Returns
/// `None` without a penalty.
fn penalty(max_degree: usize, params: &LsqParams) -> Result<Option<Vec<f64>>, SolverError> {
    if !(params.smoothness >= 0.0 && params.smoothness.is_finite()) {
        return Err(SolverError::Smoothness { found: params.smoothness });
    }
    let smoothness = (params.smoothness > 0.0).then(|| smoothness_penalty(max_degree, params.smoothness));
    let Some(by_degree) = &params.penalty else { return Ok(smoothness) };
    let found = by_degree.len();
    if found != max_degree + 1 {
        return Err(SolverError::Penalties { expected: max_degree + 1, found });
    }
    if let Some(degree) = by_degree.iter().position(|p| !(*p >= 0.0 && p.is_finite())) {
        return Err(SolverError::Penalty { degree, found: by_degree[degree] });
    }
    let mut all = degree_penalty(by_degree);
    smoothness.iter().flatten().zip(&mut all).for_each(|(smoothness, all)| *all += smoothness);
    Ok(Some(all))
}

/// Fits the columns of targets (n, c) as one target. Calls [`LsqSolver::new`] without a Gram matrix, then
/// [`LsqSolver::fit`].
///
/// # Errors
///
/// The errors of [`LsqSolver::new`] and [`LsqSolver::fit`].
pub fn solve(
    operator: &dyn Operator,
    targets: &Array2<f64>,
    params: &LsqParams,
    monitor: &dyn Monitor,
) -> Result<LsqFit, SolverError> {
    let columns = 0..targets.ncols();
    LsqSolver::new(operator, None, params.clone())?.fit(targets, std::slice::from_ref(&columns), monitor)
}
