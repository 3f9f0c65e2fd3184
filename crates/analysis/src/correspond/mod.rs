//! `shape correspond`: fits models of all surfaces over one sphere, so that equal directions are corresponding points.

mod join;
mod marks;
pub(crate) mod surfaces;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;

use anyhow::{Context, Result};
use clap::{Args, ValueEnum};
use serde::Deserialize;
use serde_json::{Value, json};
use spharm::correspond::{
    CorrespondParams, Group, GroupFiles, MemberOrigin, MemberReport, Resume, Signals, correspond,
};
use spharm::parametrize::volume::is_volume;
use spharm::shape::{GroupQuality, QualityParams, group_quality};
use spharm::{Coefficients, FileRecord, Sphere};
use spharm_cli::Usage;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::inputs::expand_lists;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::names::NameTemplate;
use spharm_cli::output::{OutputFile, check_outputs, write_json};
use spharm_cli::paths::shown;
use spharm_cli::surfaces::refuse_for_mesh;
use spharm_cli::volumes::VolumeArgs;
use spharm_cohort::Shard;
use spharm_monitor::number;
use spharm_surface::Similarity;
use spharm_surface::pose::{PoseParams, PoseSearch};

use self::surfaces::{Surface, With, find_signals, of_table, plan, read, surfaces, volume_warnings};
use super::args::{ReportArgs, Resources};
use super::mirrored::among;
use super::outputs::finish;

