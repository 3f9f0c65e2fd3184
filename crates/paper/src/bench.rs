//! Builds bases of spherical harmonics, fits surfaces, and measures the time that this takes.

use std::cell::RefCell;
use std::fmt::Display;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use ndarray::ArrayView2;
use spharm_harmonics::{Coefficients, Directions};
use spharm_monitor::{Level, Monitor};
use spharm_solver::{BlockOperator, ChunkedRows, DiskOperator, IrfParams, IrfReport, IrfSolver, Method};
use spharm_store::{BuildParams, BuildReport, build};

use crate::published::Quality;
use crate::surfaces::Surface;

/// Context shared by all experiments.
#[derive(Clone, Copy)]
pub(crate) struct Bench<'a> {
    pub(crate) monitor: &'a dyn Monitor,
    /// Warnings about results, collected from all experiments.
    pub(crate) warnings: &'a RefCell<Vec<String>>,
    /// Maximum memory of a build or a fit, in bytes.
    pub(crate) memory: usize,
    pub(crate) threads: usize,
    /// Memory that the surfaces and the program occupy, in bytes.
    pub(crate) held: usize,
}

/// Accuracy and duration of a fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Measured {
    pub(crate) quality: Quality,
    pub(crate) seconds: f64,
}

/// Maximum number of refinement sweeps after the single pass of NLSF (a full least-squares fit), as in the command
/// `spharm fit`.
const REFINEMENTS: usize = 5;

impl Bench<'_> {
    /// Reports to the monitor which experiment is running.
    pub(crate) fn note(&self, text: impl Display) {
        self.monitor.note(Level::Info, format_args!("{text}"));
    }

    fn warn(&self, text: impl ToString) {
        self.warnings.borrow_mut().push(text.to_string());
    }

    /// Builds the missing files of a basis in a store. Returns the report and the time in seconds, which includes
    /// syncing the files to disk.
    pub(crate) fn build(&self, store: &Path, directions: &Directions, max_degree: usize) -> Result<(BuildReport, f64)> {
        let params = BuildParams { max_degree, memory: self.memory, threads: self.threads, ..BuildParams::default() };
        let started = Instant::now();
        let report = build(store, directions, &params, self.monitor);
        let seconds = started.elapsed().as_secs_f64();
        let what = || format!("the basis for {} directions up to degree {max_degree}", directions.len());
        let report = report.with_context(what)?;
        report.warnings.iter().for_each(|warning| self.warn(warning));
        Ok((report, seconds))
    }

    /// Returns the settings of a fit.
    pub(crate) fn params(&self, method: Method, max_degree: usize) -> IrfParams {
        IrfParams {
            max_degree,
            method,
            refinements: if method == Method::Nlsf { REFINEMENTS } else { 0 },
            memory: self.memory,
            held: self.held,
            threads: self.threads,
            ..IrfParams::default()
        }
    }

    /// Fits a surface. Returns the accuracy and the cumulative seconds after each sweep, and the final coefficients.
    /// Only the sweeps are timed, including reading the basis.
    pub(crate) fn fit(
        &self,
        operator: &DiskOperator,
        surface: &Surface,
        method: Method,
        max_degree: usize,
    ) -> Result<(Vec<Measured>, Coefficients)> {
        let what = || format!("{}: {} to degree {max_degree}", surface.name, method.name());
        let mut fitter = IrfSolver::new(operator, 3, self.params(method, max_degree)).with_context(what)?;
        let values = ArrayView2::from_shape((surface.vertices.len(), 3), surface.vertices.as_flattened())?;
        let targets = ChunkedRows::from_array(values, operator.chunk_rows());
        let fit = fitter.fit(targets, std::slice::from_ref(&(0..3)), self.monitor);
        let fit = fit.with_context(what)?;
        self.warn_of_rank(surface, &fit.report);
        Ok((measured(&fit.report, surface.scale), fit.coefficients))
    }

    fn warn_of_rank(&self, surface: &Surface, report: &IrfReport) {
        for block in report.blocks.iter().filter(|block| block.rank < block.columns) {
            self.warn(format!(
                "{}: the basis of degrees {} to {} has rank {}, but {} columns; the solution of minimum norm was used",
                surface.name, block.first_degree, block.last_degree, block.rank, block.columns
            ));
        }
    }
}

fn measured(report: &IrfReport, scale: f64) -> Vec<Measured> {
    let mut seconds = 0.0;
    let sweeps = report.history.iter().filter_map(|sweep| {
        seconds += sweep.seconds;
        let residual = sweep.residuals.first()?;
        let square = scale * scale;
        let quality = Quality { msd: residual.mean_square / square, xsd: residual.max_square / square };
        Some(Measured { quality, seconds })
    });
    sweeps.collect()
}
