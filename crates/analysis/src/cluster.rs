//! `shape cluster`: groups models by their shapes.

use std::collections::HashSet;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Result, bail};
use clap::Args;
use serde_json::json;
use spharm::shape::{Clusters, Library};
use spharm_cli::Usage;
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::OutputFile;
use spharm_cli::paths::{model_name, shown};
use spharm_monitor::number;

use super::args::{By, Models, ReportArgs, Resources, read_all};
use super::describe::{common_degree, of};
use super::outputs::{TABLES, check, finish, short, table_for, write_text};
use super::plan::Plan;

/// Group models by shape, in any pose
///
/// Compares models by the singular values of each degree, which don't depend on pose, and merges the most similar ones
/// step by step (Ward's linkage). The table states each model's cluster (cluster 1 is the largest) and silhouette. The
/// silhouette is near 1 if the model is much nearer to its own cluster than to the next, near 0 if the model is between
/// two clusters, and below 0 if the model is nearer to another cluster.
///
/// Fit meshes with `spharm fit --area 0`: by default, maps also depend on the triangles, and clusters may group models
/// by the resolution of their meshes instead of by shape.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape cluster cells -o clusters.csv",
        "spharm shape cluster cells --unit-size --clusters 4 -o clusters.csv",
        "spharm picture cells --centre --colour-by clusters.csv:cluster -o montage.png",
    ],
    &["Without --clusters, the number of clusters from 2 to 10 with the largest mean silhouette is chosen. A mean \
       silhouette below 0.25 indicates hardly any structure (Kaufman and Rousseeuw 1990)."],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    /// Number of clusters [default: chosen from 2 to 10]
    #[arg(long, value_name = "N", help_heading = METHOD)]
    clusters: Option<usize>,
    /// Highest degree to compare [default: the smallest of the models' degrees]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Compare models scaled to size 1
    #[arg(long, help_heading = METHOD)]
    unit_size: bool,
    /// Quantity by which models are compared
    ///
    /// distance: a lower bound, for any pose, of the distance between points at equal directions; low degrees
    /// contribute most. standardized: each singular value is divided by its standard deviation; fine detail and small
    /// differences between maps then weigh as much as coarse shape.
    #[arg(long, value_enum, value_name = "METRIC", default_value_t = By::Distance, help_heading = METHOD)]
    metric: By,
    /// Table to write
    #[arg(short, long, value_name = "OUT.csv|tsv", help_heading = OUTPUT)]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

/// Mean silhouette below which the models have almost no cluster structure.
const HARDLY: f64 = 0.25;

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let paths = cli.models.paths()?;
    if paths.len() < 3 {
        bail!("expected three models or more, found {}", paths.len());
    }
    if let Some(wanted) = cli.clusters.filter(|wanted| !(2..=paths.len()).contains(wanted)) {
        return Err(Usage::invalid(format!(
            "--clusters: expected a number from 2 to {}, the number of models, found {wanted}",
            paths.len()
        ))
        .into());
    }
    check([OutputFile::with_ending(&cli.output, "--output", &TABLES)], &cli.report)?;
    let plan = Plan::new("cluster", &paths, cli.resources.both())?;
    let count = paths.len() as u64;
    let numbers = count * ((1 + plan.group.channels) * (plan.group.max_degree + 1)) as u64;
    // Memory for the descriptors, and for two arrays of the distances between all pairs of models.
    let needed = plan.one().saturating_mul(plan.threads as u64).saturating_add(40 * numbers + 8 * count * count);
    plan.check(needed, [])?;
    let pool = cli.resources.threads.pool()?;
    let found = pool.install(|| read_all(&paths, monitor, |model, path| of(model, path, cli.max_degree)))?;
    let (degree, warning) = common_degree(&found);
    let mut warnings: Vec<String> = warning.into_iter().collect();
    let library = Library::new(&found, cli.unit_size)?;
    let found = pool.install(|| library.distances(cli.metric.metric())).clusters(cli.clusters)?;
    if found.mean < HARDLY {
        warnings.push(format!(
            "the mean silhouette is {:.2}: the models hardly form clusters, so the clusters found may be due to \
             chance",
            found.mean
        ));
    }
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    write_text(&cli.output, cli.report.force, &table(cli, &paths, &found))?;
    let sizes = sizes(&found);
    let silhouette = |cluster: usize| {
        let of = found.of.iter().zip(&found.silhouettes).filter(|(own, _)| **own == cluster);
        of.map(|(_, silhouette)| silhouette).sum::<f64>() / sizes[cluster] as f64
    };
    let clusters = found.typical.iter().enumerate().map(|(cluster, typical)| {
        json!({
            "cluster": cluster + 1,
            "models": sizes[cluster],
            "typical": shown(&paths[*typical]),
            "silhouette": silhouette(cluster),
        })
    });
    let report = json!({
        "output": shown(&cli.output),
        "models": paths.len(),
        "degree": degree,
        "unit_size": cli.unit_size,
        "metric": cli.metric.name(),
        "clusters": clusters.collect::<Vec<_>>(),
        "silhouette": found.mean,
        "tried": found.tried.iter().map(|(count, mean)| json!({ "clusters": count, "silhouette": mean })).collect::<Vec<_>>(),
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    let mut rows = vec![["cluster", "models", "most typical", "silhouette"].map(str::to_owned).to_vec()];
    for (cluster, typical) in found.typical.iter().enumerate() {
        let (number_of, name) = ((cluster + 1).to_string(), model_name(&paths[*typical]));
        rows.push(vec![number_of, sizes[cluster].to_string(), name, number(silhouette(cluster))]);
    }
    finish("cluster", &report, &rows, &cli.report)
}

/// Returns the number of models in each cluster.
fn sizes(found: &Clusters) -> Vec<usize> {
    let mut sizes = vec![0; found.typical.len()];
    found.of.iter().for_each(|cluster| sizes[*cluster] += 1);
    sizes
}

/// Returns the text of the table, with a row for each model. A row states the model's name, or the model's path if
/// several models have the same name.
fn table(cli: &Cli, paths: &[PathBuf], found: &Clusters) -> String {
    let names: Vec<String> = paths.iter().map(|path| model_name(path)).collect();
    let different = names.iter().collect::<HashSet<_>>().len() == names.len();
    let row = |(index, path): (usize, &PathBuf)| {
        let cluster = found.of[index];
        let typical = if found.typical[cluster] == index { "yes" } else { "no" };
        let name = if different { names[index].clone() } else { path.display().to_string() };
        vec![name, (cluster + 1).to_string(), short(found.silhouettes[index]), typical.to_owned()]
    };
    let rows: Vec<Vec<String>> = paths.iter().enumerate().map(row).collect();
    table_for(Some(&cli.output), &["model", "cluster", "silhouette", "typical"], rows.iter().map(Vec::as_slice))
}
