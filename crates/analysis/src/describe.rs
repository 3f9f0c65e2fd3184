//! `shape describe`: a table of rotation-invariant descriptors.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use serde_json::json;
use spharm::shape::{Descriptors, descriptors};
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, counted, is_stdout, print};
use spharm_cli::paths::{distinct_names, shown};
use spharm_model::Model;

use super::args::{Models, ReportArgs, Resources, read_all, to_degree};
use super::outputs::{TABLES, check, exact, finish, table_for, write_report, write_text};
use super::plan::Plan;

/// Describe models by rotation-invariant numbers
///
/// The table has one row per model: the model's size (root mean square distance from its mean position), the power of
/// each degree and the singular values of each degree's coefficients. These numbers don't change if the surface is
/// rotated, reflected or translated, or if its sphere is rotated, but they depend on the map to the sphere. To compare
/// models, fit their meshes with `spharm fit --area 0`: maps made with other settings also depend on the triangles.
/// Without --output, the table is printed.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape describe @group.txt -o descriptors.csv",
        "spharm shape describe models --max-degree 12 --unit-size --only power",
    ],
    &[],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    /// Highest degree [default: the smallest of the models' degrees]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Scale models to size 1
    #[arg(long, help_heading = METHOD)]
    unit_size: bool,
    /// Write only this kind of descriptor
    #[arg(long, value_enum, value_name = "KIND", help_heading = METHOD)]
    only: Option<Kind>,
    /// Table to write
    #[arg(short, long, value_name = "OUT.csv|tsv", help_heading = OUTPUT)]
    output: Option<PathBuf>,
    /// Name models in the table by file name, such as a01, instead of by path
    #[arg(long, help_heading = OUTPUT)]
    names: bool,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Kind {
    Power,
    SingularValues,
}

/// Computes the descriptors of a model up to a degree, by default up to the model's own degree.
pub(super) fn of(model: &Model, path: &Path, degree: Option<usize>) -> Result<Descriptors> {
    let coefficients = to_degree(model, path, degree)?;
    descriptors(&coefficients).with_context(|| path.display().to_string())
}

/// Returns the lowest of the models' degrees, up to which the models are compared, and a warning if some models have a
/// higher degree.
pub(super) fn common_degree<'a>(models: impl IntoIterator<Item = &'a Descriptors>) -> (usize, Option<String>) {
    let degrees: Vec<usize> = models.into_iter().map(Descriptors::max_degree).collect();
    let lowest = degrees.iter().copied().min().unwrap_or(0);
    let highest = degrees.into_iter().max().unwrap_or(0);
    let warning = (highest > lowest).then(|| {
        format!("the models have degrees from {lowest} to {highest}; they are compared up to degree {lowest}")
    });
    (lowest, warning)
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let paths = cli.models.paths()?;
    let names = match cli.names {
        true => distinct_names(&paths, "--names")?,
        false => paths.iter().map(|path| path.display().to_string()).collect(),
    };
    check(cli.output.iter().map(|path| OutputFile::with_ending(path, "--output", &TABLES)), &cli.report)?;
    let plan = Plan::new("describe", &paths, cli.resources.both())?;
    // Memory for the descriptors, and for the text of the table's cells.
    let numbers = (paths.len() * (1 + plan.group.channels) * (plan.group.max_degree + 1)) as u64;
    plan.check(plan.one().saturating_mul(plan.threads as u64) + 130 * numbers, [])?;
    let pool = cli.resources.threads.pool()?;
    let found = pool.install(|| read_all(&paths, monitor, |model, path| of(model, path, cli.max_degree)))?;
    let degree = found.iter().map(Descriptors::max_degree).min().unwrap_or(0);
    let highest = found.iter().map(Descriptors::max_degree).max().unwrap_or(0);
    let mut warnings = Vec::new();
    if highest > degree {
        warnings.push(format!(
            "the models have degrees from {degree} to {highest}; the table has only the degrees up to {degree}"
        ));
        warnings.iter().for_each(|warning| monitor.console().warn(warning));
    }
    let channels = found.first().map_or(0, |first| first.channels);
    if let Some(other) = found.iter().position(|model| model.channels != channels) {
        anyhow::bail!(
            "{}: expected {}, as in {}; found {}",
            paths[other].display(),
            counted(channels, "channel"),
            paths[0].display(),
            found[other].channels
        );
    }
    let row = |(model, name): (&Descriptors, &String)| -> Vec<String> {
        let (model, size) = (model.up_to(degree), model.size());
        let model = if cli.unit_size { model.unit_size() } else { model };
        let power = model.power.iter().filter(|_| cli.only != Some(Kind::SingularValues));
        let values = model.singular_values.iter().filter(|_| cli.only != Some(Kind::Power));
        let numbers = std::iter::once(size).chain(power.chain(values).copied()).map(exact);
        std::iter::once(name.clone()).chain(numbers).collect()
    };
    let rows: Vec<Vec<String>> = found.iter().zip(&names).map(row).collect();
    let header = header(degree, channels, cli.only);
    let columns: Vec<&str> = header.iter().map(String::as_str).collect();
    let text = table_for(cli.output.as_deref(), &columns, rows.iter().map(Vec::as_slice));
    if let Some(path) = &cli.output {
        write_text(path, cli.report.force, &text)?;
    }
    let seconds = started.elapsed().as_secs_f64();
    let report = json!({
        "output": cli.output.as_ref().map(shown),
        "models": paths.len(),
        "degree": degree,
        "channels": channels,
        "unit_size": cli.unit_size,
        "warnings": warnings,
        "seconds": seconds,
    });
    let Some(path) = &cli.output else {
        write_report("describe", &report, &cli.report)?;
        let instead = cli.report.report.as_deref().is_some_and(is_stdout);
        return if instead { Ok(()) } else { print(text.trim_end()) };
    };
    let line = format!("{}: {} models, degree {degree}, {seconds:.2} s", path.display(), paths.len());
    finish("describe", &report, &[vec![line]], &cli.report)
}

fn header(degree: usize, channels: usize, only: Option<Kind>) -> Vec<String> {
    let mut names = vec!["model".to_owned(), "size".to_owned()];
    if only != Some(Kind::SingularValues) {
        names.extend((1..=degree).map(|l| format!("power_{l}")));
    }
    if only != Some(Kind::Power) {
        names.extend((1..=degree).flat_map(|l| (1..=channels).map(move |k| format!("singular_value_{l}_{k}"))));
    }
    names
}
