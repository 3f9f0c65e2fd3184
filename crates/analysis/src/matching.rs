//! `shape match`: finds the nearest models of a library.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::json;
use spharm::shape::memory::align_bytes;
use spharm::shape::{AlignParams, Descriptors, Library, Match, Metric, align, descriptors};
use spharm::{Coefficients, Model, Silent};
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::OutputFile;
use spharm_cli::paths::shown;
use spharm_monitor::number;

use super::args::{By, Models, ReportArgs, Resources, files, read_all};
use super::describe::{common_degree, of};
use super::outputs::{TABLES, check, exact, finish, table_for, write_text};
use super::plan::Plan;

/// Find the models that are nearest to a given model
///
/// Models are first ranked by the singular values of each degree, which don't depend on pose. The distance between the
/// singular values of two models is a lower bound of the root mean square distance between their points at equal
/// directions. The bound holds in any pose, for any rotation of the sphere, and for mirror images. Then the candidates
/// with the smallest bounds are aligned, and ordered by the root mean square distance, in the surfaces' unit. Signals
/// aren't aligned.
///
/// These distances depend on the maps to the sphere. Fit meshes with `spharm fit --area 0`: by default, maps also
/// depend on the triangles, and models of meshes of equal resolution may be nearer than models of equal shape.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape match bunny.spharm.npz --among models --top 5",
        "spharm shape match left.spharm.npz right.spharm.npz --among @group.txt --unit-size -o nearest.csv",
    ],
    &[],
))]
pub(super) struct Cli {
    #[command(flatten)]
    queries: Models,
    /// Models to search: files, folders or @LIST
    #[arg(long, value_name = "MODEL", num_args = 1.., required = true, help_heading = INPUT)]
    among: Vec<PathBuf>,
    /// Maximum number of matches shown
    #[arg(long, value_name = "N", default_value_t = 5, help_heading = METHOD)]
    top: usize,
    /// Highest degree to compare [default: the smallest of the models' degrees]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Compare models scaled to size 1
    #[arg(long, help_heading = METHOD)]
    unit_size: bool,
    /// Quantity by which models are ordered
    ///
    /// standardized divides each singular value by its standard deviation over the searched models, so that high
    /// degrees, whose values are small, weigh as much as low degrees. Small differences between maps then have this
    /// weight too. Therefore, use standardized only for meshes of about the same resolution, even with --area 0.
    #[arg(long, value_enum, value_name = "METRIC", default_value_t = By::Distance, help_heading = METHOD)]
    metric: By,
    /// Maximum number of candidates to align; 0 for none
    #[arg(long, value_name = "N", default_value_t = 20, help_heading = METHOD)]
    align: usize,
    /// Also match mirror images
    #[arg(long, help_heading = METHOD)]
    mirror: bool,
    /// Table to write
    #[arg(short, long, value_name = "OUT.csv|tsv", help_heading = OUTPUT)]
    output: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

const COLUMNS: [&str; 6] = ["query", "rank", "model", "distance", "bound", "score"];

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let (queries, among) = (cli.queries.paths()?, files(&cli.among)?);
    check(cli.output.iter().map(|path| OutputFile::with_ending(path, "--output", &TABLES)), &cli.report)?;
    let plan = Plan::new("match", &among, cli.resources.both())?;
    // Memory for three copies of the descriptors (as read, at a common degree, and in the library), and for one
    // alignment per thread.
    let numbers = ((among.len() + queries.len()) * (1 + plan.group.channels) * (plan.group.max_degree + 1)) as u64;
    let aligning = align_bytes(plan.group.max_degree).saturating_add(2 * plan.one());
    plan.check(aligning.saturating_mul(plan.threads as u64) + 40 * numbers, [])?;
    let pool = cli.resources.threads.pool()?;
    let read =
        |paths: &[PathBuf]| pool.install(|| read_all(paths, monitor, |model, path| of(model, path, cli.max_degree)));
    let started = Instant::now();
    let (of_queries, of_library) = (read(&queries)?, read(&among)?);
    let reading = started.elapsed().as_secs_f64();
    // Compare all models at the lowest degree among the queries and the library.
    let (degree, warning) = common_degree(of_queries.iter().chain(&of_library));
    let warnings: Vec<String> = warning.into_iter().collect();
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    let of_library: Vec<Descriptors> = of_library.iter().map(|model| model.up_to(degree)).collect();
    let library = Library::new(&of_library, cli.unit_size)?;
    let started = Instant::now();
    let mut rows = vec![COLUMNS.map(str::to_owned).to_vec()];
    let mut cells = Vec::new();
    let mut reports = Vec::new();
    let metric = cli.metric.metric();
    for (path, query) in queries.iter().zip(&of_queries) {
        let surfaces = query.channels == 3 && cli.align > 0 && metric == Metric::Distance;
        let search = || -> Result<Vec<Match>> {
            if !surfaces {
                return Ok(library.nearest(query, cli.top, metric)?);
            }
            let model = pose_of(&Model::read(path)?.coefficients, cli.unit_size)?;
            let params = AlignParams { max_degree: Some(degree), mirror: cli.mirror, ..AlignParams::default() };
            library.refined(query, cli.top, cli.align.max(cli.top), |index| {
                spharm::Monitor::check(monitor)?;
                let other = pose_of(&Model::read(&among[index])?.coefficients, cli.unit_size)?;
                Ok(align(&other, &model, &params, &Silent)?.report.rmsd_after)
            })
        };
        let found = pool.install(search).with_context(|| path.display().to_string())?;
        for (rank, found) in found.iter().enumerate() {
            let of = |text: fn(f64) -> String| {
                let model = among[found.index].display().to_string();
                vec![
                    path.display().to_string(),
                    (rank + 1).to_string(),
                    model,
                    found.distance.map(text).unwrap_or_default(),
                    text(found.bound),
                    text(found.score),
                ]
            };
            rows.push(of(number));
            cells.push(of(exact));
        }
        let matches = found.iter().map(|found| {
            json!({
                "model": shown(&among[found.index]),
                "distance": found.distance,
                "bound": found.bound,
                "score": found.score,
            })
        });
        reports.push(json!({ "query": shown(path), "matches": matches.collect::<Vec<_>>() }));
    }
    let searching = started.elapsed().as_secs_f64();
    if let Some(path) = &cli.output {
        write_text(path, cli.report.force, &table_for(Some(path), &COLUMNS, cells.iter().map(Vec::as_slice)))?;
    }
    let report = json!({
        "degree": degree,
        "unit_size": cli.unit_size,
        "metric": cli.metric.name(),
        "models": among.len(),
        "queries": reports,
        "warnings": warnings,
        "seconds": { "read": reading, "search": searching },
    });
    finish("match", &report, &rows, &cli.report)
}

/// Returns a model's coefficients, scaled to size 1 if `unit_size` is true.
fn pose_of(model: &Coefficients, unit_size: bool) -> Result<Coefficients> {
    if !unit_size {
        return Ok(model.clone());
    }
    let size = descriptors(model)?.size();
    let scale = if size > 0.0 { 1.0 / size } else { 1.0 };
    Ok(Coefficients::new(model.values() * scale)?)
}
