//! `parametrize`: maps a closed surface onto the sphere, one to one.
//!
//! | module | what |
//! |---|---|
//! | `input` | a mesh, or the surface around a label of a volume |
//! | `shared` | what `--resample-to` names |

mod input;
mod shared;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::console::Console;
use spharm_cli::output::{print, refuse_existing, table, write_json};
use spharm_cli::threads::Threads;
use spharm_parametrize::{
    CaldParams, ConformalParams, DeformParams, EqualAreaParams, Event, Parametrization, Quality, Report, Resampled,
    StretchParams, auto, cald, conformal, deform, equal_area, resample, stretch,
};
use spharm_surface::io::{WriteOptions, write_mesh};

use self::input::{Input, Label};
use self::shared::Shared;
use crate::stages::shown;

/// Map a closed surface onto the sphere, one to one: the sphere that a fit needs
///
/// The sphere has the surface's vertices and triangles, and radius 1. Whatever the method, no triangle of it is flipped
/// or degenerate, by an exact predicate, or there is an error and no file.
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// Surface: a closed mesh of genus zero, or a label volume (.nii, .nii.gz), whose label's surface is made
    #[arg(long, value_name = "MESH_OR_VOLUME")]
    input: PathBuf,
    /// Of a volume: the label; only needed where there are several
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    label: Option<i64>,
    /// Of a volume: keep the largest piece, fill cavities, open handles, in place of refusing the label
    #[arg(long)]
    fix: bool,
    /// How
    #[arg(long, value_enum, default_value_t = Method::Auto)]
    method: Method,
    /// Sphere to write, in the format of its name (.surf.gii, .ply, .obj, ...), in 64 bits where it holds them
    #[arg(short, long, value_name = "SPHERE")]
    output: PathBuf,
    /// Also write the surface, whose triangles are those of the sphere; needed where it isn't the input's: for volumes,
    /// for deform and with --resample-to
    #[arg(long, value_name = "MESH")]
    surface_output: Option<PathBuf>,
    /// Then put the surface on the sampling of another sphere, which --output gets: icosphere:N, or a sphere's file
    #[arg(long, value_name = "icosphere:N|SPHERE", conflicts_with = "subdivisions")]
    resample_to: Option<Shared>,
    /// With --method deform: subdivisions of the icosphere [default: as many vertices as the surface, or a few more]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=10))]
    subdivisions: Option<u32>,
    /// Write what was done and how good it is as JSON
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// How the sphere is turned in the beginning; other seeds give maps that are as good but not the same
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// By cald, root mean square of the log area ratio, up to 1, that may be spent on shape and on room for what a model
    /// errs on: 0 for areas as equal as they get, 0.25 for the sake of a fit alone [default: 0.1]
    #[arg(long, value_name = "RMS")]
    area: Option<f64>,
    /// By cald, degree of the model that room is made for, no more than two thirds of the vertices determine; below 2
    /// none is made [default: that with half as many functions as there are vertices, at most 100]
    #[arg(long, value_name = "L")]
    degree: Option<usize>,
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
    #[serde(skip_serializing_if = "Option::is_none")]
    volume: Option<&'a Label>,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<Distance>,
}

/// From the input's surface to the new one, in the input's unit.
#[derive(Debug, Serialize)]
struct Distance {
    mean: f64,
    rms: f64,
    percentile95: f64,
    hausdorff: f64,
    /// By how much the Hausdorff distance may be more than was found.
    bound: f64,
    /// Cube root of the bounding box's volume.
    scale: f64,
    /// Pairs of the new surface's triangles that cut through each other, where that was looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    self_intersections: Option<usize>,
}

/// A map, and for a surface that isn't the input's how far it is from it.
struct Found {
    map: Parametrization,
    distance: Option<Distance>,
}

impl From<Parametrization> for Found {
    fn from(map: Parametrization) -> Self {
        Self { map, distance: None }
    }
}

