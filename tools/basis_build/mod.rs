//! `basis-build`: computes the basis of a sampling scheme and the factor of its normal equations, and writes both into
//! a store.

mod args;
mod output;

use std::time::Instant;

use anyhow::Result;
use spharm::factor::{FactorSettings, PlannedFactor, ill_conditioned};
use spharm_cli::console::Console;
use spharm_cli::inputs::read_sphere;
use spharm_cli::machine::{memory, raise_file_limit};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, is_stdout, print, print_json, table, write_json};
use spharm_cli::size::Size;
use spharm_store::{BuildParams, BuildReport, Scalar, SchemeKey, build};
use spharm_surface::Sphere;

pub(crate) use self::args::Cli;
use self::output::{Basis, FactorRow, Report, lines};

/// Runs the verb `basis-build`.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    let console = cli.common.console();
    // From here on, a signal such as Ctrl-C requests an orderly stop.
    spharm_cli::exit::cancel();
    raise_file_limit();
    let report_file = cli.report.as_ref().or(cli.json_file.as_ref());
    check_outputs(report_file.map(|path| OutputFile::new(path, "--report")), cli.force)?;
    let sphere = read_sphere(&cli.sphere, false, &console)?;
    let params = BuildParams {
        // --max-degree may be missing only with --factor-only, which builds no basis.
        max_degree: cli.max_degree.unwrap_or_default(),
        scalar: cli.dtype.scalar(),
        codec: cli.codec.codec(),
        chunk_rows: cli.chunk_rows,
        memory: cli.memory.0,
        threads: cli.threads.count(),
        allow_large: cli.yes,
    };
    let pool = cli.threads.pool()?;
    // Before the basis is built, report and check the memory and disk space that the factor needs.
    let factor = cli.factor.map(|degree| plan_factor(cli, &sphere, params.scalar, degree, &console)).transpose()?;
    let basis = (!cli.factor_only).then(|| pool.install(|| basis(cli, &sphere, &params, &console))).transpose()?;
    let factor = factor.map(|planned| pool.install(|| factor_row(&planned, &console))).transpose()?;
    if basis.as_ref().is_some_and(|report| report.present > 0) || factor.as_ref().is_some_and(|row| row.present) {
        console.note(format!(
            "existing files were opened but not read completely; `spharm store verify {}` checks every byte",
            cli.store.display()
        ));
    }
    let key = SchemeKey::of(&sphere.directions, params.scalar);
    let report = Report {
        tool: "basis-build",
        versions: spharm::versions(),
        sphere: cli.sphere.clone(),
        scheme_key: key.to_string(),
        folder: cli.store.join(key.to_string()),
        directions: sphere.directions.len(),
        dtype: params.scalar.name(),
        threads: basis.as_ref().map_or(params.threads, |report| report.threads),
        basis: basis.as_ref().map(|report| Basis::new(report, &params)),
        factor,
        memory: memory(),
        seconds: started.elapsed().as_secs_f64(),
    };
    if let Some(path) = report_file {
        write_json(path, cli.force, &report)?;
    }
    match report_file {
        Some(path) if is_stdout(path) => Ok(()),
        None if cli.json => print_json(&report),
        _ => print(&table(&lines(&report))),
    }
}

fn basis(cli: &Cli, sphere: &Sphere, params: &BuildParams, console: &Console) -> Result<BuildReport> {
    let report = build(&cli.store, &sphere.directions, params, &ConsoleMonitor::new(*console))?;
    report.warnings.iter().for_each(|warning| console.warn(warning));
    let planned = Size(report.memory);
    console.detail(format!(
        "{} threads, {planned} of memory planned, chunks of {} rows",
        report.threads, report.chunk_rows
    ));
    Ok(report)
}

/// Prints the memory and disk space that the factor needs, before anything is built.
fn plan_factor<'a>(
    cli: &'a Cli,
    sphere: &'a Sphere,
    basis_scalar: Scalar,
    max_degree: usize,
    console: &Console,
) -> Result<PlannedFactor<'a>> {
    let settings = FactorSettings {
        max_degree,
        basis_scalar,
        scalar: cli.factor_dtype.scalar(),
        smoothness: cli.smoothness,
        memory: cli.memory.0,
        threads: cli.threads.count(),
        allow_large: cli.yes,
    };
    let planned = PlannedFactor::new(&cli.store, sphere, &settings)?;
    if let Some(plan) = planned.plan() {
        let place = if plan.in_memory { "in memory" } else { "out of core" };
        let (memory, disk) = (Size(plan.memory), Size(plan.disk as usize));
        console.note(format!(
            "factor of degree {max_degree}, computed {place}: {memory} of memory and {disk} of disk space planned"
        ));
    }
    Ok(planned)
}

fn factor_row(planned: &PlannedFactor<'_>, console: &Console) -> Result<FactorRow> {
    let report = planned.build(&ConsoleMonitor::new(*console))?;
    report.warnings.iter().for_each(|warning| console.warn(warning));
    if report.present {
        console.note(format!("{}: the factor already exists", report.file.path().display()));
    }
    if let Some(condition) = ill_conditioned(&report) {
        console.warn(format!(
            "the normal equations are ill-conditioned (condition number about {condition:.0e}), so solutions lose most \
             of their digits; --smoothness lowers the condition number"
        ));
    }
    Ok(FactorRow::from(&report))
}
