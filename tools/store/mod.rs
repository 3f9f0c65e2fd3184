//! `store`: what is in a basis store, whether it is sound, and clearing away what killed builds left.

mod args;

use std::path::Path;

use anyhow::{Result, bail};
use serde::Serialize;
use spharm_cli::console::Console;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, print, print_json, table};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_store::catalog::{
    SchemeSummary, degrees, find_schemes, leftovers, remove_leftovers, schemes, summarize, verify,
};
use spharm_store::factor::{FactorFile, factors};
use spharm_store::{Codec, DegreeFile, Scalar, SchemeKey, StoreError};

pub(crate) use self::args::Cli;
use self::args::{Command, Which};

#[derive(Debug, Serialize)]
struct SchemeRow {
    key: String,
    directions: Option<usize>,
    dtype: Option<&'static str>,
    codec: Option<&'static str>,
    degrees: usize,
    /// Highest degree of which every one below is there as well.
    complete_to: Option<usize>,
    /// Number of factors beside the basis.
    factors: usize,
    damaged: usize,
    bytes: u64,
}

#[derive(Debug, Serialize)]
struct DegreeRow {
    key: String,
    degree: usize,
    directions: Option<usize>,
    columns: usize,
    dtype: Option<&'static str>,
    codec: Option<&'static str>,
    chunk_rows: Option<usize>,
    chunks: Option<usize>,
    bytes: Option<u64>,
    problem: Option<String>,
}

#[derive(Debug, Serialize)]
struct FactorRow {
    key: String,
    factor: String,
    max_degree: Option<usize>,
    columns: Option<usize>,
    dtype: Option<&'static str>,
    weights: Option<String>,
    smoothness: Option<f64>,
    norm: Option<f64>,
    reciprocal_condition: Option<f64>,
    tile: Option<usize>,
    tiles: Option<usize>,
    bytes: Option<u64>,
    problem: Option<String>,
}

/// A line of `show`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
enum Row {
    Degree(DegreeRow),
    Factor(FactorRow),
}

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
        return print(&format!("{}: no schemes; build one with basis-build", dir.display()));
    }
    let mut lines =
        vec![["scheme", "directions", "dtype", "codec", "degrees", "factors", "size"].map(str::to_owned).to_vec()];
    for row in rows {
        let extent = match row.complete_to {
            Some(degree) if degree + 1 == row.degrees => format!("0 to {degree}"),
            Some(degree) => format!("0 to {degree}, {} in all", row.degrees),
            None if row.degrees == 0 => "none".to_owned(),
            None => format!("{} without degree 0", row.degrees),
        };
        let damage = if row.damaged > 0 { format!(", {} damaged", row.damaged) } else { String::new() };
        lines.push(vec![
            row.key,
            row.directions.map_or("-".to_owned(), |n| n.to_string()),
            row.dtype.unwrap_or("-").to_owned(),
            row.codec.unwrap_or("-").to_owned(),
            format!("{extent}{damage}"),
            row.factors.to_string(),
            Size(row.bytes as usize).to_string(),
        ]);
    }
    print(&table(&lines))
}

impl From<SchemeSummary> for SchemeRow {
    fn from(summary: SchemeSummary) -> Self {
        Self {
            key: summary.key.to_string(),
            directions: summary.rows,
            dtype: summary.scalar.map(Scalar::name),
            codec: summary.codec.map(Codec::name),
            degrees: summary.degrees,
            complete_to: summary.complete_to,
            factors: summary.factors,
            damaged: summary.damaged,
            bytes: summary.bytes,
        }
    }
}