/// Make surfaces correspond: fit models of all surfaces over one sphere
///
/// A template is mapped to the sphere, and registered in space to every surface. Surfaces may have any topology,
/// including handles, holes and stray pieces, and don't need a common pose. All surfaces are fitted over the template's
/// sphere, in one frame, and the group's own statistics refine the correspondence. With --to, surfaces are added to an
/// existing group: the new members are written to the output folder, and the folder of the group isn't changed.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape correspond vertebrae/*.ply --max-degree 40 -o group",
        "spharm shape correspond @subjects.txt --max-degree 15 --landmarks landmarks/ -o group --report group.json",
        "spharm shape correspond --table subjects.tsv --max-degree 15 -o group",
        "spharm shape correspond aseg/*.mgz --label 17 --max-degree 12 -o hippocampi",
        "spharm shape correspond s*/lh.white --max-degree 40 --name-template {parent} --with lh.thickness:0.2 -o group",
        "spharm shape correspond @new.txt --to group --shard 3/10 -o added",
        "spharm shape quality group/s*.spharm.npz",
    ],
    &[
        help::MESHES,
        help::VOLUMES,
        "The output folder gets a model of each surface and the mean, all in the group's frame; places/ with the \
         corresponding positions; members/ with each member's transform and coverage; and group.json.",
    ],
))]
pub(super) struct Cli {
    /// Meshes, label volumes or models, or @LIST with one path per line
    #[arg(value_name = "SURFACE", required_unless_present = "table", help_heading = INPUT)]
    surfaces: Vec<PathBuf>,
    /// Table of the surfaces, with columns id and surface, and optionally label, landmarks, mirrored and signals
    ///
    /// The table is TSV, or CSV if its name ends in .csv. Paths are relative to the table. Members are named by their
    /// ids. The column `mirrored` (yes or no) replaces --mirrored.
    #[arg(long, value_name = "TABLE", conflicts_with_all = ["surfaces", "name_template", "landmarks", "mirrored"], help_heading = INPUT)]
    table: Option<PathBuf>,
    /// Label to use in the volumes; needed only if a volume has several labels
    ///
    /// With --table, each row may have its own label.
    ///
    /// A label's surface is smoothed by up to half a voxel, because otherwise the template would follow the steps
    /// between voxels.
    #[arg(long, value_name = "N", help_heading = INPUT)]
    label: Option<i64>,
    #[command(flatten, next_help_heading = INPUT)]
    volume: VolumeArgs,
    /// Degree of the models
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    #[arg(value_parser = clap::value_parser!(u16).range(1..=1000))]
    max_degree: Option<u16>,
    /// Surface to use as the first template [default: the most typical surface]
    ///
    /// The template's holes are filled and its handles are cut. Quality measures and tests skip the parts of the
    /// template that exist only because of these repairs.
    #[arg(long, value_name = "FILE", conflicts_with = "to", help_heading = INPUT)]
    template: Option<PathBuf>,
    /// Existing group to which the surfaces are added; the group's own folder isn't changed
    #[arg(long, value_name = "GROUP", conflicts_with_all = ["max_degree", "rounds", "no_refinement", "subdivisions"], help_heading = INPUT)]
    to: Option<PathBuf>,
    /// With --to, process only part I of N parts of the surfaces (every N-th surface): I/N, with I counted from 0, or
    /// slurm in an array of Slurm jobs
    #[arg(long, value_name = "I/N", help_heading = INPUT)]
    shard: Option<Shard>,
    /// Landmarks in the surfaces' own frames, to check the correspondence
    ///
    /// Give a folder with one file per surface, named like the surface, or one file per surface, in the surfaces'
    /// order. The files are .mrk.json, .fcsv, .json, .csv or .tsv.
    #[arg(long, value_name = "FILE", num_args = 1.., conflicts_with = "to", help_heading = INPUT)]
    landmarks: Vec<PathBuf>,
    /// Also let the landmarks guide the registration
    ///
    /// The template's landmarks are pulled to each surface's landmarks, and held there in the refinement. Five more
    /// registrations each omit a fifth of the landmarks, and measure the error at the omitted landmarks. A template
    /// given by --template must be one of the surfaces.
    #[arg(long, conflicts_with = "to", help_heading = METHOD)]
    guide: bool,
    /// Signals on the surfaces, such as thickness, to match in the refinement [default weight: 0.1]
    ///
    /// SIGNAL is a column of the table, or the name of a file in each surface's folder, in which {stem} stands for the
    /// surface's file name without its extension. A difference of one standard deviation of the signal counts as much
    /// as a distance of WEIGHT times the square root of the surface's area. For comparison, normals have weight 0.12.
    #[arg(long, value_name = "SIGNAL[:WEIGHT]", num_args = 1.., conflicts_with_all = ["to", "no_refinement"], help_heading = METHOD)]
    with: Vec<With>,
    /// Rounds of registration; from the second round on, the group's mean is the template
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u8).range(1..=10), help_heading = METHOD)]
    rounds: u8,
    /// Subdivisions of the icosphere whose directions are registered [default: 4; 5 above degree 15; 6 above degree 40]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..=8), help_heading = METHOD)]
    subdivisions: Option<u32>,
    /// Skip the refinement by the group's statistics
    #[arg(long, help_heading = METHOD)]
    no_refinement: bool,
    /// Poses to consider
    ///
    /// With `any`, all rotations of a surface are tried. A surface that looks nearly the same after a half turn may
    /// then be turned over. With `near`, the surface's own pose is only improved. Use `near` for surfaces in one
    /// coordinate system, such as scans in template space. With `given`, the surface isn't moved, so an alignment can't
    /// spread a local change over the whole surface. `given` can't be combined with --scale or --mirror.
    #[arg(long, value_name = "POSE", value_enum, default_value_t = Poses::Any, help_heading = METHOD)]
    pose: Poses,
    /// Scale surfaces to a common size
    #[arg(long, help_heading = METHOD)]
    scale: bool,
    /// Also match mirror images
    #[arg(long, help_heading = METHOD)]
    mirror: bool,
    /// Surfaces to mirror first (x to -x), such as right hemispheres in a group of left hemispheres
    ///
    /// The models describe the mirrored surfaces. Transforms to the group's frame include the reflection.
    #[arg(long, value_name = "SURFACE", num_args = 1.., help_heading = METHOD)]
    mirrored: Vec<PathBuf>,
    /// Output folder
    #[arg(short, long, value_name = "DIR", help_heading = OUTPUT)]
    output_dir: PathBuf,
    /// Names of the members' files
    #[arg(long, value_name = "TEMPLATE", default_value = "{stem}", help_heading = OUTPUT)]
    name_template: NameTemplate,
    /// Folder that keeps registrations until the group is written, so that the same command resumes an interrupted run
    #[arg(long, value_name = "DIR", conflicts_with = "to", help_heading = OUTPUT)]
    resume: Option<PathBuf>,
    /// File for the warnings, for a study's page
    #[arg(long, value_name = "OUT.json", conflicts_with = "to", hide = true)]
    warnings: Option<PathBuf>,
    #[command(flatten)]
    report: ReportArgs,
    #[command(flatten)]
    resources: Resources,
}

