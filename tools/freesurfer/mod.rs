//! `freesurfer`: fits the surfaces of a SUBJECTS_DIR, each on its own registered sphere.

mod args;
mod check;

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::{Map, json};
use spharm::FitParams;
use spharm::cohort::{Row, check_id};
use spharm::rerun::IfExists;
use spharm_cli::console::Console;
use spharm_cli::memory::Memory;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::counted;

pub(crate) use self::args::Cli;
use self::args::Hemi;
use crate::rows::{self, CohortArgs, Evaluate, Options, Rows, icosphere_within};

pub(crate) fn run(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    rows::set_log(&cli.cohort);
    let monitor = ConsoleMonitor::new(cli.common.console());
    let subjects = subjects(cli, monitor.console())?;
    let rows = rows_of(cli, &subjects);
    monitor.console().note(format!("{}, {}", counted(subjects.len(), "subject"), counted(rows.len(), "row")));
    let shard = cli.cohort.shard.unwrap_or_default();
    let rows =
        Rows { rows: shard.of(&rows).cloned().collect(), folder: cli.output.clone(), sphere: None, check_first: false };
    rows::run(rows, &options(cli)?, &monitor, started)
}

fn options(cli: &Cli) -> Result<Options> {
    let about = [("tool", json!("freesurfer")), ("subjects_dir", json!(cli.subjects_dir)), ("sphere", json!(null))];
    Ok(Options {
        params: FitParams {
            smoothness: cli.smoothness.unwrap_or_default(),
            strict: cli.strict,
            surface_distance: !cli.no_surface_distance,
            memory: cli.memory.map(|size| size.0),
            threads: Some(cli.threads.count()),
            ..FitParams::lsq(cli.max_degree)
        },
        // One subject never stops another.
        cohort: CohortArgs { keep_going: true, ..cli.cohort.clone() },
        fix: false,
        voxel_size: None,
        mask: None,
        cut_handles: false,
        coefficients_csv: false,
        if_exists: match (cli.force, cli.skip_existing) {
            (true, _) => IfExists::Replace,
            (_, true) => IfExists::Skip,
            _ => IfExists::Refuse,
        },
        report: cli.report.clone(),
        json: cli.json,
        threads: cli.threads,
        about: about.into_iter().map(|(name, value)| (name.to_owned(), value)).collect::<Map<_, _>>(),
        aligned_later: false,
        check: Some(Box::new(check::hemisphere)),
        evaluate: cli.evaluate_on.map(|n| evaluate(cli, n)).transpose()?,
    })
}

/// The icosphere on which models are evaluated.
fn evaluate(cli: &Cli, subdivisions: u32) -> Result<Evaluate> {
    let budget = Memory { memory: cli.memory }.budget(cli.threads.count());
    let sphere = icosphere_within(budget, "freesurfer --evaluate-on icosphere:", subdivisions, cli.max_degree)?;
    Ok(Evaluate { sphere, name: format!("ico{subdivisions}") })
}

/// The subjects: those that were named, or the folders with a folder `surf`, sorted by name.
fn subjects(cli: &Cli, console: &Console) -> Result<Vec<String>> {
    let folder = &cli.subjects_dir;
    let named = || format!("{}: cannot read the folder", folder.display());
    let mut found = cli.subject.clone();
    if found.is_empty() {
        let mut others = 0;
        for entry in std::fs::read_dir(folder).with_context(named)? {
            let entry = entry.with_context(named)?;
            let name = entry.file_name();
            // FreeSurfer's own average is put there by its programs.
            match name.to_str() {
                Some(name) if name.starts_with("fsaverage") => others += 1,
                Some(name) if entry.path().join("surf").is_dir() => found.push(name.to_owned()),
                None if entry.path().join("surf").is_dir() => {
                    bail!("{}: expected a name in UTF-8; rename the folder", entry.path().display())
                }
                _ => {}
            }
        }
        found.sort_unstable();
        if others > 0 {
            console.note(format!("{} named fsaverage* left out; --subject takes them", counted(others, "folder")));
        }
    }
    for name in cli.surface.iter().chain(&cli.signal).chain([&cli.sphere]) {
        if let Err(expected) = check_id(name) {
            bail!("{name:?}: expected {expected}, such as white for lh.white and rh.white");
        }
    }
    let names: Vec<&String> = cli.surface.iter().chain(&cli.signal).collect();
    let twice = names.iter().enumerate().find(|(at, name)| names[..*at].contains(name)).map(|(_, name)| name.as_str());
    let hemispheres = || cli.hemi.iter().enumerate().find(|(at, hemi)| cli.hemi[..*at].contains(hemi));
    if let Some(name) = twice.or_else(|| hemispheres().map(|(_, hemi)| hemi.name())) {
        bail!("{name} is given twice");
    }
    if found.is_empty() {
        bail!("{}: expected folders of subjects with a folder surf, found none; is it SUBJECTS_DIR?", folder.display());
    }
    for (at, subject) in found.iter().enumerate() {
        if let Err(expected) = check_id(subject) {
            bail!("{}: subject {subject:?}: expected {expected}", folder.display());
        }
        if found[..at].contains(subject) {
            bail!("--subject {subject} is given twice");
        }
        if !folder.join(subject).is_dir() {
            bail!("{}: no such subject", folder.join(subject).display());
        }
    }
    Ok(found)
}

/// A row for each subject, hemisphere, and surface or signal; those on one sphere after another.
fn rows_of(cli: &Cli, subjects: &[String]) -> Vec<Row> {
    let mut rows = Vec::new();
    for subject in subjects {
        let surf = cli.subjects_dir.join(subject).join("surf");
        for hemi in &cli.hemi {
            for name in cli.surface.iter().chain(&cli.signal) {
                rows.push(Row {
                    id: format!("{subject}.{}.{name}", hemi.name()),
                    surface: surf.join(format!("{}.{name}", hemi.name())),
                    sphere: Some(surf.join(format!("{}.{}", hemi.name(), cli.sphere))),
                    line: rows.len() + 1,
                    ..Row::default()
                });
            }
        }
    }
    rows
}

/// The hemisphere of a file by its name, and the file of the other one.
fn other_hemisphere(path: &Path) -> Option<(Hemi, std::path::PathBuf)> {
    let name = path.file_name()?.to_str()?;
    let (hemi, rest) = [Hemi::Lh, Hemi::Rh]
        .into_iter()
        .find_map(|hemi| Some((hemi, name.strip_prefix(hemi.name()).filter(|rest| rest.starts_with('.'))?)))?;
    Some((hemi, path.with_file_name(format!("{}{rest}", hemi.other().name()))))
}
