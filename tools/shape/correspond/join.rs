//! Surfaces that are added to a group, one at a time; what is done already is left as it is.

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use spharm::correspond::{CorrespondParams, GroupFiles, Joining, MemberOrigin, MemberReport};
use spharm::{FileRecord, Model};
use spharm_cli::Usage;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, same_place};
use spharm_cli::paths::shown;

use super::super::outputs::finish;
use super::surfaces::{Surface, plan};
use super::{Cli, member_json, rows};

/// Share of a surface, or of the template, without a counterpart from which a member is named.
const LACKING: f64 = 0.05;

pub(super) fn run(cli: &Cli, group: &Path, surfaces: &[Surface], monitor: &ConsoleMonitor) -> Result<()> {
    let started = Instant::now();
    if same_place(&cli.output_dir.join("group.json"), &group.join("group.json")) {
        return Err(Usage::conflict("--output-dir is another folder than that of --to, which stays as it is").into());
    }
    let template = GroupFiles::open(group)?.template()?;
    let surfaces: Vec<&Surface> = cli.shard.unwrap_or_default().of(surfaces).collect();
    let mut params = CorrespondParams { refinement: None, ..CorrespondParams::up_to(template.mean.max_degree()) };
    (params.pose.scale, params.pose.mirror) = (cli.scale, cli.mirror);
    let paths: Vec<PathBuf> = surfaces.iter().map(|surface| surface.path.clone()).collect();
    plan(&paths, &params, false, cli.resources.both())?;
    template.begin_folder(&cli.output_dir)?;
    let pool = cli.resources.threads.pool()?;
    let joining = pool.install(|| Joining::new(template.clone(), params.pose, params.register.clone(), monitor))?;
    let (mut members, mut added): (Vec<Value>, Vec<(String, MemberReport)>) = (Vec::new(), Vec::new());
    let (mut warnings, mut there) = (Vec::new(), 0);
    spharm::Monitor::begin(monitor, spharm::Stage::counted("members", "surfaces"), surfaces.len() as u64);
    for surface in surfaces {
        spharm::Monitor::check(monitor)?;
        let named = || surface.path.display().to_string();
        let input = FileRecord::of(&surface.path)?;
        if !cli.report.force
            && let Some(origin) = GroupFiles::origin(&cli.output_dir, &surface.name)?
        {
            if !origin.input.is_some_and(|found| found.same_contents(&input)) {
                bail!(
                    "{}: {} there was made of another file; choose another folder or give --force",
                    named(),
                    surface.name
                );
            }
            there += 1;
            spharm::Monitor::step(monitor, 1);
            continue;
        }
        let mesh = surface.read().with_context(named)?;
        let found = pool.install(|| joining.add(&mesh, monitor)).with_context(named)?;
        let of_member = warnings_of(&found.report, template.masked.len());
        warnings.extend(of_member.iter().map(|text| format!("{}: {text}", surface.name)));
        let origin = MemberOrigin { name: surface.name.clone(), input: Some(input), warnings: of_member };
        let left = left_over(&cli.output_dir, &surface.name);
        found.write(&cli.output_dir, &origin, cli.report.force || left).with_context(named)?;
        members.push(member_json(surface, &found.report, &found.similarity));
        added.push((surface.name.clone(), found.report));
        spharm::Monitor::step(monitor, 1);
    }
    spharm::Monitor::end(monitor);
    warnings.iter().for_each(|warning| monitor.console().warn(warning));
    let report = json!({
        "output_dir": shown(&cli.output_dir),
        "to": shown(group),
        "members": members,
        "there_already": there,
        "warnings": warnings,
        "seconds": started.elapsed().as_secs_f64(),
    });
    finish("correspond", &report, &rows(added.iter().map(|(name, found)| (name.as_str(), found))), &cli.report)?;
    if there > 0 {
        monitor.console().note(format!("{} there already", counted(there, "member")));
    }
    Ok(())
}

/// Whether there is a model that a run was ended after: the member's record, which is written last, isn't there. A model of another
/// verb is somebody else's.
fn left_over(folder: &Path, name: &str) -> bool {
    let ours = |path: PathBuf| {
        Model::read(path).is_ok_and(|model| model.provenance.tool.as_deref() == Some("shape correspond"))
    };
    let [model, _, record] = GroupFiles::of_member(folder, name);
    !record.exists() && ours(model)
}

fn warnings_of(found: &MemberReport, directions: usize) -> Vec<String> {
    let mut warnings = Vec::new();
    if found.unreached > LACKING {
        warnings.push(format!(
            "the group's mean doesn't reach {:.1} % of it, by at most {:.4}: it may be of another kind, or have parts that the \
             group lacks",
            100.0 * found.unreached,
            found.cover_farthest
        ));
    }
    let share = found.without_counterpart as f64 / directions.max(1) as f64;
    if share > LACKING {
        warnings
            .push(format!("{:.1} % of the group's places have no counterpart on it: they are guesses", 100.0 * share));
    }
    warnings
}