/// Poses of surfaces that are considered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, ValueEnum, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Poses {
    /// All rotations
    #[default]
    Any,
    /// The surfaces' own poses, improved
    Near,
    /// The surfaces' own poses, unchanged
    Given,
}

impl Cli {
    /// Returns the settings for computing poses, and whether the surfaces keep their own poses.
    fn poses(&self) -> (PoseParams, bool) {
        let search = match self.pose {
            Poses::Any => PoseSearch::Any,
            Poses::Near | Poses::Given => PoseSearch::Near,
        };
        let params = PoseParams { search, scale: self.scale, mirror: self.mirror, ..PoseParams::default() };
        (params, self.pose == Poses::Given)
    }
}

/// Runs the subcommand.
pub(super) fn run(cli: &Cli, monitor: &ConsoleMonitor) -> Result<()> {
    let of_report = cli.report.report.as_deref().map(|path| OutputFile::new(path, "--report"));
    let of_warnings = cli.warnings.as_deref().map(|path| OutputFile::new(path, "--warnings"));
    check_outputs(of_report.into_iter().chain(of_warnings), cli.report.force)?;
    let (mut surfaces, landmarks) = match &cli.table {
        Some(table) => of_table(table)?,
        None => (surfaces(&cli.surfaces, &cli.name_template)?, cli.landmarks.clone()),
    };
    if let Some(surface) = surfaces.first().filter(|_| surfaces.iter().all(|surface| !is_volume(&surface.path))) {
        refuse_for_mesh(&surface.path, &[], cli.volume.reading())?;
    }
    for surface in &mut surfaces {
        surface.label = surface.label.or(cli.label);
        (surface.reading, surface.radius) = (cli.volume.reading(), cli.volume.smooth_radius);
    }
    let paths: Vec<PathBuf> = surfaces.iter().map(|surface| surface.path.clone()).collect();
    let mirrored = among(&expand_lists(&cli.mirrored)?, &paths, "surfaces")?;
    surfaces.iter_mut().zip(mirrored).for_each(|(surface, mirrored)| surface.mirrored |= mirrored);
    find_signals(&mut surfaces, &cli.with, cli.table.as_deref())?;
    match &cli.to {
        Some(group) => join::run(cli, group, &surfaces, monitor),
        None => together(cli, &Arc::new(surfaces), &landmarks, monitor),
    }
}

