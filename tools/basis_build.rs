//! `basis-build`: precomputes the basis of a sampling scheme into a store.

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Mutex;
use std::time::Instant;

use anyhow::Result;
use clap::{Parser, ValueEnum};
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::console::{Console, Progress, Unit};
use spharm_cli::inputs::read_sphere;
use spharm_cli::machine::{Memory, Versions, memory, raise_file_limit, versions};
use spharm_cli::output::{print, print_json, refuse_existing, table, write_json};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_store::build::DEFAULT_CHUNK_ROWS;
use spharm_store::{BuildEvent, BuildParams, BuildReport, Codec, Scalar, build};

/// Precompute the spherical-harmonic basis of a sampling scheme, once, for every fit on it
///
/// Writes one immutable file for each degree into STORE. What is there already is kept, so the same command resumes an
/// interrupted build, and one with a higher --max-degree extends a finished one. Several may run at once.
#[derive(Debug, Parser)]
#[command(name = "basis-build", version)]
struct Cli {
    /// Sphere mesh of the sampling scheme, any radius, centred at the origin; or a CSV of theta,phi in radians
    #[arg(long, value_name = "SPHERE")]
    sphere: PathBuf,
    /// Highest degree, inclusive
    #[arg(long, value_name = "L")]
    max_degree: usize,
    /// Folder of the store; made when it isn't there
    #[arg(long, value_name = "DIR", env = "SPHARM_STORE")]
    store: PathBuf,
    /// Scalar type; f32 takes half of the space and costs half of the digits
    #[arg(long, value_enum, default_value_t = Dtype::F64)]
    dtype: Dtype,
    /// Codec of the chunks; zstd saves a few per cent and makes fits several times slower
    #[arg(long, value_enum, default_value_t = CodecName::None)]
    codec: CodecName,
    /// Rows of a chunk, a multiple of 8; a scheme that is there keeps its own
    #[arg(long, value_name = "ROWS", default_value_t = DEFAULT_CHUNK_ROWS)]
    chunk_rows: usize,
    /// Memory to keep to
    #[arg(long, value_name = "SIZE", default_value = "512MiB")]
    memory: Size,
    #[command(flatten)]
    threads: Threads,
    /// Build even what is larger than 64 GiB or than the free disk space
    #[arg(long)]
    yes: bool,
    /// Write a report to FILE
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Replace an existing report
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Dtype {
    F64,
    F32,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum CodecName {
    None,
    Zstd,
}

#[derive(Debug, Serialize)]
struct Report {
    tool: &'static str,
    versions: Versions,
    sphere: PathBuf,
    scheme_key: String,
    folder: PathBuf,
    directions: usize,
    max_degree: usize,
    dtype: &'static str,
    codec: &'static str,
    chunk_rows: usize,
    degrees_built: usize,
    degrees_present: usize,
    bytes: u64,
    bytes_written: u64,
    threads: usize,
    planned_memory: usize,
    memory: Memory,
    seconds: f64,
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    spharm_cli::exit::run(|| work(&cli))
}

fn work(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    let console = cli.common.console();
    let cancel = spharm_cli::exit::cancel();
    raise_file_limit();
    if let Some(path) = &cli.json {
        refuse_existing(path, cli.force, "report", "--json")?;
    }
    let sphere = read_sphere(&cli.sphere, &console)?;
    let params = BuildParams {
        max_degree: cli.max_degree,
        scalar: match cli.dtype {
            Dtype::F64 => Scalar::F64,
            Dtype::F32 => Scalar::F32,
        },
        codec: match cli.codec {
            CodecName::None => Codec::Raw,
            CodecName::Zstd => Codec::Zstd,
        },
        chunk_rows: cli.chunk_rows,
        memory: cli.memory.0,
        threads: cli.threads.count(),
        allow_large: cli.yes,
    };
    let progress = Mutex::new(None);
    let report = cli.threads.pool()?.install(|| {
        build(&cli.store, &sphere.directions, &params, cancel, &|event| tell(&event, &console, &progress))
    })?;
    drop(progress);
    let planned = Size(report.memory);
    console.detail(format!("{} threads, {planned} planned, chunks of {} rows", report.threads, report.chunk_rows));
    let seconds = started.elapsed().as_secs_f64();
    if let Some(path) = &cli.json {
        let report = full_report(cli, &report, &params, sphere.directions.len(), seconds);
        if path.as_os_str() == "-" {
            return print_json(&report);
        }
        write_json(path, cli.force, &report)?;
    }
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    print(&table(&[
        row("scheme", report.key.to_string()),
        row("directions", sphere.directions.len().to_string()),
        row("max degree", cli.max_degree.to_string()),
        row("degrees built", format!("{} ({} were there)", report.built, report.present)),
        row("size", Size(report.bytes as usize).to_string()),
        row("written", Size(report.bytes_written as usize).to_string()),
        row("seconds", format!("{seconds:.2}")),
    ]))
}

fn tell(event: &BuildEvent<'_>, console: &Console, progress: &Mutex<Option<Progress>>) {
    let mut progress = progress.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
    match event {
        BuildEvent::Waiting => console.note("another basis-build is at work on this scheme; waiting for it"),
        BuildEvent::Replacing(error) => console.warn(format!("replacing a damaged file: {error}")),
        BuildEvent::Planned { bytes, present } => {
            if *present > 0 {
                console.note(format!("{present} degrees are there already"));
            }
            *progress = (*bytes > 0).then(|| console.progress("basis", *bytes, Unit::Bytes));
        }
        BuildEvent::Progress(bytes) => {
            if let Some(progress) = &*progress {
                progress.add(*bytes);
            }
        }
        _ => {}
    }
}

fn full_report(cli: &Cli, report: &BuildReport, params: &BuildParams, directions: usize, seconds: f64) -> Report {
    Report {
        tool: "basis-build",
        versions: versions(),
        sphere: cli.sphere.clone(),
        scheme_key: report.key.to_string(),
        folder: report.folder.clone(),
        directions,
        max_degree: cli.max_degree,
        dtype: params.scalar.name(),
        codec: params.codec.name(),
        chunk_rows: report.chunk_rows,
        degrees_built: report.built,
        degrees_present: report.present,
        bytes: report.bytes,
        bytes_written: report.bytes_written,
        threads: report.threads,
        planned_memory: report.memory,
        memory: memory(),
        seconds,
    }
}
