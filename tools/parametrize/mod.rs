//! `parametrize`: maps a closed surface onto the sphere, one to one.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use clap::ValueEnum;
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{print, refuse_existing, table, write_json};
use spharm_cli::threads::Threads;
use spharm_parametrize::volume::{Repair, VolumeParams, VolumeSurface, is_volume};
use spharm_parametrize::{
    CaldParams, ConformalParams, DeformParams, EqualAreaParams, Input, Method, Parametrization, ParametrizeError,
    Quality, Report, Resampling, Sampling, StretchParams,
};
use spharm_surface::io::{WriteOptions, write_mesh};

/// Map a closed surface onto the sphere, one to one: the sphere that a fit needs
///
/// The sphere has the surface's vertices and triangles, and radius 1. Whatever the method, no triangle of it is flipped
/// or degenerate, by an exact predicate, or there is an error and no file.
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// Surface: a closed mesh of genus zero, or a label volume (.nii, .nii.gz, .mgh, .mgz), whose label's surface is made
    #[arg(long, value_name = "MESH_OR_VOLUME")]
    input: PathBuf,
    /// Of a volume: the label; only needed where there are several
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    label: Option<i64>,
    /// Of a volume: keep the largest piece, fill cavities, open handles, in place of refusing the label
    #[arg(long)]
    fix: bool,
    /// Method of parameterisation
    #[arg(long, value_enum, default_value_t = MethodName::Auto)]
    method: MethodName,
    /// Sphere to write, in the format of its name (.surf.gii, .ply, .obj, ...), in 64 bits where it holds them
    #[arg(short, long, value_name = "SPHERE")]
    output: PathBuf,
    /// Also write the surface, whose triangles are those of the sphere; needed where it isn't the input's: for volumes,
    /// for deform and with --resample-to
    #[arg(long, value_name = "MESH")]
    surface_output: Option<PathBuf>,
    /// Then put the surface on the sampling of another sphere, which --output gets: icosphere:N, or a sphere's file
    #[arg(long, value_name = "icosphere:N|SPHERE", conflicts_with = "subdivisions")]
    resample_to: Option<Sampling>,
    /// With --method deform: subdivisions of the icosphere [default: as many vertices as the surface, or a few more]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(..=10))]
    subdivisions: Option<u32>,
    /// Write what was done and how good it is as JSON
    #[arg(long, value_name = "FILE.json")]
    report: Option<PathBuf>,
    /// Seed of the rotation that the sphere starts from; other seeds give other maps of the same quality
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// By cald, the allowed area distortion (root mean square of the log area ratio), from 0 to 1, which is spent on shape
    /// and on areas that adapt to the residual of a model: 0 for areas as equal as possible, 0.25 for a map that only
    /// serves a fit [default: 0.1]
    #[arg(long, value_name = "RMS")]
    area: Option<f64>,
    /// By cald, degree of the model whose residual areas adapt to, limited to what two thirds of the vertices determine;
    /// below 2 they don't adapt [default: that with half as many functions as there are vertices, at most 100]
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
enum MethodName {
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
    volume: Option<Label>,
    #[serde(skip_serializing_if = "Option::is_none")]
    distance: Option<Distance>,
}

/// The label that a surface was made of.
#[derive(Debug, Serialize)]
struct Label {
    label: i64,
    voxels: usize,
    /// The changes made by `--fix`, if any.
    repair: Option<Repair>,
}

impl From<&VolumeSurface> for Label {
    fn from(found: &VolumeSurface) -> Self {
        Self { label: found.label, voxels: found.voxels, repair: found.repair }
    }
}

/// From the input's surface to the new one, in the input's unit.
#[derive(Debug, Serialize)]
struct Distance {
    mean: f64,
    rms: f64,
    percentile95: f64,
    hausdorff: f64,
    /// The most by which the true Hausdorff distance may exceed `hausdorff`.
    bound: f64,
    /// Cube root of the bounding box's volume.
    scale: f64,
    /// Pairs of the new surface's triangles that intersect, where they were looked for.
    #[serde(skip_serializing_if = "Option::is_none")]
    self_intersections: Option<usize>,
}