fn together(cli: &Cli, surfaces: &Arc<Vec<Surface>>, landmarks: &[PathBuf], monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    let Some(max_degree) = cli.max_degree.map(usize::from) else {
        return Err(Usage::missing("--max-degree is required unless --to is given").into());
    };
    // clap doesn't require --to if an argument that conflicts with --to is given.
    if cli.shard.is_some() {
        return Err(Usage::missing(
            "--shard can only be used with --to (an existing group); a new group can't be split into shards",
        )
        .into());
    }
    let of_member = |surface: &Surface| GroupFiles::of_member(&cli.output_dir, &surface.name);
    let mut files: Vec<PathBuf> = surfaces.iter().flat_map(of_member).collect();
    files.extend(GroupFiles::of_group(&cli.output_dir));
    let outputs = files.iter().map(|path| OutputFile::new(path, "--output-dir"));
    let inputs = surfaces.iter().map(|surface| surface.path.as_path());
    spharm_cli::output::check_files(inputs, outputs, cli.report.force)?;
    let template = cli.template.as_deref().map(read).transpose()?;
    let mut params = CorrespondParams::up_to(max_degree)
        .with_template(template)
        .with_subdivisions(cli.subdivisions)
        .with_rounds(usize::from(cli.rounds))
        .with_mirrored(surfaces.iter().map(|surface| surface.mirrored).collect::<Vec<_>>())
        .with_memory(cli.resources.memory.memory.map(|size| size.0));
    if cli.no_refinement {
        params.refinement = None;
    }
    if !cli.with.is_empty() {
        let (weights, of) = (cli.with.iter().map(|with| with.weight).collect(), Arc::clone(surfaces));
        params.signals = Some(Signals { weights, read: Arc::new(move |index| of[index].read_signals()) });
    }
    (params.pose, params.keep_poses) = cli.poses();
    let paths: Vec<PathBuf> = surfaces.iter().map(|surface| surface.path.clone()).collect();
    plan(&paths, &params, None, cli.resources.both())?;
    let marks = marks::read(landmarks, surfaces)?;
    if cli.guide {
        params.guide = Some(marks::guide(marks.as_ref(), cli.template.as_deref(), &paths)?);
    }
    let pool = cli.resources.threads.pool()?;
    let origins = surfaces.iter().map(|surface| -> Result<_> {
        Ok(MemberOrigin {
            name: surface.name.clone(),
            input: Some(surface.record()?),
            mirrored: surface.mirrored,
            axes: surface.axes(),
            warnings: Vec::new(),
        })
    });
    let mut origins = origins.collect::<Result<Vec<_>>>()?;
    if let Some(folder) = &cli.resume {
        params.resume = Some(Resume::open(folder, &resume_key(cli, &params, &origins)?).context("--resume")?);
    }
    let of = |index: usize| surfaces[index].read();
    let group = pool.install(|| correspond(surfaces.len(), &of, &params, monitor));
    let names = marks.as_ref().map_or(&[][..], |marks| &marks.names);
    let group = group.map_err(|error| {
        let far = marks::far(&error, names, surfaces);
        far.unwrap_or_else(|| surfaces::named(error, surfaces))
    })?;
    let mut warnings = volume_warnings(surfaces.iter());
    warnings.extend(surfaces::of_group(&group, surfaces));
    for warning in &group.report.warnings {
        let member = warning.member();
        let text = warning.of_member(|other| surfaces[other].name.clone());
        warnings.push(format!("{}: {text}", surfaces[member].name));
        origins[member].warnings.push(text);
    }
    let quality = pool.install(|| quality(&group, monitor))?;
    let marks = marks.map(|marks| pool.install(|| marks::errors(marks, surfaces, &group, monitor))).transpose()?;
    warnings.extend(marks.iter().flat_map(|marks| marks.warnings.iter().cloned()));
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    spharm::Monitor::check(monitor)?;
    group.write(&cli.output_dir, &origins, cli.report.force).context("--output-dir")?;
    if let Some(path) = &cli.warnings {
        write_json(path, cli.report.force, &json!(warnings))?;
    }
    params.resume.take().map(Resume::remove).transpose().context("--resume")?;
    let first = group.report.template.map(|index| surfaces[index].name.as_str());
    let report = json!({
        "output_dir": shown(&cli.output_dir),
        "degree": max_degree,
        "directions": group.template.masked.len(),
        "masked": group.template.masked.iter().filter(|masked| **masked).count(),
        "template": first.map_or_else(|| cli.template.as_ref().map(shown), |name| Some(name.to_owned())),
        "changes": group.report.changes,
        "members": surfaces.iter().zip(&group.report.members).zip(&group.similarities).map(|((surface, member), similarity)| {
            member_json(surface, member, similarity)
        }).collect::<Vec<_>>(),
        "spread": group.template.spread,
        "quality": quality.as_ref().map(|found| json!({
            "variance": found.variance,
            "compactness": found.compactness.values,
            "generalisation": found.generalisation.values,
            "specificity": found.specificity.values,
        })),
        "landmarks": marks.as_ref().map(marks::Errors::json),
        "warnings": warnings,
        "seconds": {
            "whole": started.elapsed().as_secs_f64(),
            "steps": group.report.seconds.iter().map(|(name, seconds)| json!([name, seconds])).collect::<Vec<_>>(),
        },
    });
    let names = |(surface, moved): (&Surface, &Similarity)| {
        surface.name.clone() + if moved.mirrors() { " (mirrored)" } else { "" }
    };
    let names: Vec<String> = surfaces.iter().zip(&group.similarities).map(names).collect();
    let rows = rows(names.iter().map(String::as_str).zip(&group.report.members));
    finish("correspond", &report, &rows, &cli.report)?;
    let console = monitor.console();
    if let Some(found) = &quality {
        let line = |curve: &spharm::shape::Curve| {
            curve.values.iter().map(|value| number(*value)).collect::<Vec<_>>().join(", ")
        };
        let (general, specific) = (line(&found.generalisation), line(&found.specificity));
        console.note(format!("with 1, 2 and 3 modes: generalisation {general}; specificity {specific}"));
    }
    if let Some(marks) = &marks {
        console.note(marks.line());
    }
    Ok(())
}

