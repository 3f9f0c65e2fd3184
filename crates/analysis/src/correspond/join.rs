//! `shape correspond --to`: adds surfaces to a finished group, and skips surfaces that are already members.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use serde_json::{Value, json};
use spharm::correspond::{CorrespondParams, GroupFiles, IDENTICAL_TO, Joining, MemberOrigin, MemberReport};
use spharm::{FileRecord, Model};
use spharm_cli::Usage;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, same_place};
use spharm_cli::paths::shown;

use super::super::outputs::finish;
use super::surfaces::{Surface, plan, volume_warnings};
use super::{Cli, member_json, rows};

/// Maximum number of existing members used to refine a new member's correspondence.
const REFERENCES: usize = 300;
/// Maximum number of existing members with which a new member is compared if the group has no refinement.
const COMPARED: usize = 8;

pub(super) fn run(cli: &Cli, group: &Path, surfaces: &[Surface], monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    if same_place(&cli.output_dir.join("group.json"), &group.join("group.json")) {
        let text = "--output-dir must differ from --to, because an existing group is never changed";
        return Err(Usage::conflict(text).into());
    }
    let files = GroupFiles::open(group)?;
    let template = files.template()?;
    let members = files.coefficients(if template.refined { REFERENCES } else { COMPARED })?;
    let surfaces: Vec<&Surface> = cli.shard.unwrap_or_default().of(surfaces).collect();
    let mut params = CorrespondParams::up_to(template.mean.max_degree()).with_refinement(None);
    (params.pose, params.keep_poses) = cli.poses();
    let scaled = files.is_scaled()?;
    if cli.scale && !scaled {
        let text =
            "--scale doesn't apply to --to: the members of this group keep their own sizes, and so do new members";
        return Err(Usage::conflict(text).into());
    }
    params.pose.scale = scaled && !params.keep_poses;
    params.check_poses()?;
    let paths: Vec<PathBuf> = surfaces.iter().map(|surface| surface.path.clone()).collect();
    plan(&paths, &params, Some(members.len()), cli.resources.both())?;
    template.begin_folder(&cli.output_dir)?;
    let existing = files.names().iter().map(|name| -> Result<Option<Existing>> {
        let Some(origin) = GroupFiles::origin(group, name)? else { return Ok(None) };
        Ok(Some(Existing { name: name.clone(), input: origin.input, report: files.registration(name)? }))
    });
    let existing: Vec<Existing> = existing.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect();
    let pool = cli.resources.threads.pool()?;
    let joining = pool.install(|| Joining::new(template.clone(), &members, &params, monitor))?;
    let one = |surface: &&Surface| -> Result<Option<Added>> {
        spharm::Monitor::check(monitor)?;
        let found = added(cli, surface, (&joining, &existing), monitor);
        spharm::Monitor::step(monitor, 1);
        found.with_context(|| surface.path.display().to_string())
    };
    spharm::Monitor::begin(monitor, spharm::Stage::counted("members", "surfaces"), surfaces.len() as u64);
    let mut done: Vec<Option<Added>> = Vec::with_capacity(surfaces.len());
    // Process one surface per thread at a time. Collect all results before returning an error, so that the error
    // doesn't depend on the order in which threads finish.
    for some in surfaces.chunks(pool.current_num_threads()) {
        let found: Vec<Result<Option<Added>>> = pool.install(|| some.par_iter().map(one).collect());
        done.extend(found.into_iter().collect::<Result<Vec<_>>>()?);
    }
    let there = done.iter().filter(|found| found.is_none()).count();
    let done: Vec<Added> = done.into_iter().flatten().collect();
    let doubts = volume_warnings(surfaces.iter().copied());
    let warnings: Vec<&String> = doubts.iter().chain(done.iter().flat_map(|found| &found.warnings)).collect();
    spharm::Monitor::end(monitor);
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    let report = json!({
        "output_dir": shown(&cli.output_dir),
        "to": shown(group),
        "members": done.iter().map(|found| &found.json).collect::<Vec<_>>(),
        "there_already": there,
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    finish("correspond", &report, &rows(done.iter().map(|found| (found.name.as_str(), &found.report))), &cli.report)?;
    for surface in surfaces.iter().filter(|surface| files.names().contains(&surface.name)) {
        monitor.console().note(format!("{}: the group already has a member with this name", surface.name));
    }
    if there > 0 {
        monitor.console().note(format!("kept {} from an earlier run", counted(there, "member")));
    }
    Ok(())
}

/// A member of the group, with the record of its surface's file and the report on its registration.
struct Existing {
    name: String,
    input: Option<FileRecord>,
    report: MemberReport,
}

/// Result of adding a surface to a group.
struct Added {
    name: String,
    report: MemberReport,
    json: Value,
    warnings: Vec<String>,
}

/// Adds a surface to the group. Returns `None` if an earlier run has already added the surface. Warns if an existing
/// member has the same surface.
fn added(
    cli: &Cli,
    surface: &Surface,
    (joining, existing): (&Joining, &[Existing]),
    monitor: &ConsoleMonitor,
) -> Result<Option<Added>> {
    let (input, name) = (surface.record()?, surface.name.clone());
    if !cli.report.force
        && let Some(origin) = GroupFiles::origin(&cli.output_dir, &name)?
    {
        if !origin.input.is_some_and(|found| found.same_contents(&input)) {
            bail!("the existing member {name} was made from another file; choose another folder or give --force");
        }
        if origin.mirrored != surface.mirrored {
            let with = if origin.mirrored { "with" } else { "without" };
            bail!("the existing member {name} was made {with} --mirrored; choose another folder or give --force");
        }
        // Records written by earlier versions don't contain the order of the axes.
        if let (Some(found), Some(axes)) = (&origin.axes, surface.axes())
            && *found != axes
        {
            bail!(
                "the existing member {name} was made with --axes {found}, not {axes}; choose another folder or give \
                 --force"
            );
        }
        return Ok(None);
    }
    let add = if surface.mirrored { Joining::add_mirrored } else { Joining::add };
    let found = add(joining, &surface.read()?, monitor)?;
    let is_same = |member: &&Existing| {
        let same_file = member.input.as_ref().is_some_and(|other| other.same_contents(&input));
        same_file || member.report.same_surface(&found.report)
    };
    let same = existing.iter().find(is_same).map(|member| format!("{IDENTICAL_TO}{}", member.name));
    // `of_member` needs no names of other members here, because only warnings about equal members of a new group
    // contain such names.
    let others = found.warnings.iter().map(|of| of.of_member(|_| String::new()));
    let of_member: Vec<String> = same.into_iter().chain(others).collect();
    let warnings = of_member.iter().map(|text| format!("{name}: {text}")).collect();
    let origin = MemberOrigin {
        name: name.clone(),
        input: Some(input),
        mirrored: surface.mirrored,
        axes: surface.axes(),
        warnings: of_member,
    };
    found.write(&cli.output_dir, &origin, cli.report.force || left_over(&cli.output_dir, &name))?;
    let json = member_json(surface, &found.report, &found.similarity);
    Ok(Some(Added { name, report: found.report, json, warnings }))
}

/// Returns whether an interrupted run of `shape correspond` left a member's model without the member's record, which is
/// written after the model.
fn left_over(folder: &Path, name: &str) -> bool {
    let ours = |path: PathBuf| {
        Model::read(path).is_ok_and(|model| model.provenance.tool.as_deref() == Some("shape correspond"))
    };
    let [model, _, record] = GroupFiles::of_member(folder, name);
    !record.exists() && ours(model)
}
