//! `--factor`: the Cholesky factor of the scheme's normal equations.

use std::path::PathBuf;

use anyhow::Result;
use serde::Serialize;
use spharm_cli::console::Console;
use spharm_cli::machine::check_limits;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::size::Size;
use spharm_solver::cholesky::{FactorParams, FactorReport, build_factor, plan_stored_factor};
use spharm_solver::gram::{Penalised, smoothness_penalty};
use spharm_solver::{SolverError, moment_gram, moment_gram_bytes};
use spharm_store::factor::open_factor;
use spharm_store::{FactorFile, FactorSpec, Scalar, SchemeKey, StoreError, WeightsHash};
use spharm_surface::Sphere;

use super::Cli;

/// Below this a solve loses so many digits that it should be known.
const ILL_CONDITIONED: f64 = 1e-12;

/// What the report says of a factor.
#[derive(Debug, Serialize)]
pub(super) struct FactorRow {
    pub(super) path: PathBuf,
    pub(super) max_degree: usize,
    pub(super) columns: usize,
    pub(super) dtype: &'static str,
    pub(super) smoothness: f64,
    pub(super) present: bool,
    pub(super) bytes: u64,
    pub(super) norm: f64,
    pub(super) reciprocal_condition: f64,
    pub(super) planned_memory: usize,
}

/// A factor that was asked for.
pub(super) struct Job<'a> {
    cli: &'a Cli,
    sphere: &'a Sphere,
    console: &'a Console,
    spec: FactorSpec,
    params: FactorParams,
}

impl<'a> Job<'a> {
    /// From the arguments; says what it takes, and refuses what there is no memory or disk for, before any work.
    pub(super) fn new(
        cli: &'a Cli,
        sphere: &'a Sphere,
        console: &'a Console,
        scalar: Scalar,
        max_degree: usize,
    ) -> Result<Self> {
        let rows = sphere.directions.len();
        let spec = FactorSpec {
            key: SchemeKey::of(&sphere.directions, scalar),
            rows,
            max_degree,
            weights: WeightsHash::ONES,
            smoothness: cli.smoothness,
        };
        let threads = cli.threads.count();
        let held = moment_gram_bytes(rows, max_degree)?;
        let params = FactorParams {
            scalar: cli.factor_dtype.scalar(),
            memory: cli.memory.0,
            // The sphere's directions and triangles beside the source.
            held: held + 24 * rows + 12 * sphere.faces.len(),
            threads,
            allow_large: cli.yes,
            ..FactorParams::default()
        };
        let job = Self { cli, sphere, console, spec, params };
        if job.there().is_none() {
            let (plan, _) = plan_stored_factor(&cli.store, spec.size(), &job.params)?;
            check_limits(plan.memory, 0)?;
            let way = if plan.in_memory { "in memory" } else { "out of core" };
            let (memory, disk) = (Size(plan.memory), Size(plan.disk as usize));
            console
                .note(format!("factor of degree {max_degree}: {way}, {memory} of memory and {disk} of disk planned"));
        }
        Ok(job)
    }

    /// The factor, when it is there and sound.
    fn there(&self) -> Option<FactorFile> {
        open_factor(&self.cli.store, &self.spec, Some(self.params.scalar)).ok()
    }

    /// Computes and publishes it, unless it is there.
    pub(super) fn run(&self) -> Result<FactorRow> {
        let Self { cli, sphere, console, spec, params } = self;
        let source = moment_gram(&sphere.directions, None, spec.max_degree)?;
        let penalised = Penalised::new(&source, smoothness_penalty(spec.max_degree, spec.smoothness));
        let report = build_factor(&cli.store, spec, &penalised, params, &ConsoleMonitor::new(**console));
        let report = report.map_err(|error| match error {
            // No model is finished, but a basis may be.
            SolverError::Interrupted(interrupted) => StoreError::from(interrupted).into(),
            error => error,
        })?;
        for warning in &report.warnings {
            console.warn(warning);
        }
        if report.present {
            console.note(format!("{}: the factor is there already", report.file.path().display()));
        }
        let row = row(&report);
        if row.reciprocal_condition < ILL_CONDITIONED {
            console.warn(format!(
                "the normal equations are ill-conditioned (about {:.0e}): solutions lose that many digits; --smoothness mends it",
                1.0 / row.reciprocal_condition
            ));
        }
        Ok(row)
    }
}

fn row(report: &FactorReport) -> FactorRow {
    let header = report.file.header();
    FactorRow {
        path: report.file.path().to_path_buf(),
        max_degree: header.spec.max_degree,
        columns: header.grid.size(),
        dtype: header.scalar.name(),
        smoothness: header.spec.smoothness,
        present: report.present,
        bytes: report.file.file_len(),
        norm: header.condition.norm,
        reciprocal_condition: header.condition.reciprocal,
        planned_memory: report.memory,
    }
}
