//! `shape align`: aligns models to a target, or the members of a group to each other.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};
use rayon::prelude::*;
use serde_json::{Value, json};
use spharm::model::{made, signed};
use spharm::shape::memory::align_bytes;
use spharm::shape::{
    AlignParams, AlignReport, Journal, Method, ProcrustesParams, ProcrustesWarning, Transform, align, procrustes_with,
};
use spharm::{Coefficients, Kind, Model, Silent};
use spharm_cli::Usage;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, same_place};
use spharm_cli::paths::{all_shown, model_name, shown};
use spharm_monitor::number;
use spharm_surface::pose::PoseParams;

use super::again::{Again, journal};
use super::align_meshes::{self, are_meshes};
use super::args::{Models, ReportArgs, Resources};
use super::frames;
use super::groups::{axes_differ, distances_from_mean, equal_models};
use super::mirrored::Mirrored;
use super::outputs::{check_beside, finish, outputs};
use super::plan::Plan;

/// Align surface models or meshes to a target, or a group to its mean
///
/// Finds the rotations of space and of the parameters that bring surfaces closest to each other. The search covers all
/// rotations, so the result doesn't depend on the initial pose. With --group, the group is aligned to its mean
/// (generalised Procrustes analysis). The mean is centred at the origin, in the frame of its first-order ellipsoid.
/// Mirror images are matched only with --mirror. Meshes of any topology, given in place of models, are aligned by
/// nearest points and written in their own formats.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape align moved.spharm.npz --to template.spharm.npz -o aligned.spharm.npz",
        "spharm shape align @group.txt --group -o aligned --transforms transforms.json",
        "spharm shape align vertebrae --group --pose surfaces -o aligned",
        "spharm shape align a.ply b.ply c.ply --group -o aligned --transforms transforms.json",
        "spharm shape align left right --group --mirrored right -o aligned",
        "spharm shape align cortices --group --method fixed -o aligned",
        "spharm shape align @thousand.txt --group --resume align.state -o aligned",
    ],
    &[
        "Methods: joint searches the rotations of space and of the parameters together; fixed searches only the \
         rotation of space, for surfaces whose vertices already correspond (cortical surfaces); foe rotates each \
         surface into the frame of its first-order ellipsoid, for comparison with other programs.",
    ],
))]
pub(super) struct Cli {
    #[command(flatten)]
    models: Models,
    #[command(flatten)]
    target: Target,
    /// Method of aligning the surfaces
    #[arg(long, value_enum, default_value_t = How::Joint, help_heading = METHOD)]
    method: How,
    /// Criterion for the surfaces' pose in space, with --method joint
    ///
    /// surfaces: first the pose is found by nearest points of the surfaces; then, in this pose, the rotation of the
    /// parameters is found. joint: the rotations of space and of the parameters are found together, by the smallest
    /// distance at equal directions. For models that were mapped to the sphere separately, the smallest distance may be
    /// at a wrong pose. [default: joint for models, surfaces for meshes]
    #[arg(long, value_enum, help_heading = METHOD)]
    pose: Option<PoseBy>,
    /// Scale models to the target's size, or a group's members to a common size
    #[arg(long, help_heading = METHOD)]
    scale: bool,
    /// Also match mirror images
    #[arg(long, help_heading = METHOD)]
    mirror: bool,
    /// Models to mirror first (x to -x, surface and sphere), such as right hemispheres among left hemispheres
    ///
    /// The transforms include the reflection.
    #[arg(long, value_name = "MODEL", num_args = 1.., help_heading = METHOD)]
    mirrored: Vec<PathBuf>,
    /// Highest degree to compare [default: the smallest of the models' degrees]
    ///
    /// The transforms are applied to all degrees.
    #[arg(short = 'L', long = "max-degree", alias = "degree", value_name = "L", help_heading = METHOD)]
    degree: Option<usize>,
    /// Number of local optima from which the alignment is refined [default: 6, or 3 for a group]
    #[arg(long, value_name = "N", help_heading = METHOD)]
    starts: Option<usize>,
    /// Number of members from which the alignment of a group is started [default: all if at most 20, otherwise 5]
    #[arg(long, value_name = "N", requires = "group", help_heading = METHOD)]
    templates: Option<usize>,
    /// Model to write; for several models, a folder
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    output: PathBuf,
    /// File for the group's mean
    #[arg(long, value_name = "OUT.spharm.npz", requires = "group", help_heading = OUTPUT)]
    mean: Option<PathBuf>,
    /// Transforms to write
    #[arg(long, value_name = "OUT.json", help_heading = OUTPUT)]
    transforms: Option<PathBuf>,
    /// File for the warnings about poses, for a study's page; the warnings name members without their paths
    #[arg(long, value_name = "OUT.json", requires = "group", hide = true)]
    warnings: Option<PathBuf>,
    /// Don't print the warnings about poses, because a study uses this alignment only for comparison
    #[arg(long, requires = "group", hide = true)]
    for_comparison: bool,
    /// File that stores progress, so that an interrupted run can be resumed
    ///
    /// To resume an interrupted run, run the same command again. The results are bitwise equal to those of an
    /// uninterrupted run, and the file is removed at the end. Results already written are kept. The file is valid only
    /// for these models and settings.
    #[arg(long, value_name = "FILE", requires = "group", help_heading = OUTPUT)]
    resume: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

#[derive(Debug, Args)]
#[group(required = true, multiple = false)]
struct Target {
    /// Model to which each model is aligned
    #[arg(long, value_name = "MODEL", help_heading = INPUT)]
    to: Option<PathBuf>,
    /// Align the models to each other
    #[arg(long, help_heading = METHOD)]
    group: bool,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum How {
    Joint,
    Fixed,
    Foe,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum PoseBy {
    Surfaces,
    Joint,
}

impl Cli {
    /// Converts the arguments to a request for meshes. Refuses arguments that only apply to models.
    fn of_meshes<'a>(&'a self, paths: &'a [PathBuf]) -> Result<align_meshes::Asked<'a>> {
        let of_models = [
            (self.method != How::Joint, "--method"),
            (self.pose == Some(PoseBy::Joint), "--pose joint"),
            (!self.mirrored.is_empty(), "--mirrored"),
            (self.degree.is_some(), "--max-degree"),
            (self.starts.is_some(), "--starts"),
            (self.templates.is_some(), "--templates"),
            (self.mean.is_some(), "--mean"),
            (self.warnings.is_some(), "--warnings"),
            (self.resume.is_some(), "--resume"),
        ];
        if let Some((_, flag)) = of_models.iter().find(|(given, _)| *given) {
            return Err(Usage::conflict(format!("{flag} can only be used for models; the inputs are meshes")).into());
        }
        Ok(align_meshes::Asked {
            paths,
            target: self.target.to.as_deref(),
            output: &self.output,
            transforms: self.transforms.as_deref(),
            params: PoseParams { scale: self.scale, mirror: self.mirror, ..PoseParams::default() },
            report: &self.report,
            resources: &self.resources,
        })
    }
}

/// Transforms, and distances from the target or the mean before and after the alignment.
struct Found {
    transforms: Vec<Transform>,
    distances: Vec<[f64; 2]>,
    warnings: Vec<String>,
    /// Warnings about a group's poses, which name members without their paths.
    named_warnings: Vec<String>,
    summary: Value,
    mean: Option<Coefficients>,
    /// State file of a resumable alignment; kept open and locked until all outputs are written.
    journal: Option<Journal>,
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    if cli.resume.is_some() && !cli.target.group {
        return Err(Usage::conflict("--resume can only be used with --group").into());
    }
    if cli.pose == Some(PoseBy::Surfaces) && cli.method != How::Joint {
        return Err(Usage::conflict("--pose surfaces can only be used with --method joint").into());
    }
    let paths = cli.models.paths()?;
    if are_meshes(paths.iter().map(PathBuf::as_path).chain(cli.target.to.as_deref()))? {
        return align_meshes::run(&cli.of_meshes(&paths)?, monitor);
    }
    let targets = outputs(&cli.models, &paths, &cli.output, "spharm.npz")?;
    let models_out = targets.iter().map(|path| OutputFile::with_ending(path, "--output", &[".npz"]));
    let mean_out = cli.mean.iter().map(|path| OutputFile::with_ending(path, "--mean", &[".npz"]));
    let json_out = cli.transforms.iter().map(|path| OutputFile::new(path, "--transforms"));
    let json_out = json_out.chain(cli.warnings.iter().map(|path| OutputFile::new(path, "--warnings")));
    let mirrored = Mirrored::find(&cli.mirrored, &paths)?;
    let again = Again::new(cli.resume.as_deref(), cli.report.force);
    let report_args = ReportArgs { force: again.expected(), ..cli.report.clone() };
    check_beside(&paths, models_out.chain(mean_out).chain(json_out), &report_args)?;
    if cli.target.group && paths.len() < 3 {
        bail!(
            "a group needs at least 3 models, found {}; to align one model to another, use `align MODEL --to OTHER`",
            paths.len()
        );
    }
    let named = targets.iter().chain(&cli.mean).chain(&cli.transforms).chain(&cli.report.report);
    if named.into_iter().any(|path| cli.resume.as_deref().is_some_and(|state| same_place(path, state))) {
        return Err(Usage::conflict("--resume must name a file that is not also an output").into());
    }
    let params = |method: Method| AlignParams {
        method,
        max_degree: cli.degree,
        scale: cli.scale,
        mirror: cli.mirror,
        ..AlignParams::default()
    };
    let plan = Plan::new("align", &paths, cli.resources.both())?;
    let work = if cli.target.group { plan.group.procrustes(plan.threads) } else { align_bytes(plan.group.max_degree) };
    let needed = plan.whole().saturating_add(work);
    plan.check(needed, [])?;
    plan.note(needed, monitor.console());
    let pool = cli.resources.threads.pool()?;
    let mut models: Vec<Model> = pool.install(|| {
        super::args::read_all(&paths, monitor, |model, path| {
            if model.kind() != Kind::Surface {
                bail!("{}: expected a model of a surface, found a signal", path.display());
            }
            Ok(model.clone())
        })
    })?;
    pool.install(|| mirrored.apply(&mut models, monitor))?;
    let target = cli.target.to.as_deref().map(|path| Model::read(path).map(|model| (path, model))).transpose()?;
    let method = match (cli.method, cli.pose) {
        (How::Joint, Some(PoseBy::Surfaces)) => Method::Surfaces,
        (How::Joint, Some(PoseBy::Joint) | None) => Method::Joint,
        (How::Fixed, _) => Method::FixedParameters,
        (How::Foe, _) => Method::FirstOrderEllipsoid,
    };
    let params = params(method);
    let found = pool.install(|| match &target {
        Some((path, target)) => to_target(cli, &paths, &models, (path, target), &params, monitor),
        None => together(cli, &paths, &models, &params, monitor),
    })?;
    if !cli.for_comparison {
        found.warnings.iter().for_each(|warning| monitor.console().warn(warning));
    }
    for ((model, transform), target) in models.iter().zip(&found.transforms).zip(&targets) {
        spharm::Monitor::check(monitor)?;
        let moved = signed(pool.install(|| transform.apply_model(model, monitor))?, "shape align");
        again.write(target, &moved)?;
    }
    if let (Some(path), Some(mean)) = (&cli.mean, &found.mean) {
        again.write(path, &made(mean.clone(), Kind::Surface, "shape align"))?;
    }
    let whole = mirrored.of_files(&found.transforms);
    let each = frames::written(&paths, &targets, &whole, &found.distances);
    if let Some(path) = &cli.transforms {
        again.write_json(path, &json!(each))?;
    }
    if let Some(path) = &cli.warnings {
        again.write_json(path, &json!(found.named_warnings))?;
    }
    let mut report = json!({
        "models": each,
        "pose": match method {
            Method::Surfaces => Some("surfaces"),
            Method::Joint => Some("joint"),
            _ => None,
        },
        "method": cli.method.to_possible_value().map(|value| value.get_name().to_owned()),
        "warnings": found.warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    if let (Some(report), Some(summary)) = (report.as_object_mut(), found.summary.as_object()) {
        report.extend(summary.clone());
    }
    let names = if cli.target.group {
        ["model", "distance from the mean before", "after"]
    } else {
        ["model", "rmsd before", "after"]
    };
    let mut rows = vec![names.map(str::to_owned).to_vec()];
    for (target, [before, after]) in targets.iter().zip(&found.distances) {
        rows.push(vec![target.display().to_string(), number(*before), number(*after)]);
    }
    if let (Some(before), Some(after)) =
        (found.summary["spread_before"].as_f64(), found.summary["spread_after"].as_f64())
    {
        rows.push(vec!["spread".to_owned(), number(before), number(after)]);
    }
    let force = again.replaces_report(cli.report.report.as_deref(), &report["models"]);
    finish("align", &report, &rows, &ReportArgs { force, ..cli.report.clone() })?;
    // The state file is removed last: until all outputs are written, a resumed run needs it.
    if let (Some(path), Some(journal)) = (&cli.resume, found.journal) {
        std::fs::remove_file(path).with_context(|| path.display().to_string())?;
        drop(journal);
    }
    Ok(())
}

fn to_target(
    cli: &Cli,
    paths: &[PathBuf],
    models: &[Model],
    (path, target): (&Path, &Model),
    params: &AlignParams,
    monitor: &ConsoleMonitor,
) -> Result<Found> {
    let params = AlignParams { starts: cli.starts.unwrap_or(params.starts), ..params.clone() };
    spharm::Monitor::begin(monitor, spharm::Stage::counted("align", "models"), models.len() as u64);
    let one = |(model, from): (&Model, &PathBuf)| -> Result<AlignReport> {
        spharm::Monitor::check(monitor)?;
        let found = align(&model.coefficients, &target.coefficients, &params, &Silent);
        spharm::Monitor::step(monitor, 1);
        Ok(found.with_context(|| format!("{} to {}", from.display(), path.display()))?.report)
    };
    // Collect all results before returning an error, so that the error doesn't depend on the order in which threads
    // finish.
    let reports: Vec<Result<AlignReport>> = models.par_iter().zip(paths).map(one).collect();
    spharm::Monitor::end(monitor);
    let reports = reports.into_iter().collect::<Result<Vec<_>>>()?;
    let warning = |(report, path): (&AlignReport, &PathBuf)| -> Vec<String> {
        report.warnings.iter().map(|warning| format!("{}: {warning}", path.display())).collect()
    };
    Ok(Found {
        transforms: reports.iter().map(|report| report.transform).collect(),
        distances: reports.iter().map(|report| [report.rmsd_before, report.rmsd_after]).collect(),
        warnings: reports.iter().zip(paths).flat_map(warning).collect(),
        named_warnings: Vec::new(),
        summary: json!({
            "to": shown(path),
            "degree": reports.first().map(|report| report.degree),
            "ends": reports.iter().map(|report| &report.ends).collect::<Vec<_>>(),
            "surface_distances": reports.iter().map(|report| report.surface_distance).collect::<Vec<_>>(),
        }),
        mean: None,
        journal: None,
    })
}

fn together(
    cli: &Cli,
    paths: &[PathBuf],
    models: &[Model],
    params: &AlignParams,
    monitor: &ConsoleMonitor,
) -> Result<Found> {
    let default = ProcrustesParams::default();
    let align = AlignParams { starts: cli.starts.unwrap_or(default.align.starts), ..params.clone() };
    let params = ProcrustesParams { align, templates: cli.templates, ..default };
    let members: Vec<Coefficients> = models.iter().map(|model| model.coefficients.clone()).collect();
    let mut journal = cli.resume.as_ref().map(|path| journal(path, &members, &params, monitor)).transpose()?;
    let found = procrustes_with(&members, &params, journal.as_mut(), monitor)?;
    let report = &found.report;
    let ends: Vec<Value> = report
        .ends
        .iter()
        .map(|end| json!({ "template": end.template, "spread": end.spread, "rounds": end.rounds }))
        .collect();
    let named = |warning: &ProcrustesWarning, name: &dyn Fn(&Path) -> String| -> String {
        warning.naming(|member| name(&paths[member]))
    };
    let mut own: Vec<String> = report.warnings.iter().map(|of| named(of, &|path: &Path| shown(path))).collect();
    // The named warnings omit units, because the quality control of a study compares the sizes itself.
    let of_poses = report.warnings.iter().filter(|warning| !matches!(warning, ProcrustesWarning::Unit(_)));
    let named_warnings = of_poses.map(|warning| named(warning, &model_name));
    let axes: Vec<_> = models.iter().map(|model| model.provenance.axes()).collect();
    own.extend(axes_differ(&axes, paths, |path| shown(path)));
    own.extend(equal_models(&members, paths, |path| shown(path)));
    let mirrored = report.warnings.iter().flat_map(ProcrustesWarning::mirrored);
    let before = distances_from_mean(&members, report.degree)?;
    Ok(Found {
        transforms: found.transforms.clone(),
        distances: before.into_iter().zip(&report.rmsd).map(|(before, after)| [before, *after]).collect(),
        warnings: own,
        named_warnings: named_warnings.chain(axes_differ(&axes, paths, model_name)).collect(),
        summary: json!({
            "degree": report.degree,
            "spread_before": report.spread_before,
            "spread_after": report.spread_after,
            "templates": ends,
            "mirrored": all_shown(mirrored.map(|member| &paths[*member])),
            "surface_distances": report.surface_distances,
            "mean": cli.mean.as_ref().map(shown),
        }),
        mean: Some(found.mean),
        journal,
    })
}