fn show(which: &Which, json: bool) -> Result<()> {
    let (mut basis, mut of_basis) = (Vec::new(), Vec::new());
    for key in which.keys()? {
        basis.extend(degrees(&which.dir, key)?.iter().map(|(degree, file)| degree_row(key, *degree, file)));
        of_basis.extend(factors(&which.dir, key)?.into_iter().map(|(name, file)| factor_row(key, name, &file)));
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

fn degree_row(key: SchemeKey, degree: usize, file: &Result<DegreeFile, StoreError>) -> DegreeRow {
    let header = file.as_ref().ok().map(DegreeFile::header);
    DegreeRow {
        key: key.to_string(),
        degree,
        directions: header.map(|h| h.rows),
        columns: 2 * degree + 1,
        dtype: header.map(|h| h.scalar.name()),
        codec: header.map(|h| h.codec.name()),
        chunk_rows: header.map(|h| h.chunk_rows),
        chunks: header.map(|h| h.chunk_count()),
        bytes: file.as_ref().ok().map(DegreeFile::file_len),
        problem: file.as_ref().err().map(ToString::to_string),
    }
}

fn factor_row(key: SchemeKey, name: String, file: &Result<FactorFile, StoreError>) -> FactorRow {
    let header = file.as_ref().ok().map(FactorFile::header);
    FactorRow {
        key: key.to_string(),
        factor: name,
        max_degree: header.map(|h| h.spec.max_degree),
        columns: header.map(|h| h.grid.size()),
        dtype: header.map(|h| h.scalar.name()),
        weights: header.map(|h| h.spec.weights.to_string()),
        smoothness: header.map(|h| h.spec.smoothness),
        norm: header.map(|h| h.condition.norm),
        reciprocal_condition: header.map(|h| h.condition.reciprocal),
        tile: header.map(|h| h.grid.tile()),
        tiles: header.map(|h| h.grid.count()),
        bytes: file.as_ref().ok().map(FactorFile::file_len),
        problem: file.as_ref().err().map(ToString::to_string),
    }
}

fn size_or_problem(bytes: Option<u64>, problem: Option<String>) -> String {
    bytes.map_or(problem.unwrap_or_default(), |bytes| Size(bytes as usize).to_string())
}

fn number(value: Option<usize>) -> String {
    value.map_or("-".to_owned(), |value| value.to_string())
}

fn degree_lines(rows: Vec<DegreeRow>) -> Vec<Vec<String>> {
    let head = ["scheme", "degree", "columns", "dtype", "codec", "chunks", "rows a chunk", "size"];
    let mut lines = vec![head.map(str::to_owned).to_vec()];
    for row in rows {
        lines.push(vec![
            row.key[..12].to_owned(),
            row.degree.to_string(),
            row.columns.to_string(),
            row.dtype.unwrap_or("-").to_owned(),
            row.codec.unwrap_or("-").to_owned(),
            number(row.chunks),
            number(row.chunk_rows),
            size_or_problem(row.bytes, row.problem),
        ]);
    }
    lines
}

fn factor_lines(rows: Vec<FactorRow>) -> Vec<Vec<String>> {
    let head = ["scheme", "factor", "columns", "weights", "smoothness", "condition", "tiles", "size"];
    let mut lines = vec![head.map(str::to_owned).to_vec()];
    for row in rows {
        lines.push(vec![
            row.key[..12].to_owned(),
            row.factor,
            number(row.columns),
            row.weights.unwrap_or("-".to_owned()),
            row.smoothness.map_or("-".to_owned(), |smoothness| smoothness.to_string()),
            row.reciprocal_condition.map_or("-".to_owned(), |reciprocal| format!("{:.1e}", 1.0 / reciprocal)),
            number(row.tiles),
            size_or_problem(row.bytes, row.problem),
        ]);
    }
    lines
}

fn verify_all(which: &Which, threads: Threads, console: &Console) -> Result<()> {
    let (keys, monitor) = (which.keys()?, ConsoleMonitor::new(*console));
    let found = threads.pool()?.install(|| verify(&which.dir, &keys, &monitor))?;
    let mut problems = found.damaged;
    if problems.len() > 1 {
        problems.iter().for_each(|problem| console.warn(problem));
    }
    match problems.len() {
        0 => print(&format!("{}, {}: all sound", counted(found.files, "file"), Size(found.bytes as usize))),
        1 => Err(problems.remove(0).into()),
        count => bail!("{count} of {} files are damaged; delete them and run basis-build again", found.files),
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
    /// The schemes meant: one by the first digits of its key, or all.
    fn keys(&self) -> Result<Vec<SchemeKey>> {
        Ok(find_schemes(&self.dir, self.key.as_deref())?)
    }
}
