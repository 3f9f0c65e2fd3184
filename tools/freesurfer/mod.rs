//! `freesurfer`: fits the surfaces of the subjects in a SUBJECTS_DIR, each on its own registered sphere.

mod args;
mod check;
mod on;

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use serde_json::{Map, json};
use spharm::FitParams;
use spharm_cli::console::Console;
use spharm_cli::freesurfer::{CORTEX, label_file};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, first_of};
use spharm_cohort::run::{Cohort, RunParams};
use spharm_cohort::{Row, check_id};

pub(crate) use self::args::Cli;
use crate::rows::{self, CohortArgs, Options, if_exists};

pub(crate) fn run(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    rows::set_log(&cli.cohort);
    let monitor = ConsoleMonitor::new(cli.common.console());
    let (subjects, left_out) = subjects(cli, monitor.console())?;
    let rows = rows_of(cli, &subjects, monitor.console());
    check_label(cli, &rows)?;
    monitor.console().note(format!("{}, {}", counted(subjects.len(), "subject"), counted(rows.len(), "row")));
    let shard = cli.cohort.shard.unwrap_or_default();
    let cohort = Cohort::new(shard.of(&rows).cloned().collect(), cli.output.clone());
    rows::run(&cohort, &options(cli, &left_out, monitor.console())?, &monitor, started)
}

fn options(cli: &Cli, left_out: &[String], console: &Console) -> Result<Options> {
    let about = [
        ("tool", json!("freesurfer")),
        ("subjects_dir", json!(cli.subjects_dir)),
        ("left_out", json!(left_out)),
        ("sphere", json!(null)),
    ];
    let mut run = RunParams::new(
        FitParams::lsq(cli.max_degree)
            .with_smoothness(cli.smoothness.unwrap_or_default())
            .with_strict(cli.strict)
            .with_surface_distance(!cli.no_surface_distance)
            .with_memory(cli.memory.map(|size| size.0))
            .with_threads(cli.threads.count()),
    );
    run.if_exists = if_exists(cli.force, false, cli.skip_existing);
    run.check = Some(Box::new(check::hemisphere));
    run.evaluate = cli.evaluate_on.as_ref().map(|on| on::evaluate(cli, on, console)).transpose()?;
    // Continue with the other subjects if one fails.
    let cohort = CohortArgs { keep_going: true, ..cli.cohort.clone() };
    Ok(Options {
        report: cli.report.clone(),
        json: cli.json,
        about: about.into_iter().map(|(name, value)| (name.to_owned(), value)).collect::<Map<_, _>>(),
        ..Options::new(run, cli.threads).with(&cohort)
    })
}

