//! `shape register`: moves the vertices of a template mesh onto surfaces.

use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use serde_json::json;
use spharm::register::{RegisterParams, Subject, Template, register};
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::names::NameTemplate;
use spharm_cli::output::{OutputFile, check_files, prepare};
use spharm_cli::paths::shown;
use spharm_monitor::number;
use spharm_surface::Similarity;
use spharm_surface::io::{Output, WriteOptions, bytes_to_read, write_mesh};
use spharm_surface::pose::{FixedSurface, PoseParams, PoseSurface};

use super::args::{ReportArgs, Resources};
use super::correspond::surfaces::{read, surfaces};
use super::outputs::finish;

/// Move a template onto surfaces, to make meshes with the template's triangles
///
/// First each surface is brought into the template's pose by nearest points; then the template's vertices are moved
/// onto the surface. A surface may have handles, holes and several pieces. The resulting meshes lie on the surfaces, in
/// the surfaces' own frames.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &["spharm shape register --template mean.ply s01.ply s02.ply -o registered"],
    &[help::MESHES],
))]
pub(super) struct Cli {
    /// Meshes or models, or @LIST with one path per line
    #[arg(value_name = "SURFACE", required = true, help_heading = INPUT)]
    surfaces: Vec<PathBuf>,
    /// Mesh to move
    #[arg(long, value_name = "FILE", help_heading = INPUT)]
    template: PathBuf,
    /// Method of bringing surfaces into the template's pose: nearest points, or none
    #[arg(long, value_enum, default_value_t = PoseBy::Surfaces, help_heading = METHOD)]
    pose: PoseBy,
    /// Scale surfaces to the template's size
    #[arg(long, help_heading = METHOD)]
    scale: bool,
    /// Also match mirror images
    #[arg(long, help_heading = METHOD)]
    mirror: bool,
    /// Output folder
    #[arg(short, long, value_name = "DIR", help_heading = OUTPUT)]
    output_dir: PathBuf,
    /// Names of the meshes
    #[arg(long, value_name = "TEMPLATE", default_value = "{stem}", help_heading = OUTPUT)]
    name_template: NameTemplate,
    /// Format of the meshes
    #[arg(long, value_name = "ENDING", default_value = "ply", help_heading = OUTPUT)]
    format: String,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PoseBy {
    Surfaces,
    None,
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let surfaces = surfaces(&cli.surfaces, &cli.name_template)?;
    let ending = cli.format.trim_start_matches('.');
    let outputs: Vec<PathBuf> =
        surfaces.iter().map(|surface| cli.output_dir.join(format!("{}.{ending}", surface.name))).collect();
    let of_report = cli.report.report.iter().map(|path| OutputFile::new(path, "--report"));
    let meshes = outputs.iter().map(|path| OutputFile::holding(path, "--format", Output::OrderedMesh));
    let inputs = surfaces.iter().map(|surface| &surface.path).chain([&cli.template]).map(PathBuf::as_path);
    check_files(inputs, meshes.chain(of_report), cli.report.force)?;
    let largest = surfaces.iter().max_by_key(|surface| bytes_to_read(&surface.path));
    let (memory, threads): (Memory, _) = cli.resources.both();
    let budget = memory.budget(threads.count());
    let largest = largest.map_or(cli.template.as_path(), |surface| surface.path.as_path());
    budget.check_inputs("shape register", [largest, cli.template.as_path()])?;
    let pool = cli.resources.threads.pool()?;
    let params = RegisterParams::default();
    let mesh = read(&cli.template)?;
    // Memory for the template (its kernels of 200 columns each, the factor of its thin plate, and its search trees),
    // and for the largest surface with its own search trees.
    let (n, stages) = (mesh.vertices.len() as u64, params.drift.len() as u64);
    let needed = 1600 * stages * (n + 3000) + 8000 * n + 4 * bytes_to_read(largest) + (8 << 20);
    budget.check(format!("shape register with a template of {n} vertices"), needed)?;
    let named = || cli.template.display().to_string();
    let template = pool.install(|| Template::new(&mesh, None, &params, monitor)).with_context(named)?;
    let fixed = FixedSurface::new(&mesh).ok_or(spharm::Error::NoArea).with_context(named)?;
    let posing = PoseParams { scale: cli.scale, mirror: cli.mirror, ..PoseParams::default() };
    let columns = ["surface", "pose distance", "coverage rms", "99 %", "largest", "not reached %", "flipped"];
    let mut rows = vec![columns.map(str::to_owned).to_vec()];
    let (mut each, mut warnings) = (Vec::new(), Vec::new());
    for (surface, output) in surfaces.iter().zip(&outputs) {
        spharm::Monitor::check(monitor)?;
        let named = || surface.path.display().to_string();
        let subject = surface.read().with_context(named)?;
        let (motion, distance, found, mirrored) = pool.install(|| -> Result<_> {
            let (motion, distance, mirrored) = match cli.pose {
                PoseBy::None => (Similarity::default(), None, None),
                PoseBy::Surfaces => {
                    let moving = PoseSurface::new(&subject).ok_or(spharm::Error::NoArea).with_context(named)?;
                    let (found, mirrored) = fixed.pose(&moving, &posing, monitor)?;
                    (found.similarity, Some(found.distance), mirrored)
                }
            };
            let subject = Subject::new(&motion.apply_mesh(&subject)).with_context(named)?;
            let found = register(&template, &subject, &[], &params, monitor).with_context(named)?;
            Ok((motion, distance, found, mirrored))
        })?;
        warnings.extend(mirrored.map(|mirrored| format!("{}: {mirrored}", surface.name)));
        let cover = found.cover;
        if cover.unreached > 0.02 {
            let (share, farthest) = (100.0 * cover.unreached, cover.farthest);
            warnings.push(format!(
                "{}: the template doesn't reach {share:.1} % of this surface (largest distance {farthest:.4})",
                surface.name
            ));
        }
        let moved = motion.inverse().apply_mesh(&mesh.with_vertices(found.vertices));
        prepare(output)?;
        write_mesh(output, &moved, &WriteOptions { overwrite: cli.report.force, double: true })?;
        let mut row = vec![surface.name.clone(), distance.map(number).unwrap_or_default()];
        row.extend([cover.rms, cover.most, cover.farthest].map(number));
        row.extend([format!("{:.2}", 100.0 * cover.unreached), found.turned.to_string()]);
        rows.push(row);
        let unreached = found.reached.iter().enumerate().filter(|(_, reached)| !**reached).map(|(v, _)| v);
        each.push(json!({
            "surface": shown(&surface.path),
            "output": shown(output),
            "pose_distance": distance,
            "to_template": {
                "orthogonal": motion.orthogonal,
                "scale": motion.scale,
                "translation": motion.translation,
            },
            "cover": {
                "rms": cover.rms,
                "most": cover.most,
                "farthest": cover.farthest,
                "unreached": cover.unreached,
            },
            "turned": found.turned,
            "without_counterpart": unreached.collect::<Vec<_>>(),
        }));
    }
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    let report = json!({
        "template": shown(&cli.template),
        "surfaces": each,
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    finish("register", &report, &rows, &cli.report)
}
