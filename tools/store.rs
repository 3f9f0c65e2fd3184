//! `store`: what is in a basis store, whether it is sound, and clearing away what killed builds left.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::Ordering;

use anyhow::{Result, bail};
use clap::{Args, Parser, Subcommand};
use rayon::prelude::*;
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::console::{Console, Unit};
use spharm_cli::output::{print, print_json, table};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_store::catalog::{degrees, leftovers, remove_leftovers, schemes, verify};
use spharm_store::{DegreeFile, SchemeKey, StoreError};

/// Look after a basis store
#[derive(Debug, Parser)]
#[command(name = "store", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The sampling schemes of a store, a line each
    List {
        /// Folder of the store
        #[arg(env = "SPHARM_STORE")]
        dir: PathBuf,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// The files of one scheme, a line for each degree
    Show {
        #[command(flatten)]
        which: Which,
        /// Print JSON
        #[arg(long)]
        json: bool,
    },
    /// Check every byte against its hash; exit status 1 when something is damaged
    Verify {
        #[command(flatten)]
        which: Which,
        #[command(flatten)]
        threads: Threads,
    },
    /// Remove what killed builds left behind
    Gc {
        /// Folder of the store
        #[arg(env = "SPHARM_STORE")]
        dir: PathBuf,
        /// Only say what would be removed
        #[arg(short = 'n', long)]
        dry_run: bool,
    },
}

#[derive(Debug, Args)]
struct Which {
    /// Folder of the store
    #[arg(env = "SPHARM_STORE")]
    dir: PathBuf,
    /// Key of a scheme, or its first digits [default: all]
    key: Option<String>,
}

#[derive(Debug, Serialize)]
struct SchemeRow {
    key: String,
    directions: Option<usize>,
    dtype: Option<&'static str>,
    codec: Option<&'static str>,
    degrees: usize,
    /// Highest degree of which every one below is there as well.
    complete_to: Option<usize>,
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

fn main() -> ExitCode {
    let cli = Cli::parse();
    spharm_cli::exit::run(|| work(&cli))
}

fn work(cli: &Cli) -> Result<()> {
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
    let mut lines = vec![["scheme", "directions", "dtype", "codec", "degrees", "size"].map(str::to_owned).to_vec()];
    for row in rows {
        let extent = match row.complete_to {
            Some(degree) if degree + 1 == row.degrees => format!("0 to {degree}"),
            Some(degree) => format!("0 to {degree}, {} in all", row.degrees),
            None => format!("{} without degree 0", row.degrees),
        };
        let damage = if row.damaged > 0 { format!(", {} damaged", row.damaged) } else { String::new() };
        lines.push(vec![
            row.key,
            row.directions.map_or("-".to_owned(), |n| n.to_string()),
            row.dtype.unwrap_or("-").to_owned(),
            row.codec.unwrap_or("-").to_owned(),
            format!("{extent}{damage}"),
            Size(row.bytes as usize).to_string(),
        ]);
    }
    print(&table(&lines))
}

fn scheme_row(dir: &Path, key: SchemeKey) -> Result<SchemeRow> {
    let found = degrees(dir, key)?;
    let sound: Vec<&DegreeFile> = found.iter().filter_map(|(_, file)| file.as_ref().ok()).collect();
    let first = sound.first().map(|file| file.header());
    let complete = found.iter().enumerate().take_while(|(at, (degree, file))| at == degree && file.is_ok()).count();
    Ok(SchemeRow {
        key: key.to_string(),
        directions: first.map(|header| header.rows),
        dtype: first.map(|header| header.scalar.name()),
        codec: first.map(|header| header.codec.name()),
        degrees: found.len(),
        complete_to: complete.checked_sub(1),
        damaged: found.len() - sound.len(),
        bytes: sound.iter().map(|file| file.file_len()).sum(),
    })
}

fn show(which: &Which, json: bool) -> Result<()> {
    let mut rows = Vec::new();
    for key in which.keys()? {
        for (degree, file) in degrees(&which.dir, key)? {
            let header = file.as_ref().ok().map(DegreeFile::header);
            rows.push(DegreeRow {
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
            });
        }
    }
    if json {
        return print_json(&rows);
    }
    let head = ["scheme", "degree", "columns", "dtype", "codec", "chunks", "rows a chunk", "size"];
    let mut lines = vec![head.map(str::to_owned).to_vec()];
    let number = |value: Option<usize>| value.map_or("-".to_owned(), |value| value.to_string());
    for row in rows {
        let size = match (row.bytes, row.problem) {
            (Some(bytes), _) => Size(bytes as usize).to_string(),
            (None, problem) => problem.unwrap_or_default(),
        };
        lines.push(vec![
            row.key[..12].to_owned(),
            row.degree.to_string(),
            row.columns.to_string(),
            row.dtype.unwrap_or("-").to_owned(),
            row.codec.unwrap_or("-").to_owned(),
            number(row.chunks),
            number(row.chunk_rows),
            size,
        ]);
    }
    print(&table(&lines))
}

fn verify_all(which: &Which, threads: Threads, console: &Console) -> Result<()> {
    let mut files = Vec::new();
    for key in which.keys()? {
        files.extend(degrees(&which.dir, key)?.into_iter().map(|(_, file)| file));
    }
    let bytes: u64 = files.iter().flatten().map(DegreeFile::file_len).sum();
    let progress = console.progress("verify", bytes, Unit::Bytes);
    let cancel = spharm_cli::exit::cancel();
    let check = |buffer: &mut Vec<u8>, file: &Result<DegreeFile, StoreError>| -> Result<(), String> {
        if cancel.load(Ordering::Relaxed) {
            return Err("interrupted".to_owned());
        }
        let file = file.as_ref().map_err(ToString::to_string)?;
        verify(file, buffer).map_err(|error| error.to_string())?;
        progress.add(file.file_len());
        Ok(())
    };
    let results: Vec<Result<(), String>> =
        threads.pool()?.install(|| files.par_iter().map_init(Vec::new, check).collect());
    drop(progress);
    if cancel.load(Ordering::Relaxed) {
        return Err(StoreError::Interrupted.into());
    }
    let problems: Vec<&String> = results.iter().filter_map(|result| result.as_ref().err()).collect();
    if problems.len() > 1 {
        problems.iter().for_each(|problem| console.warn(problem));
    }
    match problems.len() {
        0 => print(&format!("{} files, {}: all sound", files.len(), Size(bytes as usize))),
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
    print(&format!("{} leftover file(s) {}", paths.len(), if dry_run { "would be removed" } else { "removed" }))
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