/// Returns the names of the subjects, and the names of the skipped folders. Subjects are the given names or, without
/// names, the folders that contain a folder `surf`, sorted by name. All other folders are skipped. FreeSurfer's average
/// subjects (fsaverage*) are in neither list.
fn subjects(cli: &Cli, console: &Console) -> Result<(Vec<String>, Vec<String>)> {
    let folder = &cli.subjects_dir;
    let named = || format!("{}: cannot read the folder", folder.display());
    let (mut found, mut left_out) = (cli.subject.clone(), Vec::new());
    if found.is_empty() {
        let mut others = 0;
        for entry in std::fs::read_dir(folder).with_context(named)? {
            let entry = entry.with_context(named)?;
            let name = entry.file_name();
            // FreeSurfer's programs put the average subjects fsaverage* into SUBJECTS_DIR.
            match name.to_str() {
                Some(name) if name.starts_with("fsaverage") => others += 1,
                Some(name) if entry.path().join("surf").is_dir() => found.push(name.to_owned()),
                None if entry.path().join("surf").is_dir() => {
                    bail!("{}: expected a name in UTF-8; rename the folder", entry.path().display())
                }
                Some(name) if name.starts_with('.') => {}
                _ if !entry.path().is_dir() => {}
                _ => left_out.push(name.to_string_lossy().into_owned()),
            }
        }
        found.sort_unstable();
        left_out.sort_unstable();
        if !left_out.is_empty() {
            let (count, names) = (counted(left_out.len(), "folder"), left_out.join(", "));
            console.warn(format!(
                "{}: skipped {count} without a folder `surf`: {names}; did recon-all end early?",
                folder.display()
            ));
        }
        if others > 0 {
            console.note(format!(
                "skipped {} named fsaverage*; to fit one, name it with --subject",
                counted(others, "folder")
            ));
        }
    }
    for name in cli.surface.iter().chain(&cli.signal).chain([&cli.sphere]).chain(&cli.mask) {
        if let Err(expected) = check_id(name) {
            let expected = expected.replacen("an id", "a name", 1);
            bail!("{name:?}: expected {expected}, such as white for lh.white and rh.white");
        }
    }
    let names: Vec<&String> = cli.surface.iter().chain(&cli.signal).collect();
    let twice = names.iter().enumerate().find(|(at, name)| names[..*at].contains(name)).map(|(_, name)| name.as_str());
    let hemispheres = || cli.hemi.iter().enumerate().find(|(at, hemi)| cli.hemi[..*at].contains(hemi));
    if let Some(name) = twice.or_else(|| hemispheres().map(|(_, hemi)| hemi.name())) {
        bail!("{name} is given twice; name each surface, signal and hemisphere only once");
    }
    if found.is_empty() {
        bail!(
            "{}: expected subject folders that each contain a folder `surf`, found none; is this SUBJECTS_DIR?",
            folder.display()
        );
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
    Ok((found, left_out))
}

/// Returns a row for each combination of subject, hemisphere, and surface or signal. Rows that use the same sphere are
/// adjacent.
fn rows_of(cli: &Cli, subjects: &[String], console: &Console) -> Vec<Row> {
    let (mut rows, mut whole) = (Vec::new(), Vec::new());
    for subject in subjects {
        let folder = cli.subjects_dir.join(subject);
        let surf = folder.join("surf");
        for hemi in &cli.hemi {
            let label = label_file(&folder, *hemi, cli.mask.as_deref().unwrap_or(CORTEX));
            let region = match cli.mask.as_deref() {
                Some("none") => None,
                // A label named by --mask must exist; the default label is used only if it exists.
                Some(_) => Some(label),
                None => Some(label).filter(|label| label.exists()),
            };
            if region.is_none() && cli.mask.is_none() && !cli.signal.is_empty() {
                whole.push(format!("{subject} {}", hemi.name()));
            }
            let signals = cli.signal.iter().map(|name| (name, region.clone()));
            for (name, region) in cli.surface.iter().map(|name| (name, None)).chain(signals) {
                rows.push(Row {
                    id: format!("{subject}.{}.{name}", hemi.name()),
                    surface: surf.join(format!("{}.{name}", hemi.name())),
                    sphere: Some(surf.join(format!("{}.{}", hemi.name(), cli.sphere))),
                    region,
                    line: rows.len() + 1,
                    ..Row::default()
                });
            }
        }
    }
    if !whole.is_empty() {
        const NAMED: usize = 5;
        console.warn(format!(
            "found no label/?h.{CORTEX}.label for {}, so values on the medial wall are fitted as well; give another \
             label with --mask",
            first_of(whole.iter().map(String::as_str), NAMED)
        ));
    }
    rows
}

/// Refuses a label that no subject has. If only some subjects have the label, the fits of the other subjects fail
/// individually.
fn check_label(cli: &Cli, rows: &[Row]) -> Result<()> {
    let Some(name) = cli.mask.as_deref() else { return Ok(()) };
    let mut labels = rows.iter().filter_map(|row| row.region.as_deref());
    match labels.clone().next() {
        Some(first) if !labels.any(Path::exists) => bail!(
            "{}: no such file; --mask {name} expects the labels lh.{name}.label and rh.{name}.label in each subject's \
             folder label/, and doesn't read annotations (.annot)",
            first.display()
        ),
        _ => Ok(()),
    }
}