impl From<Resampling> for Distance {
    fn from(Resampling { distance: d, self_intersections, .. }: Resampling) -> Self {
        Self {
            mean: d.mean,
            rms: d.rms,
            percentile95: d.percentile95,
            hausdorff: d.hausdorff,
            bound: d.bound,
            scale: d.scale,
            self_intersections,
        }
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

    if !is_volume(&cli.input) && (cli.label.is_some() || cli.fix) {
        bail!("{}: --label and --fix are for volumes (.nii, .nii.gz, .mgh, .mgz)", cli.input.display());
    }
    let monitor = ConsoleMonitor::new(console);
    let volume = VolumeParams { label: cli.label, fix: cli.fix };
    let input = Input::read(&cli.input, &volume, &monitor)?;
    console.note(format_args!("{}: {}", cli.input.display(), described(&input)));
    if let Input::Label(VolumeSurface { repair: Some(repair), .. }) = &input {
        console.warn(repair);
    }
    check(cli, &input)?;
    let found = cli.threads.pool()?.install(|| parametrize(cli, &input, &monitor));
    let found = found.with_context(|| cli.input.display().to_string())?;
    found.report.warnings.iter().for_each(|warning| console.warn(warning));
    found.report.notes.iter().for_each(|note| console.note(note));

    if !holds_double(&cli.output) {
        found.check_single_precision().with_context(|| cli.output.display().to_string())?;
    }
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
            volume: if let Input::Label(found) = &input { Some(found.into()) } else { None },
            distance: found.resampling.map(Distance::from),
        };
        write_json(path, cli.force, &written)?;
    }
    print(&summary(&cli.output, &found.report))
}

/// Whether what was asked for goes together, said before any work.
fn check(cli: &Cli, input: &Input) -> Result<()> {
    let by_cald = matches!(input, Input::Mesh(_)) && !matches!(cli.method, MethodName::Conformal | MethodName::Stretch);
    if !by_cald && (cli.area.is_some() || cli.degree.is_some()) {
        bail!("--area and --degree are for meshes by --method cald, auto or deform");
    }
    let why = match (input, cli.method, &cli.resample_to) {
        (Input::Mesh(_), MethodName::EqualArea, _) => {
            bail!("equal-area is for volumes (.nii, .nii.gz, .mgh, .mgz); use --method cald for meshes")
        }
        (_, MethodName::Deform, Some(_)) => bail!("deform makes a sampling of its own; leave out --resample-to"),
        (_, method, _) if method != MethodName::Deform && cli.subdivisions.is_some() => {
            bail!("--subdivisions is for --method deform; use --resample-to icosphere:N")
        }
        (_, MethodName::Deform, _) => "deform makes",
        (_, _, Some(_)) => "--resample-to makes",
        (Input::Label(_), _, _) => "a volume gets",
        _ => return Ok(()),
    };
    if cli.surface_output.is_none() {
        bail!("{why} a surface that the sphere belongs to: name a file for it with --surface-output");
    }
    Ok(())
}

fn parametrize(cli: &Cli, input: &Input, monitor: &ConsoleMonitor) -> Result<Parametrization, ParametrizeError> {
    let seed = cli.seed;
    let default = CaldParams::default();
    let params = CaldParams { area: cli.area.unwrap_or(default.area), degree: cli.degree, seed, ..default };
    let method = match cli.method {
        MethodName::Auto => Method::Auto(params),
        MethodName::Cald => Method::Cald(params),
        MethodName::EqualArea => Method::EqualArea(EqualAreaParams::default()),
        MethodName::Conformal => Method::Conformal(ConformalParams { seed, ..ConformalParams::default() }),
        MethodName::Stretch => Method::Stretch(StretchParams { seed, ..StretchParams::default() }),
        MethodName::Deform => {
            let deform = DeformParams { subdivisions: cli.subdivisions, ..DeformParams::default() };
            Method::Deform { params: deform, map: params }
        }
    };
    let found = method.run(input, monitor)?;
    match &cli.resample_to {
        Some(sampling) => found.resampled(&sampling.sphere()?, monitor),
        None => Ok(found),
    }
}

fn described(input: &Input) -> String {
    match input {
        Input::Mesh(mesh) => format!("{} vertices, {} triangles", mesh.vertices.len(), mesh.faces.len()),
        Input::Label(VolumeSurface { quads, label, voxels, .. }) => {
            let (vertices, faces) = (quads.vertices.len(), quads.quads.len());
            format!("label {label}, {voxels} voxels; {vertices} vertices, {faces} quadrangles")
        }
    }
}

/// Whether a file of this name keeps coordinates in 64 bits.
fn holds_double(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str()).unwrap_or_default().to_ascii_lowercase();
    [".gii", ".gii.gz", ".ply", ".obj", ".off", ".vtk"].iter().any(|ending| name.ends_with(ending))
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
