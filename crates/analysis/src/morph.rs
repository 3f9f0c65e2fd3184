//! `shape morph`: interpolates shapes between two models.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use serde_json::json;
use spharm::model::made;
use spharm::shape::memory::{align_bytes, measure_bytes};
use spharm::shape::morph::{Morph, default_method, volume_ratio, volume_warning};
use spharm::shape::{AlignParams, Method};
use spharm::{Kind, Model, Sphere};
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, prepare, same_place};
use spharm_cli::paths::{all_shown, shown};
use spharm_render::{Settings, View, render_frames, write_gif};
use spharm_surface::Mesh;
use spharm_surface::io::{CoarseNumbers, Output, WriteOptions, write_mesh};

use super::args::{ReportArgs, Resources};
use super::outputs::{check, finish};
use super::plan::Plan;
use spharm_cli::models::cut_handles;

/// Interpolate shapes between two models
///
/// The first model is aligned to the second, and shapes between the two are interpolated linearly. With --keep-pose,
/// the sequence of shapes begins at the first model's pose in space and ends at the second model's pose. Otherwise, all
/// shapes are in the second model's pose. --force also removes files from an earlier sequence that aren't replaced,
/// such as step3.ply.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape morph a.spharm.npz b.spharm.npz --steps 11 -o path",
        "spharm shape morph a.spharm.npz b.spharm.npz --steps 31 --animation morph.gif -o path --format spharm.npz",
    ],
    &[help::MESHES],
))]
pub(super) struct Cli {
    /// First model
    #[arg(value_name = "FROM.spharm.npz", help_heading = INPUT)]
    from: PathBuf,
    /// Last model
    #[arg(value_name = "TO.spharm.npz", help_heading = INPUT)]
    to: PathBuf,
    /// Number of shapes, both ends included
    #[arg(long, value_name = "N", default_value_t = 11, value_parser = clap::value_parser!(u16).range(2..=1000), help_heading = METHOD)]
    steps: u16,
    /// Method of aligning the first model to the second [default: fixed for two members of a group made by `shape
    /// correspond`, without --mirror; otherwise joint]
    #[arg(long, value_enum, help_heading = METHOD)]
    method: Option<How>,
    /// Begin in the first model's pose
    #[arg(long, help_heading = METHOD)]
    keep_pose: bool,
    /// Also match the mirror image
    #[arg(long, help_heading = METHOD)]
    mirror: bool,
    /// Subdivisions of the icosphere on which meshes are evaluated
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(0..=8), help_heading = METHOD)]
    icosphere: u32,
    /// Output folder
    #[arg(short, long, value_name = "DIR", help_heading = OUTPUT)]
    output: PathBuf,
    /// Format of the files: a mesh format, or spharm.npz for models
    #[arg(long, value_name = "ENDING", default_value = "ply", help_heading = OUTPUT)]
    format: String,
    /// Animation to write
    #[arg(long, value_name = "OUT.gif", help_heading = OUTPUT)]
    animation: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum How {
    /// Search the rotations of space and of the parameters together
    Joint,
    /// Search only the rotation of space, for models whose equal directions correspond, such as those of a group
    Fixed,
}

