//! `status`: summarises the progress of a cohort over all of its processes.

mod args;

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::{Map, Value, json};
use spharm_cli::console::Console;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print, print_json, print_line, table};
use spharm_cohort::{CohortError, Entry, Manifest, Merged, State};
use spharm_surface::io::write_new;

pub(crate) use self::args::Cli;

/// Largest number of failures printed below the table.
const SHOWN: usize = 20;

pub(crate) fn run(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    check_outputs(cli.failed.iter().map(|path| OutputFile::new(path, "--failed")), cli.force)?;
    let merged = Merged::read(&status_files(&cli.files)?)?;
    if merged.damaged > 0 {
        console.warn(format!(
            "ignored {} in the status files (truncated or overwritten)",
            counted(merged.damaged, "line")
        ));
    }
    let manifest = cli.manifest.as_deref().map(Manifest::read).transpose()?;
    // With a manifest, include only its rows, in its order.
    let entries: Vec<&Entry> = match &manifest {
        Some(manifest) => manifest.rows.iter().filter_map(|row| merged.entry(&row.id)).collect(),
        None => merged.entries().iter().collect(),
    };
    let gone = gone(&entries, &console);
    let count = |state: State| entries.iter().filter(|entry| entry.state == state && !gone.contains(&entry.id)).count();
    let mut counts: Vec<(&str, usize)> = State::ALL.iter().map(|&state| (state.name(), count(state))).collect();
    if !gone.is_empty() {
        counts.push(("gone", gone.len()));
    }
    if let Some(manifest) = &manifest {
        counts.push(("not started", manifest.rows.len() - entries.len()));
        let others = merged.entries().len() - entries.len();
        if others > 0 {
            console.warn(format!("ignored {} not in {}", counted(others, "row"), manifest.path.display()));
        }
    }
    counts.push(("all", manifest.as_ref().map_or(entries.len(), |manifest| manifest.rows.len())));
    if let (Some(path), Some(manifest)) = (&cli.failed, &manifest) {
        write_rest(path, manifest, &merged, &gone, cli.force, &console)?;
    }
    let failed: Vec<&Entry> = entries.into_iter().filter(|entry| entry.state == State::Failed).collect();
    if cli.json {
        return print_json(&report(&counts, &failed));
    }
    let mut rows = vec![vec!["state".to_owned(), "rows".to_owned()]];
    rows.extend(counts.iter().map(|(name, count)| vec![(*name).to_owned(), count.to_string()]));
    print(&table(&rows))?;
    for entry in failed.iter().take(SHOWN) {
        print_line(&format!("{}: {}", entry.id, entry.error))?;
    }
    if failed.len() > SHOWN {
        print(&format!("and {} more; --json lists all failures", failed.len() - SHOWN))?;
    }
    Ok(())
}

/// Returns the given files, and the status files in the given folders. Other tables in a folder, such as a manifest,
/// are ignored.
fn status_files(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    for path in paths {
        if !path.is_dir() {
            files.push(path.clone());
            continue;
        }
        let before = files.len();
        for file in spharm_cli::paths::expand(std::slice::from_ref(path), ".tsv")? {
            match Merged::read([&file]) {
                Err(CohortError::NotStatus { .. }) => {}
                _ => files.push(file),
            }
        }
        if files.len() == before {
            bail!("{}: the folder has no status file", path.display());
        }
    }
    Ok(files)
}

/// Returns the ids of the rows that are recorded as done, but whose models no longer exist. If all models are missing
/// and the paths are relative, the current folder probably differs from the folder in which the fits ran. In this case,
/// prints a note and returns no ids.
fn gone(entries: &[&Entry], console: &Console) -> HashSet<String> {
    let made: Vec<&&Entry> =
        entries.iter().filter(|entry| entry.state.is_there() && !entry.output.is_empty()).collect();
    let gone: Vec<&&&Entry> = made.iter().filter(|entry| !Path::new(&entry.output).exists()).collect();
    if !made.is_empty() && gone.len() == made.len() && made.iter().any(|entry| Path::new(&entry.output).is_relative()) {
        console.note(
            "none of the models was found; if the models were made in another folder, run this command in that folder",
        );
        return HashSet::new();
    }
    gone.iter().map(|entry| entry.id.clone()).collect()
}

/// Writes a manifest of the rows without a model.
fn write_rest(
    path: &Path,
    manifest: &Manifest,
    merged: &Merged,
    gone: &HashSet<String>,
    force: bool,
    console: &Console,
) -> Result<()> {
    let is_there = |id: &str| merged.entry(id).is_some_and(|entry| entry.state.is_there()) && !gone.contains(id);
    let left = manifest.rows.iter().filter(|row| !is_there(&row.id)).count();
    if left == 0 {
        console.note(format!("every row has a model, so {} wasn't written", path.display()));
        return Ok(());
    }
    if path == manifest.path {
        bail!("{}: this file is the manifest; choose another --failed", path.display());
    }
    let text = manifest.rest(path, |row| !is_there(&row.id))?;
    prepare(path)?;
    write_new(path, force, |out| out.write_all(&text)).context("--failed")?;
    console.note(format!("{}: {}", path.display(), counted(left, "row")));
    Ok(())
}

fn report(counts: &[(&str, usize)], failed: &[&Entry]) -> Value {
    let mut report: Map<String, Value> =
        counts.iter().map(|(name, count)| (name.replace(' ', "_"), json!(count))).collect();
    let failed = failed.iter().map(|entry| json!({ "id": entry.id, "error": entry.error, "output": entry.output }));
    report.insert("failures".to_owned(), failed.collect());
    Value::Object(report)
}
