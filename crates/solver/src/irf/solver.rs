//! Fits targets in batches by iterative residual fitting.

use std::ops::{Range, RangeInclusive};

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::{Monitor, Stage};

use super::block_solve::BlockSolver;
use super::params::IrfParams;
use super::plan::{IrfPlan, plan};
use super::report::{IrfReport, Recorder};
use crate::chunked_rows::ChunkedRows;
use crate::gram::GramMatrix;
use crate::operator::BlockOperator;
use crate::{SolverError, check};

/// The result of iterative residual fitting.
#[derive(Debug, Clone)]
pub struct IrfFit {
    /// Canonical coefficients (K, c): one row per basis function, one column per target column.
    pub coefficients: Coefficients,
    /// Report on blocks, passes, residuals, times and memory.
    pub report: IrfReport,
}

/// Fits batches of targets over one basis, given by an operator, and keeps the blocks' factors between batches.
pub struct IrfSolver<'o> {
    pub(super) operator: &'o dyn BlockOperator,
    /// The parameters, with the actual number of threads.
    pub(super) params: IrfParams,
    channels: usize,
    pub(super) blocks: Vec<RangeInclusive<usize>>,
    pub(super) plan: IrfPlan,
    /// Square roots (n) of the weights.
    pub(super) root_weights: Option<Vec<f64>>,
    pub(super) block_solver: BlockSolver<'o>,
}

impl<'o> IrfSolver<'o> {
    /// Creates a solver, and plans fits of up to `channels` columns at a time.
    ///
    /// # Errors
    ///
    /// [`SolverError::Budget`] if the memory budget is too small; [`SolverError::Degree`],
    /// [`SolverError::StartDegree`], [`SolverError::TooSmall`], [`SolverError::Rows`] or [`SolverError::Weight`] if a
    /// parameter is invalid.
    pub fn new(operator: &'o dyn BlockOperator, channels: usize, params: IrfParams) -> Result<Self, SolverError> {
        Self::planned(operator, channels, params, None)
    }

    /// Creates a solver as [`IrfSolver::new`] does, but takes the blocks' Gram matrices from `gram`. `gram` must be the
    /// Gram matrix of the operator's basis, in f64, with the weights of `params`. Every pass, including the first, then
    /// only computes right-hand sides and updates.
    ///
    /// # Errors
    ///
    /// The errors of [`IrfSolver::new`], and [`SolverError::Degree`] if the highest degree of `gram` is below the fit's
    /// highest degree.
    pub fn with_gram(
        operator: &'o dyn BlockOperator,
        channels: usize,
        params: IrfParams,
        gram: &'o dyn GramMatrix,
    ) -> Result<Self, SolverError> {
        if basis_size(params.max_degree) > gram.size() {
            let max_degree = gram.size().isqrt().saturating_sub(1);
            return Err(SolverError::Degree { found: params.max_degree, max_degree });
        }
        Self::planned(operator, channels, params, Some(gram))
    }

    fn planned(
        operator: &'o dyn BlockOperator,
        channels: usize,
        params: IrfParams,
        gram: Option<&'o dyn GramMatrix>,
    ) -> Result<Self, SolverError> {
        let threads = crate::threads(params.threads);
        let params = IrfParams { gram_bytes: gram.map(GramMatrix::bytes), threads, ..params };
        if params.max_degree > operator.max_degree() {
            return Err(SolverError::Degree { found: params.max_degree, max_degree: operator.max_degree() });
        }
        if let Some(weights) = &params.weights {
            check::weights(weights, operator.rows())?;
        }
        check::unread(params.unread.as_ref(), operator.rows())?;
        let blocks = params.method.blocks(params.max_degree)?;
        let plan = plan(operator, channels, &params)?;
        let root_weights = params.weights.as_ref().map(|weights| weights.iter().map(|w| w.sqrt()).collect());
        let block_solver = BlockSolver::new(operator, gram, blocks.len(), threads, &plan);
        Ok(Self { operator, params, channels, blocks, plan, root_weights, block_solver })
    }

    /// Returns the largest number of columns of a batch.
    pub fn channels(&self) -> usize {
        self.channels
    }

    /// Returns the memory plan.
    pub fn plan(&self) -> &IrfPlan {
        &self.plan
    }

    /// Returns the degrees of each block of a pass.
    pub fn blocks(&self) -> &[RangeInclusive<usize>] {
        &self.blocks
    }

    /// Fits targets (n, c). `groups` gives the columns of each target: three for a surface, one for a signal.
    ///
    /// Reports one stage, `fit`, to the monitor, counted in columns of the basis over all passes. Also sends a status
    /// message for each block and a detail message for each pass.
    ///
    /// # Errors
    ///
    /// [`SolverError::Store`] if the basis is damaged or changes during the fit; [`SolverError::Interrupted`] if the
    /// monitor cancels the fit; [`SolverError::Rows`], [`SolverError::Channels`] or [`SolverError::NotFinite`] if the
    /// targets are invalid; [`SolverError::Singular`] or [`SolverError::NoConvergence`] if a block can't be solved.
    pub fn fit(
        &mut self,
        targets: ChunkedRows,
        groups: &[Range<usize>],
        monitor: &dyn Monitor,
    ) -> Result<IrfFit, SolverError> {
        let expected = self.operator.rows();
        if targets.rows() != expected {
            return Err(SolverError::Rows { what: "the target", expected, found: targets.rows() });
        }
        if let Some((row, column)) = targets.not_finite() {
            return Err(SolverError::NotFinite { row, column });
        }
        let channels = targets.channels();
        if channels > self.channels {
            return Err(SolverError::Channels { planned: self.channels, found: channels });
        }
        let size = basis_size(self.params.max_degree);
        let mut residual = targets;
        let mut coefficients = Array2::<f64>::zeros((size, channels));
        let mut log = Recorder::new(groups, self.params.unread.clone(), monitor);
        monitor.begin(Stage::counted("fit", "columns"), (size * self.params.method.passes()) as u64);
        if self.params.accelerate {
            self.accelerated(&mut residual, &mut coefficients, &mut log)?;
        } else {
            self.passes(&mut residual, &mut coefficients, &mut log)?;
        }
        monitor.end();
        let report = IrfReport {
            method: self.params.method.name(),
            accelerated: self.params.accelerate,
            passes: self.params.method.passes(),
            max_degree: self.params.max_degree,
            rows: expected,
            channels,
            threads: self.params.threads,
            blocks: self.block_solver.reports().to_vec(),
            history: log.history,
            seconds: log.seconds,
            memory: self.plan.clone(),
        };
        Ok(IrfFit { coefficients: Coefficients::new(coefficients)?, report })
    }
}

/// Fits one batch of targets (n, c), with [`IrfSolver::new`] and [`IrfSolver::fit`].
///
/// # Errors
///
/// The errors of [`IrfSolver::new`] and [`IrfSolver::fit`].
pub fn solve(
    operator: &dyn BlockOperator,
    targets: ArrayView2<'_, f64>,
    groups: &[Range<usize>],
    params: &IrfParams,
    monitor: &dyn Monitor,
) -> Result<IrfFit, SolverError> {
    let mut solver = IrfSolver::new(operator, targets.ncols(), params.clone())?;
    solver.fit(ChunkedRows::from_array(targets, operator.chunk_rows()), groups, monitor)
}
