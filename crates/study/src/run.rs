//! Reads and checks the study and the arguments of a call, and starts the commands.

use std::fs::{File, TryLockError};
use std::path::Path;

use anyhow::{Context, Result, bail};
use spharm_cli::console::Console;
use spharm_cli::output::{Muted, counted, print_json, print_line};
use spharm_cli::paths::utf8;
use spharm_surface::io::write_new;

use super::args::{Cli, Command};
use super::call::{Call, PreviewFit};
use super::plan::Plan;
use super::provenance::Provenance;
use super::{check, config, foreign, init, tidy};

/// Writes a study file. Keys are filled in from the table and from the files below the study file's folder.
fn init(file: &Path, table: Option<&str>, force: bool, console: &Console) -> Result<()> {
    let folder = file.parent().unwrap_or(Path::new(""));
    let text = match table {
        None => config::template(None),
        Some(table) => {
            let found = init::filled(folder, table)?;
            found.notes.iter().for_each(|note| console.note(note));
            found.text
        }
    };
    write_new(file, force, |out| out.write_all(text.as_bytes()))?;
    let file = file.display();
    print_line(&format!("{file}: check this file, then run: spharm study {file}"))
}

/// Runs the verb. `spharm` runs another verb, `parse` only checks another verb's arguments, and `preview` previews a
/// fit.
///
/// # Errors
///
/// The errors of the commands, or of the study's file and table.
pub fn run(
    cli: &Cli,
    spharm: &dyn Fn(&[String]) -> Result<()>,
    parse: &dyn Fn(&[String]) -> Result<()>,
    preview: &PreviewFit,
) -> Result<()> {
    if let Some(Command::Init { file, table, force }) = &cli.command {
        return init(file, table.as_deref(), *force, &cli.common.console());
    }
    let (plan, recorded) = match (&cli.again, &cli.study) {
        (Some(path), _) => {
            utf8(path)?;
            let recorded = Provenance::read(path)?;
            let common = if common(cli).is_empty() { recorded.arguments() } else { common(cli) };
            (recorded.plan(path, cli.output.as_deref(), common)?, Some(recorded))
        }
        (None, Some(study)) => {
            // The path must be UTF-8, because the other verbs get their arguments as text.
            utf8(study)?;
            (Plan::read(study, cli.output.clone(), common(cli))?, None)
        }
        (None, None) => bail!("give the path of a study file; `spharm study init` writes a template"),
    };
    let study = &plan.file;
    check::check(&plan)?;
    let mut call = Call {
        cli,
        plan: &plan,
        recorded: recorded.as_ref(),
        spharm,
        console: cli.common.console(),
        rows: Vec::new(),
        flagged: Vec::new(),
        failed: Vec::new(),
        warnings: Vec::new(),
        compared: None,
    };
    let (count, table) = (plan.manifest.rows.len(), plan.table.display());
    let subjects = match plan.excluded.len() {
        0 => counted(count, plan.row_noun()),
        excluded => format!("{count} of {} ({excluded} excluded)", counted(count + excluded, plan.row_noun())),
    };
    call.console.note(format!("{}: {subjects} in {table}", plan.study.title));
    for fits in plan.fits() {
        let fit = plan.fit(&fits, cli.shard, cli.force);
        parse(&call.arguments(&fit)).with_context(|| format!("{}: `arguments` in [fit]", study.display()))?;
    }
    // Find wrong values in the study's file before the fits, which take a long time.
    let planned = plan.stages(&plan.subjects_planned());
    for stage in &planned {
        parse(&call.arguments(stage)).with_context(|| format!("{}: {}", study.display(), stage.name))?;
    }
    if !cli.force {
        foreign::check(&plan, &planned)?;
    }
    if cli.dry_run {
        return call.show(preview);
    }
    let folders = [plan.records().join("warnings"), plan.records().join("reports")];
    for folder in folders.into_iter().chain(plan.fits().into_iter().map(|fits| fits.status)) {
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    }
    let lock = lock(&plan, cli.shard.is_some())?;
    tidy::leftovers(&plan);
    plan.write_manifests()?;
    let muted = cli.json.then(Muted::begin);
    let done = call.run();
    drop((muted, lock));
    if cli.json {
        print_json(&call.report(&done)?)?;
    }
    done
}

/// Locks the study for this process, so that no other run changes it. Jobs that fit shards share the lock. If the file
/// system doesn't support locks, the study runs without one.
fn lock(plan: &Plan, shared: bool) -> Result<File> {
    let path = plan.records().join(".lock");
    let options = File::options().create(true).append(true).clone();
    let file = spharm_files::open_with(&path, &options).with_context(|| path.display().to_string())?;
    if let Err(TryLockError::WouldBlock) = if shared { file.try_lock_shared() } else { file.try_lock() } {
        bail!(
            "{}: the study is already running; wait until the other run ends, or stop the other run",
            plan.file.display()
        );
    }
    Ok(file)
}

/// Returns the arguments of the study that are passed to all of its commands.
fn common(cli: &Cli) -> Vec<String> {
    let threads = cli.resources.threads.threads.iter().flat_map(|count| ["--threads".to_owned(), count.to_string()]);
    threads.chain(cli.resources.memory.arguments()).collect()
}
