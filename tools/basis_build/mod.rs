//! `basis-build`: precomputes the basis of a sampling scheme into a store, and the factor of its normal equations.

mod factor;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use clap::ValueEnum;
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::console::Console;
use spharm_cli::inputs::read_sphere;
use spharm_cli::machine::{Memory, Versions, memory, raise_file_limit};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{print, print_json, refuse_existing, table, write_json};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_store::build::DEFAULT_CHUNK_ROWS;
use spharm_store::{BuildParams, BuildReport, Codec, Scalar, SchemeKey, build};
use spharm_surface::Sphere;

/// Precompute the spherical-harmonic basis of a sampling scheme, once, for every fit on it
///
/// Writes one immutable file for each degree into STORE. What is there already is kept, so the same command resumes an
/// interrupted build, and one with a higher --max-degree extends a finished one. Several may run at once.
///
/// With --factor, the Cholesky factor of the normal equations of all degrees to L is computed as well and kept beside the
/// basis: with it the exact least squares of any surface on the scheme is two triangular solves. It takes
/// 4 (L + 1)^4 bytes of disk in f64, whatever the number of vertices. It is computed anew when it was interrupted.
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// Sphere mesh of the sampling scheme, any radius, centred at the origin; or a CSV of theta,phi in radians
    #[arg(long, value_name = "SPHERE")]
    sphere: PathBuf,
    /// Highest degree, inclusive
    #[arg(long, value_name = "L", required_unless_present = "factor_only")]
    max_degree: Option<usize>,
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
    /// Compute the factor of the normal equations to degree L as well
    #[arg(long, value_name = "L")]
    factor: Option<usize>,
    /// Compute the factor without building a basis
    #[arg(long, requires = "factor", conflicts_with = "max_degree")]
    factor_only: bool,
    /// Scalar type of the factor; f32 takes half of the space, and solutions are 6e-8 times the condition number off
    #[arg(long, value_enum, default_value_t = Dtype::F64, requires = "factor")]
    factor_dtype: Dtype,
    /// Penalty of the factor: LAMBDA sum (l (l + 1))^2 |c|^2
    #[arg(long, value_name = "LAMBDA", default_value_t = 0.0, value_parser = penalty, requires = "factor")]
    smoothness: f64,
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

impl Dtype {
    fn scalar(self) -> Scalar {
        match self {
            Self::F64 => Scalar::F64,
            Self::F32 => Scalar::F32,
        }
    }
}

/// A number that is finite and not negative.
fn penalty(text: &str) -> Result<f64, String> {
    let value: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if value.is_finite() && value >= 0.0 { Ok(value) } else { Err("expected 0 or more".to_owned()) }
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
    dtype: &'static str,
    /// Nothing of it with --factor-only.
    #[serde(flatten)]
    basis: Option<Basis>,
    factor: Option<factor::FactorRow>,
    threads: usize,
    memory: Memory,
    seconds: f64,
}

#[derive(Debug, Serialize)]
struct Basis {
    max_degree: usize,
    codec: &'static str,
    chunk_rows: usize,
    degrees_built: usize,
    degrees_present: usize,
    bytes: u64,
    bytes_written: u64,
    planned_memory: usize,
}

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    let console = cli.common.console();
    // From here on a signal is heard.
    spharm_cli::exit::cancel();
    raise_file_limit();
    if let Some(path) = &cli.json {
        refuse_existing(path, cli.force, "report", "--json")?;
    }
    let sphere = read_sphere(&cli.sphere, &console)?;
    let params = BuildParams {
        // Without one no basis is built.
        max_degree: cli.max_degree.unwrap_or_default(),
        scalar: cli.dtype.scalar(),
        codec: match cli.codec {
            CodecName::None => Codec::Raw,
            CodecName::Zstd => Codec::Zstd,
        },
        chunk_rows: cli.chunk_rows,
        memory: cli.memory.0,
        threads: cli.threads.count(),
        allow_large: cli.yes,
    };
    let pool = cli.threads.pool()?;
    // What it takes is said, and refused, before a basis is built.
    let factor =
        cli.factor.map(|degree| factor::Job::new(cli, &sphere, &console, params.scalar, degree)).transpose()?;
    let basis = (!cli.factor_only).then(|| pool.install(|| basis(cli, &sphere, &params, &console))).transpose()?;
    let factor = factor.map(|job| pool.install(|| job.run())).transpose()?;
    let key = SchemeKey::of(&sphere.directions, params.scalar);
    let report = Report {
        tool: "basis-build",
        versions: Versions::current(),
        sphere: cli.sphere.clone(),
        scheme_key: key.to_string(),
        folder: cli.store.join(key.to_string()),
        directions: sphere.directions.len(),
        dtype: params.scalar.name(),
        threads: basis.as_ref().map_or(params.threads, |report| report.threads),
        basis: basis.as_ref().map(|report| of_basis(report, &params)),
        factor,
        memory: memory(),
        seconds: started.elapsed().as_secs_f64(),
    };
    if let Some(path) = &cli.json {
        if path.as_os_str() == "-" {
            return print_json(&report);
        }
        write_json(path, cli.force, &report)?;
    }
    print(&table(&lines(&report)))
}

fn basis(cli: &Cli, sphere: &Sphere, params: &BuildParams, console: &Console) -> Result<BuildReport> {
    let report = build(&cli.store, &sphere.directions, params, &ConsoleMonitor::new(*console))?;
    report.warnings.iter().for_each(|warning| console.warn(warning));
    let planned = Size(report.memory);
    console.detail(format!("{} threads, {planned} planned, chunks of {} rows", report.threads, report.chunk_rows));
    Ok(report)
}

fn lines(report: &Report) -> Vec<Vec<String>> {
    let row = |name: &str, value: String| vec![name.to_owned(), value];
    let mut lines = vec![row("scheme", report.scheme_key.clone()), row("directions", report.directions.to_string())];
    if let Some(basis) = &report.basis {
        lines.extend([
            row("max degree", basis.max_degree.to_string()),
            row("degrees built", format!("{} ({} were there)", basis.degrees_built, basis.degrees_present)),
            row("size", Size(basis.bytes as usize).to_string()),
            row("written", Size(basis.bytes_written as usize).to_string()),
        ]);
    }
    if let Some(factor) = &report.factor {
        let there = if factor.present { " (was there)" } else { "" };
        lines.extend([
            row("factor", format!("degree {}, {}{there}", factor.max_degree, factor.dtype)),
            row("size of it", Size(factor.bytes as usize).to_string()),
            row("condition", format!("{:.1e}", 1.0 / factor.reciprocal_condition)),
        ]);
    }
    lines.push(row("seconds", format!("{:.2}", report.seconds)));
    lines
}

fn of_basis(report: &BuildReport, params: &BuildParams) -> Basis {
    Basis {
        max_degree: params.max_degree,
        codec: params.codec.name(),
        chunk_rows: report.chunk_rows,
        degrees_built: report.built,
        degrees_present: report.present,
        bytes: report.bytes,
        bytes_written: report.bytes_written,
        planned_memory: report.memory,
    }
}
