//! `shape remesh`: makes meshes of models: at given degrees, within a distance of the model, or with evenly spread
//! vertices.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::Args;
use serde_json::{Value, json};
use spharm::shape::memory::measure_bytes;
use spharm::shape::{EvenSphere, area_spread, degree_within, even_sphere, extent, tails};
use spharm_cli::help::{self, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare};
use spharm_cli::paths::{model_file_name, shown, with_ending};
use spharm_model::Model;
use spharm_monitor::number;
use spharm_surface::Sphere;
use spharm_surface::io::{CoarseNumbers, Output, WriteOptions, write_mesh};

use super::args::{Models, ReportArgs, Resources, Sampling, sphere_of, to_degree};
use super::outputs::{check, check_folder, finish, outputs};
use super::plan::Plan;
use spharm_cli::models::cut_handles;

/// Number of steps of the integration that moves the vertices. The integration error is far below the resolution of a
/// mesh.
const STEPS: usize = 16;

/// Without `--icosphere`, `--even` gives a warning if the spread of the triangles' areas afterwards exceeds both
/// `UNEVEN` and this fraction of the original spread.
const LITTLE: f64 = 0.8;
/// Largest spread of the triangles' areas that never causes a warning; see [`LITTLE`].
const UNEVEN: f64 = 0.2;

/// Make meshes of models: within a distance, at several degrees, or with evenly spread vertices
///
/// Omitting the degrees above a given degree moves the surface by a root mean square distance that is known exactly.
/// --tolerance uses the lowest degree for which this distance is small enough; a coarse mesh is farther from the
/// model. --levels writes a mesh for each given degree, all with the same triangles. --even moves the vertices so that
/// they are spread evenly over the surface's area.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape remesh bunny.spharm.npz --tolerance 0.1 --icosphere 5 -o bunny.ply",
        "spharm shape remesh bunny.spharm.npz --levels 5,10,20 --icosphere 5 --even -o levels --format ply",
    ],
    &[help::MESHES],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    #[command(flatten)]
    degree: Degree,
    #[command(flatten)]
    sampling: Sampling,
    /// Spread the vertices evenly over the surface's area
    #[arg(long, help_heading = METHOD)]
    even: bool,
    /// Mesh to write; for several models or levels, a folder
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    output: PathBuf,
    /// Format of the files in a folder
    #[arg(long, value_name = "ENDING", default_value = "surf.gii", help_heading = OUTPUT)]
    format: String,
    /// Write 64-bit positions if the format supports them
    #[arg(long, help_heading = OUTPUT)]
    double: bool,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

#[derive(Debug, Args)]
#[group(multiple = false)]
struct Degree {
    /// Highest degree to use [default: the model's degree]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    max_degree: Option<usize>,
    /// Use the lowest degree whose surface is within this root mean square distance of the model, in the model's unit;
    /// the distance of the mesh's flat triangles from this surface isn't included
    #[arg(long, value_name = "D", allow_negative_numbers = true, help_heading = METHOD)]
    tolerance: Option<f64>,
    /// Degrees at which to make meshes, with a file for each
    #[arg(long, value_name = "L,L,...", value_delimiter = ',', help_heading = METHOD)]
    levels: Option<Vec<usize>>,
}

impl Degree {
    /// Returns the degrees up to which a model is evaluated, one for each mesh to write.
    fn of(&self, model: &Model, path: &Path) -> Result<Vec<usize>> {
        let highest = model.coefficients.max_degree();
        if let Some(tolerance) = self.tolerance {
            let within = degree_within(&model.coefficients, tolerance);
            // A surface needs at least degree 1.
            return Ok(vec![within.with_context(|| path.display().to_string())?.0.max(1)]);
        }
        let (degrees, flag) = match (&self.levels, self.max_degree) {
            (Some(levels), _) => (levels.clone(), "--levels"),
            (None, degree) => (vec![degree.unwrap_or(highest)], "--max-degree"),
        };
        match degrees.iter().find(|degree| **degree > highest) {
            Some(degree) => {
                bail!("{}: {flag} {degree} exceeds the model's degree {highest}", path.display())
            }
            None => Ok(degrees),
        }
    }
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let paths = cli.models.paths()?;
    let targets = targets(cli, &paths)?;
    let files = targets.iter().flatten().map(|path| OutputFile::holding(path, "--output", Output::Mesh));
    check(files, &cli.report)?;
    let plan = Plan::new("remesh", &paths, cli.resources.both())?;
    // Memory per vertex, in bytes, for moving the vertices: four velocities, the directions at which the velocities are
    // computed, and the density.
    let even = if cli.even { 480 } else { 0 };
    let needed = |[vertices, faces]: [u64; 2]| {
        let evaluating = Model::bytes_to_evaluate(vertices, faces, 4, plan.group.max_degree);
        plan.one().saturating_add(evaluating).saturating_add(even * vertices)
    };
    let grid = if cli.even { measure_bytes(2 * plan.group.max_degree) } else { 0 };
    let shared = cli.sampling.within(&plan, |counts| needed(counts).max(grid), monitor.console())?;
    let pool = cli.resources.threads.pool()?;
    let mut reports = Vec::new();
    let mut rows = vec![["mesh", "vertices", "degree", "distance", "spread of areas"].map(str::to_owned).to_vec()];
    for (path, targets) in paths.iter().zip(&targets) {
        let written = pool.install(|| one(cli, path, targets, shared.as_ref(), monitor))?;
        for report in written {
            let of = |field: &str| number(report[field].as_f64().unwrap_or(0.0));
            rows.push(vec![
                report["output"].as_str().unwrap_or_default().to_owned(),
                report["vertices"].to_string(),
                report["degree"].to_string(),
                of("distance"),
                of("area_spread"),
            ]);
            reports.push(report);
        }
    }
    finish("remesh", &json!({ "even": cli.even, "meshes": reports }), &rows, &cli.report)
}

