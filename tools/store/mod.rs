//! `store`: what is in a basis store, whether it is sound, and clearing away what killed builds left.

mod args;

use std::path::Path;
use std::sync::atomic::Ordering;

use anyhow::{Result, bail};
use rayon::prelude::*;
use serde::Serialize;
use spharm_cli::console::{Console, Unit};
use spharm_cli::output::{counted, print, print_json, table};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_store::catalog::{degrees, leftovers, remove_leftovers, schemes, verify};
use spharm_store::factor::{FactorFile, factors, verify_factor};
use spharm_store::{DegreeFile, SchemeKey, StoreError};

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
    let rows: Vec<SchemeRow> = schemes(dir)?.into_iter().map(|key| scheme_row(dir, key)).collect::<Result<_>>()?;
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

fn scheme_row(dir: &Path, key: SchemeKey) -> Result<SchemeRow> {
    let found = degrees(dir, key)?;
    let factors = factors(dir, key)?;
    let sound_factors: Vec<&FactorFile> = factors.iter().filter_map(|(_, file)| file.as_ref().ok()).collect();
    let sound: Vec<&DegreeFile> = found.iter().filter_map(|(_, file)| file.as_ref().ok()).collect();
    let first = sound.first().map(|file| file.header());
    let complete = found.iter().enumerate().take_while(|(at, (degree, file))| at == degree && file.is_ok()).count();
    Ok(SchemeRow {
        key: key.to_string(),
        directions: first.map(|header| header.rows).or(sound_factors.first().map(|file| file.header().spec.rows)),
        dtype: first.map(|header| header.scalar.name()),
        codec: first.map(|header| header.codec.name()),
        degrees: found.len(),
        complete_to: complete.checked_sub(1),
        factors: factors.len(),
        damaged: found.len() + factors.len() - sound.len() - sound_factors.len(),
        bytes: sound.iter().map(|file| file.file_len()).sum::<u64>()
            + sound_factors.iter().map(|file| file.file_len()).sum::<u64>(),
    })
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

/// A file to be verified, or what was wrong with it when it was opened.
enum Checked {
    Degree(DegreeFile),
    Factor(FactorFile),
    Problem(String),
}

impl Checked {
    fn len(&self) -> u64 {
        match self {
            Self::Degree(file) => file.file_len(),
            Self::Factor(file) => file.file_len(),
            Self::Problem(_) => 0,
        }
    }

    fn verify(&self, buffer: &mut Vec<u8>) -> Result<(), String> {
        match self {
            Self::Degree(file) => verify(file, buffer).map_err(|error| error.to_string()),
            Self::Factor(file) => verify_factor(file, buffer).map_err(|error| error.to_string()),
            Self::Problem(problem) => Err(problem.clone()),
        }
    }
}

fn verify_all(which: &Which, threads: Threads, console: &Console) -> Result<()> {
    let mut files = Vec::new();
    for key in which.keys()? {
        let problem = |error: StoreError| Checked::Problem(error.to_string());
        let basis = degrees(&which.dir, key)?.into_iter();
        files.extend(basis.map(|(_, file)| file.map_or_else(problem, Checked::Degree)));
        let factors = factors(&which.dir, key)?.into_iter();
        files.extend(factors.map(|(_, file)| file.map_or_else(problem, Checked::Factor)));
    }
    let bytes: u64 = files.iter().map(Checked::len).sum();
    let progress = console.progress("verify", bytes, Unit::Bytes);
    let cancel = spharm_cli::exit::cancel();
    let check = |buffer: &mut Vec<u8>, file: &Checked| -> Result<(), String> {
        if cancel.load(Ordering::Relaxed) {
            return Err("interrupted".to_owned());
        }
        file.verify(buffer)?;
        progress.add(file.len());
        Ok(())
    };
    let results: Vec<Result<(), String>> =
        threads.pool()?.install(|| files.par_iter().map_init(Vec::new, check).collect());
    drop(progress);
    if cancel.load(Ordering::Relaxed) {
        return Err(StoreError::from(spharm_monitor::Interrupted).into());
    }
    let problems: Vec<&String> = results.iter().filter_map(|result| result.as_ref().err()).collect();
    if problems.len() > 1 {
        problems.iter().for_each(|problem| console.warn(problem));
    }
    match problems.len() {
        0 => print(&format!("{}, {}: all sound", counted(files.len(), "file"), Size(bytes as usize))),
        1 => bail!("{}", problems[0]),
        count => bail!("{count} of {} files are damaged; delete them and run basis-build again", files.len()),
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
        let all = schemes(&self.dir)?;
        if all.is_empty() {
            bail!("{}: no schemes here; is it the folder that was given as --store?", self.dir.display());
        }
        let Some(prefix) = &self.key else { return Ok(all) };
        let found: Vec<SchemeKey> = all.iter().copied().filter(|key| key.to_string().starts_with(prefix)).collect();
        match found.len() {
            0 => bail!("{}: no scheme begins with {prefix}; `store list` shows what is there", self.dir.display()),
            1 => Ok(found),
            count => bail!("{}: {count} schemes begin with {prefix}; give more digits", self.dir.display()),
        }
    }
}