/// Width and height of the animation in pixels.
const SIDE: usize = 360;
/// Time for which the animation shows each shape, in hundredths of a second.
const DELAY: u16 = 8;

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let format = cli.format.trim_start_matches('.');
    let as_models = format == "spharm.npz";
    let last = usize::from(cli.steps) - 1;
    let digits = last.to_string().len();
    let files: Vec<PathBuf> = (0..=last).map(|step| cli.output.join(format!("step{step:0digits$}.{format}"))).collect();
    let kind = |path| match as_models {
        true => OutputFile::with_ending(path, "--format", &[".npz"]),
        false => OutputFile::holding(path, "--format", Output::Mesh),
    };
    let animation = cli.animation.iter().map(|path| OutputFile::with_ending(path, "--animation", &[".gif"]));
    check(files.iter().map(|path| kind(path.as_path())).chain(animation), &cli.report)?;
    let mut stale = stale(&cli.output, format, &files)?;
    stale.retain(|path| !same_place(path, &cli.from) && !same_place(path, &cli.to));
    if let Some(path) = stale.first().filter(|_| !cli.report.force) {
        bail!(
            "{}: this file from an earlier sequence would remain among the new files; choose another folder, or give \
             --force to remove such files",
            path.display()
        );
    }
    let plan = Plan::new("morph", &[cli.from.clone(), cli.to.clone()], cli.resources.both())?;
    // All shapes are held in memory for the animation.
    let held = if cli.animation.is_some() { u64::from(cli.steps) } else { 1 };
    let frames = if cli.animation.is_some() { 2 * held * (SIDE * SIDE * 4) as u64 } else { 0 };
    let aligning = align_bytes(plan.group.max_degree).max(measure_bytes(plan.group.max_degree));
    let needed = |[vertices, faces]: [u64; 2]| {
        let meshes =
            Model::bytes_to_evaluate(vertices, faces, 3, plan.group.max_degree) + held * 24 * (vertices + faces);
        (2 * plan.one() + frames).saturating_add(meshes.max(aligning))
    };
    let icosphere = Some(cli.icosphere);
    plan.check_sampling(icosphere, plan.sampling(icosphere, None), needed)?;
    let (from, to) = (Model::read(&cli.from)?, Model::read(&cli.to)?);
    let method = match cli.method {
        Some(How::Fixed) => Method::FixedParameters,
        Some(How::Joint) => Method::Joint,
        None => default_method(&from, &to, cli.mirror),
    };
    let params = AlignParams { method, mirror: cli.mirror, scale: false, ..AlignParams::default() };
    let pool = cli.resources.threads.pool()?;
    let (morph, ratio) = pool.install(|| -> Result<_> {
        let morph = Morph::new(&from.coefficients, &to.coefficients, &params, cli.keep_pose, monitor);
        let morph = morph.with_context(|| format!("{} to {}", cli.from.display(), cli.to.display()))?;
        let ratio = volume_ratio(&morph, monitor)?;
        Ok((morph, ratio))
    })?;
    let mut warnings: Vec<String> = morph.alignment.report.warnings.iter().map(ToString::to_string).collect();
    for (model, path) in [(&from, &cli.from), (&to, &cli.to)] {
        warnings.extend(cut_handles(model).map(|text| format!("{}: {text}", path.display())));
    }
    warnings.extend(volume_warning(ratio));
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    let options = WriteOptions { overwrite: cli.report.force, double: false };
    let sphere = Sphere::icosphere(cli.icosphere);
    let mut meshes: Vec<Mesh> = Vec::new();
    for (step, path) in files.iter().enumerate() {
        spharm::Monitor::check(monitor)?;
        let model = made(morph.at(step as f64 / last as f64)?, Kind::Surface, "shape morph");
        prepare(path)?;
        if as_models {
            model.write_with(path, cli.report.force)?;
        }
        if as_models && cli.animation.is_none() {
            continue;
        }
        let mesh = pool.install(|| model.reconstruct(&sphere, model.coefficients.max_degree()))?;
        if !as_models {
            if step == 0 {
                let coarse = CoarseNumbers::of(path, &mesh, &options)?;
                coarse.iter().for_each(|coarse| monitor.console().warn(coarse.with_option(None)));
            }
            write_mesh(path, &mesh, &options)?;
        }
        if cli.animation.is_some() {
            meshes.push(mesh);
        }
    }
    if let Some(path) = &cli.animation {
        let settings = Settings { width: SIDE, height: SIDE, view: View::CORNER, ..Settings::default() };
        let mut frames = pool.install(|| render_frames(&meshes, &settings))?;
        // The animation plays forwards, then backwards.
        let back: Vec<_> = frames.iter().rev().skip(1).take(last.saturating_sub(1)).cloned().collect();
        frames.extend(back);
        prepare(path)?;
        write_gif(path, &frames, DELAY, &options)?;
    }
    for path in &stale {
        std::fs::remove_file(path).with_context(|| path.display().to_string())?;
    }
    let seconds = started.elapsed().as_secs_f64();
    let after = morph.alignment.report.rmsd_after;
    let report = json!({
        "from": shown(&cli.from),
        "to": shown(&cli.to),
        "outputs": all_shown(&files),
        "animation": cli.animation,
        "method": if method == Method::FixedParameters { "fixed" } else { "joint" },
        "rmsd": after,
        "volume_ratio": ratio,
        "warnings": warnings,
        "seconds": seconds,
    });
    let line = format!(
        "{}: {} shapes; distance between the ends {after:.6}; the volume halfway is {ratio:.3} times that of the \
         smaller end",
        cli.output.display(),
        files.len()
    );
    finish("morph", &report, &[vec![line]], &cli.report)
}

/// Returns the files in a folder that an earlier sequence of shapes left and that aren't among the new `files`, sorted.
fn stale(folder: &Path, format: &str, files: &[PathBuf]) -> Result<Vec<PathBuf>> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let is_frame = |path: &PathBuf| {
        let name = path.file_name().and_then(|name| name.to_str());
        let step = name.and_then(|name| name.strip_prefix("step")?.strip_suffix(format)?.strip_suffix('.'));
        step.is_some_and(|step| !step.is_empty() && step.bytes().all(|byte| byte.is_ascii_digit()))
    };
    let entries = std::fs::read_dir(folder).with_context(|| folder.display().to_string())?;
    let paths = entries.map(|entry| -> std::io::Result<PathBuf> { Ok(folder.join(entry?.file_name())) });
    let paths = paths.collect::<std::io::Result<Vec<_>>>();
    let mut paths = paths.with_context(|| folder.display().to_string())?;
    paths.retain(|path| is_frame(path) && path.is_file() && !files.contains(path));
    paths.sort_unstable();
    Ok(paths)
}
