//! `shape mean`: computes the mean of a group.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use serde_json::json;
use spharm::Kind;
use spharm::model::made;
use spharm::shape::{mean, rmsd};
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::{all_shown, shown};
use spharm_monitor::number;

use super::args::{Models, ReportArgs, Resources};
use super::groups::read_group;
use super::outputs::{check_beside, finish};
use super::plan::Plan;

/// Average models of surfaces
///
/// Computes the mean of the coefficients. The models must correspond, for example after `spharm shape align --group`,
/// or because their spheres are registered, as for cortical surfaces. Prints each model's distance from the mean.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(&["spharm shape mean aligned -o mean.spharm.npz"], &[]))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    /// Highest degree [default: the smallest of the models' degrees]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Model to write
    #[arg(short, long, value_name = "OUT.spharm.npz", help_heading = OUTPUT)]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let paths = cli.models.paths()?;
    if paths.len() < 2 {
        bail!("expected at least 2 models to average, found {}", paths.len());
    }
    check_beside(&paths, [OutputFile::with_ending(&cli.output, "--output", &[".npz"])], &cli.report)?;
    let plan = Plan::new("mean", &paths, cli.resources.both())?;
    plan.check(plan.coefficients(), [])?;
    let read = || read_group(&paths, Kind::Surface, cli.max_degree, monitor, monitor.console());
    let group = cli.resources.threads.pool()?.install(read)?;
    let mean = mean(&group.members)?;
    let distances: Vec<f64> = group.members.iter().map(|member| rmsd(member, &mean)).collect::<Result<_, _>>()?;
    let mut model = made(mean, Kind::Surface, "shape mean");
    model.provenance.other.insert("members".to_owned(), json!(group.names));
    prepare(&cli.output)?;
    model.write_with(&cli.output, cli.report.force)?;
    let mut rows = vec![["model", "distance from the mean"].map(str::to_owned).to_vec()];
    rows.extend(group.names.iter().zip(&distances).map(|(name, distance)| vec![name.clone(), number(*distance)]));
    let square = distances.iter().map(|distance| distance * distance).sum::<f64>();
    // For very large surfaces, the sum of squares may overflow. In this case, compute the root mean square with
    // `hypot`.
    let count = distances.len() as f64;
    let spread = if square.is_finite() {
        (square / count).sqrt()
    } else {
        distances.iter().fold(0.0, |root: f64, distance| root.hypot(*distance)) / count.sqrt()
    };
    rows.push(vec!["root mean square".to_owned(), number(spread)]);
    let report = json!({
        "output": shown(&cli.output),
        "models": all_shown(&paths),
        "degree": group.degree,
        "distances": distances,
        "spread": spread,
        "warnings": group.warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    finish("mean", &report, &rows, &cli.report)
}
