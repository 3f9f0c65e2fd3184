//! `shape sample`: generates shapes from a shape model.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::json;
use spharm::model::made;
use spharm::shape::pca::file::ShapeModel;
use spharm::shape::pca::quality::normal;
use spharm::{Coefficients, Kind};
use spharm_cli::Usage;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::{Memory, round_numbers_below};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::{all_shown, shown};

use super::args::ReportArgs;
use super::outputs::{check, finish};

/// Generate shapes from a shape model: along its modes, or at random
///
/// --mode 1=2 makes the shape two standard deviations from the mean along the first mode. --random N, instead of
/// --mode, makes N shapes whose scores are normally distributed with the modes' variances.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape sample group.shape-model.npz --mode 1=-3 -o minus3.spharm.npz",
        "spharm shape sample group.shape-model.npz --mode 1=2 --mode 3=-1 -o shape.spharm.npz",
        "spharm shape sample group.shape-model.npz --random 100 --seed 1 -o shapes",
    ],
    &[],
))]
pub(super) struct Cli {
    /// Shape model, as `spharm shape pca` writes it
    #[arg(value_name = "MODEL.shape-model.npz", help_heading = INPUT)]
    model: PathBuf,
    /// Mode, counted from 1, and the number of standard deviations to move along the mode
    #[arg(long, value_name = "MODE=SD", value_parser = mode, allow_hyphen_values = true, help_heading = METHOD)]
    mode: Vec<(usize, f64)>,
    /// Number of random shapes, written to a folder
    #[arg(long, value_name = "N", conflicts_with = "mode", help_heading = METHOD)]
    random: Option<usize>,
    /// Seed of random shapes
    #[arg(long, value_name = "SEED", default_value_t = 0, requires = "random", help_heading = METHOD)]
    seed: u64,
    /// Model to write; with --random, a folder
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    memory: Memory,
}

fn mode(text: &str) -> Result<(usize, f64), String> {
    let (mode, deviations) = text.split_once('=').ok_or("expected MODE=SD, such as 1=2")?;
    let mode = mode.trim().parse().ok().filter(|mode| *mode > 0).ok_or("expected a mode's number, counted from 1")?;
    let deviations = deviations.trim().parse().ok().filter(|number: &f64| number.is_finite());
    Ok((mode, deviations.ok_or("expected a number of standard deviations")?))
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, _: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let budget = cli.memory.budget(1);
    budget.check_inputs("shape sample", [cli.model.as_path()])?;
    let file = ShapeModel::read(&cli.model)?;
    let modes = &file.modes;
    let shapes: Vec<(PathBuf, Vec<f64>)> = match cli.random {
        Some(0) => return Err(Usage::invalid("--random: expected at least 1 shape, found 0").into()),
        Some(count) => {
            // Memory for the scores of each shape, and for their text in the report.
            let needed = |count: u64| (64 * modes.count() as u64 + 400).saturating_mul(count);
            let fewer = round_numbers_below(count as u64).map(|n| (format!("--random {n}"), needed(n)));
            budget.check_or(format_args!("shape sample --random {count}"), needed(count as u64), fewer)?;
            let digits = (count - 1).to_string().len();
            let path = |index: usize| cli.output.join(format!("shape{index:0digits$}.spharm.npz"));
            (0..count).map(|index| (path(index), normal(cli.seed, index as u64, modes.count()))).collect()
        }
        None => {
            let mut deviations = vec![0.0; cli.mode.iter().map(|(mode, _)| *mode).max().unwrap_or(0)];
            cli.mode.iter().for_each(|(mode, number)| deviations[mode - 1] += number);
            vec![(cli.output.clone(), deviations)]
        }
    };
    check(shapes.iter().map(|(path, _)| OutputFile::with_ending(path, "--output", &[".npz"])), &cli.report)?;
    for (path, deviations) in &shapes {
        let shape = modes.shape(deviations).with_context(|| cli.model.display().to_string())?;
        let mut model = made(Coefficients::new(shape)?, Kind::Surface, "shape sample");
        model.provenance.other.insert("standard_deviations".to_owned(), json!(deviations));
        prepare(path)?;
        model.write_with(path, cli.report.force)?;
    }
    let report = json!({
        "model": shown(&cli.model),
        "outputs": all_shown(shapes.iter().map(|(path, _)| path)),
        "standard_deviations": shapes.iter().map(|(_, deviations)| deviations).collect::<Vec<_>>(),
        "seed": cli.random.map(|_| cli.seed),
        "seconds": started.elapsed().as_secs_f64(),
    });
    let line = match cli.random {
        Some(count) => format!("{}: {count} random shapes with seed {}", cli.output.display(), cli.seed),
        None => cli.output.display().to_string(),
    };
    finish("sample", &report, &[vec![line]], &cli.report)
}
