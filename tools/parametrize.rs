//! `parametrize`: maps a closed surface onto the sphere, one to one.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use clap::{Parser, ValueEnum};
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::console::{Console, Unit};
use spharm_cli::output::{print, refuse_existing, table, write_json};
use spharm_cli::threads::Threads;
use spharm_parametrize::{
    CaldParams, ConformalParams, Event, Parametrization, ParametrizeError, Quality, Report, StretchParams, auto, cald,
    conformal, stretch,
};
use spharm_surface::Mesh;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

/// Map a closed surface onto the sphere, one to one: the sphere that a fit needs
///
/// The sphere has the surface's vertices and triangles, and radius 1. Whatever the method, no triangle of it is flipped
/// or degenerate, by an exact predicate, or there is an error and no file.
#[derive(Debug, Parser)]
#[command(name = "parametrize", version)]
struct Cli {
    /// Surface: a closed mesh of genus zero
    #[arg(long, value_name = "MESH_OR_VOLUME")]
    input: PathBuf,
    /// How
    #[arg(long, value_enum, default_value_t = Method::Auto)]
    method: Method,
    /// Sphere to write, in the format of its name (.surf.gii, .ply, .obj, ...), in 64 bits where it holds them
    #[arg(short, long, value_name = "SPHERE")]
    output: PathBuf,
    /// Also write the surface, whose triangles are those of the sphere
    #[arg(long, value_name = "MESH")]
    surface_output: Option<PathBuf>,
    /// Write what was done and how good it is as JSON
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// How the sphere is turned in the beginning; other seeds give maps that are as good but not the same
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// By cald, root mean square of the log area ratio that may go into sampling finely meshed parts better: 0 for equal
    /// areas as they are on the surface; 0.15 makes fits at the vertices of uneven meshes better still
    #[arg(long, value_name = "RMS", default_value_t = CaldParams::default().even)]
    even: f64,
    /// Replace outputs that exist
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    threads: Threads,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Method {
    /// cald for meshes, equal-area for volumes; stretch where that fails
    Auto,
    /// Equal areas, with little length distortion (Shen and Makedon 2006)
    Cald,
    /// Equal areas, for volumes of voxels (Brechbuehler, Gerig and Kuebler 1995)
    EqualArea,
    /// Least angle distortion (Gu et al. 2004)
    Conformal,
    /// Least stretch (Praun and Hoppe 2003)
    Stretch,
    /// An icosphere deformed onto the surface (Chung and Robbins)
    Deform,
}

/// What the JSON file says.
#[derive(Debug, Serialize)]
struct Written<'a> {
    input: String,
    output: String,
    seed: u64,
    threads: usize,
    version: &'static str,
    #[serde(flatten)]
    report: &'a Report,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    spharm_cli::exit::run(|| work(&cli))
}

fn work(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    refuse_existing(&cli.output, cli.force, "sphere", "--output")?;
    if let Some(path) = &cli.surface_output {
        refuse_existing(path, cli.force, "surface", "--surface-output")?;
    }
    if let Some(path) = &cli.report {
        refuse_existing(path, cli.force, "report", "--report")?;
    }
    let outputs = [Some(&cli.output), cli.surface_output.as_ref(), cli.report.as_ref()];
    let outputs: Vec<&PathBuf> = outputs.into_iter().flatten().collect();
    if outputs.iter().enumerate().any(|(i, path)| outputs[..i].contains(path)) {
        bail!("the outputs must have different names");
    }

    let mesh = read_mesh(&cli.input)?;
    console.note(format!("{}: {} vertices, {} triangles", cli.input.display(), mesh.vertices.len(), mesh.faces.len()));
    let found = cli.threads.pool()?.install(|| parametrize(&mesh, cli, &console));
    let found = found.with_context(|| cli.input.display().to_string())?;
    found.report.notes.iter().for_each(|note| console.warn(note));

    keeps_its_triangles(&cli.output, &found)?;
    let options = WriteOptions { overwrite: cli.force, double: true };
    write_mesh(&cli.output, &found.sphere, &options)?;
    if let Some(path) = &cli.surface_output {
        write_mesh(path, &found.surface, &options)?;
    }
    if let Some(path) = &cli.report {
        let written = Written {
            input: cli.input.display().to_string(),
            output: cli.output.display().to_string(),
            seed: cli.seed,
            threads: cli.threads.count(),
            version: env!("CARGO_PKG_VERSION"),
            report: &found.report,
        };
        write_json(path, cli.force, &written)?;
    }
    print(&summary(&cli.output, &found.report))
}

