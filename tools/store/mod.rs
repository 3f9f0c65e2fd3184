//! `store`: lists and verifies the files of a basis store, and removes the leftovers of interrupted builds.

mod args;
mod output;

use std::path::Path;

use anyhow::{Result, bail};
use spharm_cli::console::Console;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, print, print_json, print_line, table};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_store::SchemeKey;
use spharm_store::catalog::{degrees, find_schemes, leftovers, remove_leftovers, schemes, summarize, verify};
use spharm_store::factor::factors;

pub(crate) use self::args::Cli;
use self::args::{Command, Which};
use self::output::{DegreeRow, FactorRow, Row, SchemeRow, degree_lines, factor_lines, missing_degrees, scheme_lines};

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    spharm_cli::machine::raise_file_limit();
    match &cli.command {
        Command::List { dir, json } => list(dir, *json),
        Command::Show { which, json } => show(which, *json),
        Command::Verify { which, threads } => verify_all(which, *threads, &console),
        Command::Gc { dir, dry_run } => gc(dir, *dry_run),
    }
}

fn list(dir: &Path, json: bool) -> Result<()> {
    let rows = schemes(dir)?.into_iter().map(|key| summarize(dir, key).map(SchemeRow::from));
    let rows: Vec<SchemeRow> = rows.collect::<Result<_, _>>()?;
    if json {
        return print_json(&rows);
    }
    if rows.is_empty() {
        return print_line(&format!("{}: no sampling schemes; build a basis with spharm basis-build", dir.display()));
    }
    print(&table(&scheme_lines(rows)))
}

fn show(which: &Which, json: bool) -> Result<()> {
    let (mut basis, mut of_basis) = (Vec::new(), Vec::new());
    for key in which.keys()? {
        basis.extend(degrees(&which.dir, key)?.iter().map(|(degree, file)| DegreeRow::new(key, *degree, file)));
        of_basis.extend(factors(&which.dir, key)?.into_iter().map(|(name, file)| FactorRow::new(key, name, &file)));
    }
    if json {
        let rows = basis.into_iter().map(Row::Degree).chain(of_basis.into_iter().map(Row::Factor));
        return print_json(&rows.collect::<Vec<_>>());
    }
    if !basis.is_empty() || of_basis.is_empty() {
        print(&table(&degree_lines(basis)))?;
    }
    if of_basis.is_empty() { Ok(()) } else { print(&table(&factor_lines(of_basis))) }
}

fn verify_all(which: &Which, threads: Threads, console: &Console) -> Result<()> {
    let (keys, monitor) = (which.keys()?, ConsoleMonitor::new(*console));
    let found = threads.pool()?.install(|| verify(&which.dir, &keys, &monitor))?;
    for &key in &keys {
        let degrees: Vec<usize> = degrees(&which.dir, key)?.iter().map(|(degree, _)| *degree).collect();
        missing_degrees(key, &degrees).iter().for_each(|warning| console.warn(warning));
    }
    let mut problems = found.damaged;
    if problems.len() > 1 {
        problems.iter().for_each(|problem| console.warn(problem));
    }
    match problems.len() {
        0 => print(&format!("{}, {}: all intact", counted(found.files, "file"), Size(found.bytes as usize))),
        1 => Err(problems.remove(0).into()),
        count => bail!("{count} of {} files are damaged; delete them and run spharm basis-build again", found.files),
    }
}

fn gc(dir: &Path, dry_run: bool) -> Result<()> {
    let mut paths = Vec::new();
    for key in schemes(dir)? {
        paths.extend(if dry_run { leftovers(dir, key)? } else { remove_leftovers(dir, key)? });
    }
    for path in &paths {
        print(&path.display().to_string())?;
    }
    let done = if dry_run { "would be removed" } else { "removed" };
    print(&format!("{} {done}", counted(paths.len(), "leftover file")))
}

impl Which {
    /// Returns the keys of the requested schemes: the only key that begins with the given digits, or all keys.
    fn keys(&self) -> Result<Vec<SchemeKey>> {
        Ok(find_schemes(&self.dir, self.key.as_deref())?)
    }
}