/// Returns the output files of each model, one for each level.
fn targets(cli: &Cli, paths: &[PathBuf]) -> Result<Vec<Vec<PathBuf>>> {
    let Some(levels) = &cli.degree.levels else {
        let each = outputs(&cli.models, paths, &cli.output, &cli.format)?;
        return Ok(each.into_iter().map(|path| vec![path]).collect());
    };
    check_folder(&cli.output)?;
    let file = |path: &PathBuf, level: &usize| {
        with_ending(&cli.output.join(model_file_name(path)), &format!("degree{level}.{}", cli.format))
    };
    Ok(paths.iter().map(|path| levels.iter().map(|level| file(path, level)).collect()).collect())
}

fn one(
    cli: &Cli,
    path: &Path,
    targets: &[PathBuf],
    shared: Option<&Sphere>,
    monitor: &ConsoleMonitor,
) -> Result<Vec<Value>> {
    let started = Instant::now();
    let named = || path.display().to_string();
    let model = Model::read(path)?;
    extent(&model.coefficients).with_context(named)?;
    if let Some(text) = cut_handles(&model) {
        monitor.console().warn(format!("{}: {text}", path.display()));
    }
    let degrees = cli.degree.of(&model, path)?;
    let tails = tails(&model.coefficients).with_context(named)?;
    let sphere = sphere_of(shared, &model, path)?;
    // The vertices are relocated once, for the highest degree, so that all levels have the same triangles.
    let even = if cli.even { Some(relocated(&model, path, &degrees, sphere, monitor)?) } else { None };
    if let Some(EvenSphere { before, after, .. }) =
        even.as_ref().filter(|even| even.after > UNEVEN.max(LITTLE * even.before))
        && cli.sampling.icosphere.is_none()
    {
        monitor.console().warn(format!(
            "{}: --even leaves a spread of the triangles' areas of {after:.2} (before: {before:.2}), because the vertices of \
             the sphere are spread unevenly; use --icosphere",
            path.display()
        ));
    }
    let sphere = even.as_ref().map_or(sphere, |even| &even.sphere);
    let options = WriteOptions { overwrite: cli.report.force, double: cli.double };
    let mut reports = Vec::new();
    for (degree, target) in degrees.into_iter().zip(targets) {
        let mesh = model.reconstruct(sphere, degree).with_context(named)?;
        prepare(target)?;
        let coarse = CoarseNumbers::of(target, &mesh, &options)?;
        coarse.iter().for_each(|coarse| monitor.console().warn(coarse.with_option(Some("give --double"))));
        write_mesh(target, &mesh, &options)?;
        reports.push(json!({
            "model": shown(path),
            "output": shown(target),
            "vertices": mesh.vertices.len(),
            "degree": degree,
            "distance": tails[degree],
            "area_spread": area_spread(&mesh),
            "area_spread_before": even.as_ref().map(|even| even.before),
            "folded": even.as_ref().map(|even| even.folded),
            "seconds": started.elapsed().as_secs_f64(),
        }));
    }
    Ok(reports)
}

fn relocated(
    model: &Model,
    path: &Path,
    degrees: &[usize],
    sphere: &Sphere,
    monitor: &ConsoleMonitor,
) -> Result<EvenSphere> {
    let named = || path.display().to_string();
    let coefficients = to_degree(model, path, degrees.iter().copied().max())?;
    let even = even_sphere(&coefficients, sphere, STEPS, monitor).with_context(named)?;
    if even.folded > 0 {
        let folded = even.folded;
        monitor.console().warn(format!(
            "{}: --even flipped {folded} triangles: the mesh is too coarse for this surface; choose a finer --icosphere",
            path.display()
        ));
    }
    Ok(even)
}