fn parametrize(mesh: &Mesh, cli: &Cli, console: &Console) -> Result<Parametrization> {
    let mut bar = None;
    let mut progress = |event| match event {
        Event::Begin { stage, steps } => {
            console.detail(stage);
            // The last one has to go from the screen before the next comes.
            bar = None;
            bar = Some(console.progress(stage, steps, Unit::Count("steps")));
        }
        Event::Step(steps) => {
            if let Some(bar) = &bar {
                bar.add(steps);
            }
        }
        _ => {}
    };
    let progress = &mut progress;
    let seed = cli.seed;
    let even = CaldParams { even: cli.even, seed, ..CaldParams::default() };
    let found: Result<Parametrization, ParametrizeError> = match cli.method {
        Method::Auto => auto(mesh, &even, progress),
        Method::Cald => cald(mesh, &even, progress),
        Method::Conformal => conformal(mesh, &ConformalParams { seed, ..ConformalParams::default() }, progress),
        Method::Stretch => stretch(mesh, &StretchParams { seed, ..StretchParams::default() }, progress),
        // Filled in by the methods for volumes and shared samplings.
        Method::EqualArea => bail!("the method equal-area is for volumes, which aren't read yet; use cald for meshes"),
        Method::Deform => bail!("the method deform isn't built yet; use cald"),
    };
    Ok(found?)
}

/// A format of 32-bit numbers can flip cells that are small enough; then no file is better than that one.
fn keeps_its_triangles(path: &Path, found: &Parametrization) -> Result<()> {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_ascii_lowercase();
    let holds_double = [".gii", ".gii.gz", ".ply", ".obj", ".off", ".vtk"].iter().any(|ending| name.ends_with(ending));
    if holds_double {
        return Ok(());
    }
    let rounded = found.sphere.vertices.iter().map(|p| p.map(|x| f64::from(x as f32))).collect();
    let quality = Quality::of(&found.surface, &found.sphere.with_vertices(rounded));
    if !quality.is_bijective() {
        bail!(
            "{}: the 32-bit numbers of this format would flip {} of the sphere's triangles; write .surf.gii or .ply",
            path.display(),
            quality.flipped + quality.degenerate
        );
    }
    Ok(())
}

fn summary(output: &Path, report: &Report) -> String {
    let Quality { area_rms, area_p01, area_p99, angle_rms_degrees, stretch, length_worst, length_p99, .. } =
        report.quality;
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    let rows = [
        row("flipped or degenerate triangles", (report.quality.flipped + report.quality.degenerate).to_string()),
        row("log area ratio, root mean square", format!("{area_rms:.4}")),
        row("  1st and 99th percentile", format!("{area_p01:.3} {area_p99:.3}")),
        row("angle distortion, root mean square", format!("{angle_rms_degrees:.2} degrees")),
        row("L2 stretch", format!("{stretch:.4}")),
        row("length distortion, worst", format!("{length_worst:.3}")),
        row("  99th percentile", format!("{length_p99:.3}")),
    ];
    format!(
        "{}: {} vertices by {}, {} iterations, {:.2} s\n{}",
        output.display(),
        report.vertices,
        report.method,
        report.iterations,
        report.seconds,
        table(&rows)
    )
}
