//! `shape pca`: computes modes of variation.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use clap::Args;
use ndarray::ArrayView2;
use serde_json::json;
use spharm::Kind;
use spharm::shape::Modes;
use spharm::shape::pca::file::ShapeModel;
use spharm::shape::pca::quality::{Quality, quality};
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::memory::round_numbers_below;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::{all_shown, distinct_names, shown};
use spharm_monitor::number;

use super::args::{Models, ReportArgs, Resources};
use super::groups::read_group;
use super::outputs::{TABLES, check_beside, exact, finish, table_for, write_text};
use super::plan::Plan;

/// Compute a group's modes of variation: principal components
///
/// The models have to correspond, as after `spharm shape align --group`; their position in space is ignored. Writes a
/// shape model: mean, modes, variances and the members' scores. `spharm shape sample` generates shapes from this shape
/// model.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape pca aligned -o group.shape-model.npz",
        "spharm shape pca @group.txt --modes 10 --quality --scores scores.csv -o group.shape-model.npz",
    ],
    &[
        "Generalisation is the mean distance between a member and the nearest shape that the modes of the other \
         members can form. Specificity is the mean distance between a random shape and the nearest member. Both are in \
         the surfaces' unit, with 1, 2, ... modes; lower is better.",
    ],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    /// Highest degree [default: the smallest of the models' degrees]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Maximum number of modes to write [default: all, one fewer than there are models]
    #[arg(long, value_name = "N", help_heading = METHOD)]
    modes: Option<usize>,
    /// Measure generalisation and specificity
    #[arg(long, help_heading = METHOD)]
    quality: bool,
    /// Number of random shapes for the specificity
    #[arg(long, value_name = "N", default_value_t = 2000, requires = "quality", help_heading = METHOD)]
    samples: usize,
    /// Seed of the random shapes
    #[arg(long, value_name = "SEED", default_value_t = 0, requires = "quality", help_heading = METHOD)]
    seed: u64,
    /// Shape model to write
    #[arg(short, long, value_name = "OUT.shape-model.npz", help_heading = OUTPUT)]
    output: PathBuf,
    /// File for the table of the members' scores
    #[arg(long, value_name = "OUT.csv|tsv", help_heading = OUTPUT)]
    scores: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let paths = cli.models.paths()?;
    if cli.scores.is_some() {
        distinct_names(&paths, "--scores")?;
    }
    let table = cli.scores.iter().map(|path| OutputFile::with_ending(path, "--scores", &TABLES));
    check_beside(&paths, table.chain([OutputFile::with_ending(&cli.output, "--output", &[".npz"])]), &cli.report)?;
    let plan = Plan::new("pca", &paths, cli.resources.both())?;
    let needed = |samples: usize| plan.coefficients().saturating_add(plan.group.modes(samples, plan.threads));
    let (samples, most) = if cli.quality { (cli.samples, cli.samples as u64) } else { (0, 0) };
    let fewer = round_numbers_below(most).map(|n| (format!("--samples {n}"), needed(n as usize)));
    plan.check(needed(samples), fewer)?;
    let (group, mut modes, found) = cli.resources.threads.pool()?.install(|| -> Result<_> {
        let group = read_group(&paths, Kind::Surface, cli.max_degree, monitor, monitor.console())?;
        let members: Vec<ArrayView2<'_, f64>> = group.members.iter().map(|member| member.values().view()).collect();
        let modes = Modes::new(&members, usize::MAX)?;
        let found = cli.quality.then(|| quality(&modes, cli.samples, cli.seed, monitor)).transpose()?;
        Ok((group, modes, found))
    })?;
    modes.truncate(cli.modes.unwrap_or(usize::MAX));
    let provenance = json!({ "tool": "shape pca", "versions": spharm::versions(), "degree": group.degree });
    let file = ShapeModel { modes, members: group.names, provenance: provenance.to_string() };
    prepare(&cli.output)?;
    file.write(&cli.output, cli.report.force)?;
    if let Some(path) = &cli.scores {
        let header: Vec<String> =
            std::iter::once("model".to_owned()).chain((1..=file.modes.count()).map(|k| format!("mode_{k}"))).collect();
        let row = |(name, scores): (&String, ndarray::ArrayView1<'_, f64>)| -> Vec<String> {
            std::iter::once(name.clone()).chain(scores.iter().map(|score| exact(*score))).collect()
        };
        let rows: Vec<Vec<String>> = file.members.iter().zip(file.modes.scores.rows()).map(row).collect();
        let names: Vec<&str> = header.iter().map(String::as_str).collect();
        write_text(path, cli.report.force, &table_for(Some(path), &names, rows.iter().map(Vec::as_slice)))?;
    }
    let report = json!({
        "output": shown(&cli.output),
        "scores": cli.scores.as_ref().map(shown),
        "models": all_shown(&paths),
        "degree": group.degree,
        "modes": file.modes.count(),
        "total_variance": file.modes.total_variance,
        "variances": file.modes.variances,
        "shares": file.modes.shares(),
        "compactness": file.modes.compactness(),
        "generalisation": found.as_ref().map(|found| &found.generalisation),
        "specificity": found.as_ref().map(|found| &found.specificity),
        "warnings": group.warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    finish("pca", &report, &rows(&file.modes, found.as_ref()), &cli.report)
}

fn rows(modes: &Modes, quality: Option<&Quality>) -> Vec<Vec<String>> {
    let mut names = vec!["mode", "standard deviation", "share", "cumulative"];
    if quality.is_some() {
        names.extend(["generalisation", "specificity"]);
    }
    let mut rows = vec![names.into_iter().map(str::to_owned).collect()];
    // The report has all modes, the printed table only the first 20.
    for (k, (share, cumulative)) in modes.shares().into_iter().zip(modes.compactness()).enumerate().take(20) {
        let deviation = modes.variances[k].sqrt();
        let percent = |share: f64| format!("{:.1} %", 100.0 * share);
        let mut row = vec![(k + 1).to_string(), number(deviation), percent(share), percent(cumulative)];
        row.extend(quality.map(|found| number(found.generalisation[k])));
        row.extend(quality.map(|found| number(found.specificity[k])));
        rows.push(row);
    }
    rows
}