impl From<Resampled> for Found {
    fn from(found: Resampled) -> Self {
        let d = found.distance;
        let distance = Distance {
            mean: d.mean,
            rms: d.rms,
            percentile95: d.percentile95,
            hausdorff: d.hausdorff,
            bound: d.bound,
            scale: d.scale,
            self_intersections: found.self_intersections,
        };
        Self { map: found.map, distance: Some(distance) }
    }
}

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
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

    let input = Input::read(&cli.input, cli.label, cli.fix)?;
    input.notes(&cli.input).into_iter().for_each(|note| console.note(note));
    if let Some(repair) = input.label().and_then(|label| label.repair) {
        console.warn(repair);
    }
    check(cli, &input)?;
    let found = cli.threads.pool()?.install(|| parametrize(cli, &input, &console));
    let Found { map: found, distance } = found.with_context(|| cli.input.display().to_string())?;
    found.report.notes.iter().for_each(|note| console.note(note));

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
            volume: input.label(),
            distance,
        };
        write_json(path, cli.force, &written)?;
    }
    print(&summary(&cli.output, &found.report))
}

/// Whether what was asked for goes together, said before any work.
fn check(cli: &Cli, input: &Input) -> Result<()> {
    let by_cald = matches!(input, Input::Mesh(_)) && !matches!(cli.method, Method::Conformal | Method::Stretch);
    if !by_cald && (cli.area.is_some() || cli.degree.is_some()) {
        bail!("--area and --degree are for meshes by --method cald, auto or deform");
    }
    let why = match (input, cli.method, &cli.resample_to) {
        (Input::Mesh(_), Method::EqualArea, _) => {
            bail!("equal-area is for volumes (.nii, .nii.gz); use --method cald for meshes")
        }
        (_, Method::Deform, Some(_)) => bail!("deform makes a sampling of its own; leave out --resample-to"),
        (_, method, _) if method != Method::Deform && cli.subdivisions.is_some() => {
            bail!("--subdivisions is for --method deform; use --resample-to icosphere:N")
        }
        (_, Method::Deform, _) => "deform makes",
        (_, _, Some(_)) => "--resample-to makes",
        (Input::Volume(..), _, _) => "a volume gets",
        _ => return Ok(()),
    };
    if cli.surface_output.is_none() {
        bail!("{why} a surface that the sphere belongs to: name a file for it with --surface-output");
    }
    Ok(())
}

fn parametrize(cli: &Cli, input: &Input, console: &Console) -> Result<Found> {
    let mut show = shown(console);
    let mut progress = |event| {
        if let Event::Begin { stage, .. } = event {
            console.detail(stage);
        }
        show(event);
    };
    let progress = &mut progress;
    let seed = cli.seed;
    let mesh = input.mesh();
    let default = CaldParams::default();
    let params = CaldParams { area: cli.area.unwrap_or(default.area), degree: cli.degree, seed, ..default };
    let map = match (cli.method, input) {
        (Method::Auto | Method::EqualArea, Input::Volume(quads, _)) => {
            equal_area(quads, &EqualAreaParams::default(), progress)?
        }
        (Method::Auto | Method::Deform, _) => auto(&mesh, &params, progress)?,
        (Method::Cald, _) => cald(&mesh, &params, progress)?,
        (Method::Conformal, _) => conformal(&mesh, &ConformalParams { seed, ..ConformalParams::default() }, progress)?,
        (Method::Stretch, _) => stretch(&mesh, &StretchParams { seed, ..StretchParams::default() }, progress)?,
        // `check` has refused meshes.
        (Method::EqualArea, Input::Mesh(_)) => bail!("equal-area is for volumes"),
    };
    if cli.method == Method::Deform {
        let params = DeformParams { subdivisions: cli.subdivisions, ..DeformParams::default() };
        return Ok(after(&map, deform(&map.surface, &map.sphere, &params, progress)?));
    }
    match &cli.resample_to {
        Some(shared) => Ok(after(&map, resample(&map.surface, &map.sphere, &shared.sphere()?)?)),
        None => Ok(map.into()),
    }
}

/// What came of a map, with what is to be known of the map.
fn after(map: &Parametrization, mut found: Resampled) -> Found {
    let report = &mut found.map.report;
    report.seconds += map.report.seconds;
    report.iterations += map.report.iterations;
    let first = format!("made from the {} map of {} vertices", map.report.method, map.report.vertices);
    report.notes = [std::slice::from_ref(&first), &map.report.notes, &report.notes].concat();
    found.into()
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