/// Returns a hash of all inputs and settings on which the registrations depend.
fn resume_key(cli: &Cli, params: &CorrespondParams, origins: &[MemberOrigin]) -> Result<String> {
    let template = cli.template.as_deref().map(FileRecord::of).transpose()?;
    let CorrespondParams { max_degree, subdivisions, rounds, pose, register, guide, mirrored, .. } = params;
    let settings = format!("{max_degree} {subdivisions:?} {rounds} {pose:?} {register:?} {guide:?} {mirrored:?}");
    let contents = |record: &FileRecord| json!(record.contents());
    let key = json!({
        "version": env!("CARGO_PKG_VERSION"),
        "surfaces": origins.iter().map(|origin| origin.input.as_ref().map(contents)).collect::<Vec<_>>(),
        "voxel_size": cli.volume.voxel_size.map(|size| size.0),
        "axes": cli.volume.axes.name(),
        "threshold": cli.volume.threshold,
        "probability": cli.volume.probability,
        "image": [cli.volume.channel, cli.volume.time],
        "smooth_radius": cli.volume.smooth_radius,
        "template": template.as_ref().map(contents),
        "settings": settings,
    });
    Ok(key.to_string())
}

/// Returns generalisation and specificity with at most three modes; `None` for a group of two.
fn quality(group: &Group, monitor: &ConsoleMonitor) -> Result<Option<GroupQuality>> {
    let members: Vec<Coefficients> = group.models.iter().map(|model| model.coefficients.clone()).collect();
    let params = QualityParams { modes: 3, samples: 200, bands: 0, surfaces: false, ..QualityParams::default() };
    let mask = group.template.kept_at(Sphere::icosphere(params.subdivisions).directions.as_slice());
    let params = QualityParams { mask: Some(mask), ..params };
    match members.len() {
        0..3 => Ok(None),
        _ => Ok(Some(group_quality(&members, None, &params, monitor)?)),
    }
}

fn member_json(surface: &Surface, member: &MemberReport, similarity: &Similarity) -> Value {
    json!({
        "name": surface.name,
        "input": shown(&surface.path),
        "to_group": similarity,
        "registration": member,
    })
}

/// Returns the rows of the table, one per member.
fn rows<'a>(members: impl Iterator<Item = (&'a str, &'a MemberReport)>) -> Vec<Vec<String>> {
    let names = ["member", "pose distance", "coverage rms", "99 %", "largest", "not reached %", "flipped", "model rms"];
    let mut rows = vec![names.map(str::to_owned).to_vec()];
    for (name, found) in members {
        let lengths = [found.pose_distance, found.cover_rms, found.cover_most, found.cover_farthest];
        let mut row = vec![name.to_owned()];
        row.extend(lengths.map(number));
        row.extend([format!("{:.2}", 100.0 * found.unreached), found.turned.to_string(), number(found.model_rms)]);
        rows.push(row);
    }
    rows
}
