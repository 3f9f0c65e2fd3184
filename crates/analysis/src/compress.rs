//! `shape compress`: stores models in few bytes.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::{Value, json};
use spharm::shape::codec::{CompressParams, Target, VERSION, compress};
use spharm::shape::memory::measure_bytes;
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::shown;
use spharm_model::Model;
use spharm_monitor::number;
use spharm_surface::io::write_new;

use super::args::{Models, ReportArgs, Resources};
use super::outputs::{check, finish, outputs};
use super::plan::Plan;

/// Compress models to a given accuracy or file size
///
/// Coefficients are rounded to multiples of a step and encoded; `spharm shape expand` restores models from the files.
/// Give the step, the maximum size of a file, or the maximum distance. This distance is the root mean square distance
/// between the surfaces of the original and the compressed model, measured in both directions, with the bounding box
/// scaled to volume 1. For signals, distance and step are fractions of each channel's standard deviation over the
/// sphere.
///
/// The rounding of the coefficients moves the surface. Compression also loses the model's sphere, including the number,
/// the order and the triangles of the vertices. The expanded model can be evaluated on any sphere (`spharm reconstruct
/// --icosphere N`), but not at the fitted vertices, unless their sphere is given. To keep the vertices, compress the
/// mesh itself.
///
/// The beginning of a file holds a coarser model, which `spharm shape expand --prefix` restores.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape compress bunny.spharm.npz --tolerance 1e-3 -o bunny.sphz",
        "spharm shape compress models --bytes 4000 --bare -o compressed",
        "spharm shape expand bunny.sphz -o bunny.spharm.npz",
    ],
    &[],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    #[command(flatten)]
    target: TargetArgs,
    /// Degrees after which files may be truncated [default: 1, 3, 7, 15, ...]
    ///
    /// The default degrees are at least 256 bytes apart in the file.
    #[arg(long, value_name = "L,L,...", value_delimiter = ',', help_heading = METHOD)]
    levels: Option<Vec<usize>>,
    /// Omit the provenance and the scheme key, which take about 500 bytes
    #[arg(long, help_heading = METHOD)]
    bare: bool,
    /// File to write; for several models, a folder
    #[arg(short, long, value_name = "OUT.sphz", help_heading = OUTPUT)]
    output: PathBuf,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct TargetArgs {
    /// Root mean square distance between the surfaces, with the bounding box scaled to volume 1
    #[arg(long, value_name = "D", help_heading = METHOD)]
    tolerance: Option<f64>,
    /// Maximum size of each file in bytes
    #[arg(long, value_name = "N", help_heading = METHOD)]
    bytes: Option<usize>,
    /// Step to which the coefficients are rounded, with the bounding box scaled to volume 1
    #[arg(long, value_name = "S", help_heading = METHOD)]
    step: Option<f64>,
}

impl TargetArgs {
    fn target(&self) -> Target {
        match (self.tolerance, self.bytes) {
            (Some(tolerance), _) => Target::Tolerance(tolerance),
            (None, Some(bytes)) => Target::Bytes(bytes),
            (None, None) => Target::Step(self.step.unwrap_or(0.0)),
        }
    }
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let paths = cli.models.paths()?;
    let targets = outputs(&cli.models, &paths, &cli.output, "sphz")?;
    check(targets.iter().map(|path| OutputFile::with_ending(path, "--output", &[".sphz"])), &cli.report)?;
    let plan = Plan::new("compress", &paths, cli.resources.both())?;
    // Memory for two models, and for the spherical transforms that measure the distance on a grid.
    plan.check(plan.one().saturating_mul(2).saturating_add(measure_bytes(plan.group.max_degree)), [])?;
    let pool = cli.resources.threads.pool()?;
    let mut params = CompressParams::new(cli.target.target());
    params.levels.clone_from(&cli.levels);
    params.provenance = !cli.bare;
    let mut reports = Vec::new();
    let mut rows = vec![["file", "bytes", "distance", "step", "degree"].map(str::to_owned).to_vec()];
    for (path, target) in paths.iter().zip(&targets) {
        spharm::Monitor::check(monitor)?;
        let (row, report) = pool.install(|| one(path, target, &params, cli.report.force, monitor))?;
        rows.push(row);
        reports.push(report);
    }
    finish("compress", &json!({ "format": VERSION, "files": reports }), &rows, &cli.report)
}

fn one(
    path: &Path,
    target: &Path,
    params: &CompressParams,
    force: bool,
    monitor: &ConsoleMonitor,
) -> Result<(Vec<String>, Value)> {
    let started = Instant::now();
    let model = Model::read(path)?;
    let file = compress(&model, params, monitor).with_context(|| path.display().to_string())?;
    prepare(target)?;
    write_new(target, force, |out| out.write_all(&file.bytes))?;
    let degree = model.coefficients.max_degree();
    if file.max_degree < degree {
        monitor.console().warn(format!(
            "{}: the degrees above {} are omitted, because all their coefficients were rounded to zero, and a file of \
             this size can't list so many zeros",
            path.display(),
            file.max_degree
        ));
    }
    let levels: Vec<Value> =
        file.levels.iter().map(|level| json!({ "degree": level.degree, "bytes": level.bytes })).collect();
    let row = vec![
        target.display().to_string(),
        file.bytes.len().to_string(),
        number(file.distance),
        number(file.step),
        file.max_degree.to_string(),
    ];
    let report = json!({
        "model": shown(path),
        "output": shown(target),
        "bytes": file.bytes.len(),
        "head_bytes": file.head,
        "distance": file.distance,
        "step": file.step,
        "scale": file.scale,
        "degree": file.max_degree,
        "levels": levels,
        "seconds": started.elapsed().as_secs_f64(),
    });
    Ok((row, report))
}
