//! `fit`: fits surfaces and signals to a basis in a store.

#[path = "fit/job.rs"]
mod job;
#[path = "fit/outputs.rs"]
mod outputs;
#[path = "fit/report.rs"]
mod report;

use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, ValueEnum};
use spharm_cli::Common;
use spharm_cli::console::{Console, Unit};
use spharm_cli::inputs::{Sphere, read_sphere};
use spharm_cli::machine::raise_file_limit;
use spharm_cli::output::{print, refuse_existing};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_solver::{DiskOperator, Method};
use spharm_store::{Scalar, Scheme, SchemeKey, StoreError, catalog};
use spharm_surface::io::read_signal;

use crate::job::Job;
use crate::outputs::items;
use crate::report::{Seconds, finish};

/// Fit surfaces, or any signals on the sphere, with spherical harmonics
///
/// The basis comes from a store that basis-build has made for the same sphere. All surfaces of one call are fitted
/// together, in as few sweeps over the store as the memory allows.
#[derive(Debug, Parser)]
#[command(name = "fit", version)]
pub(crate) struct Cli {
    /// Folder of the basis store
    #[arg(long, value_name = "DIR", env = "SPHARM_STORE")]
    store: PathBuf,
    /// The sphere that the basis was built for
    #[arg(long, value_name = "SPHERE")]
    sphere: PathBuf,
    /// Surfaces, or signals (GIfTI, FreeSurfer curv, CSV with a row a vertex), on the sphere's vertices; @LIST takes the
    /// paths from a file, one a line, relative to it, # for comments
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    surface: Vec<PathBuf>,
    /// Highest degree, inclusive
    #[arg(long, value_name = "L")]
    max_degree: usize,
    /// Iterative residual fitting, the paper's special cases of it, or the full least squares
    #[arg(long, value_enum, default_value_t = MethodName::Irf)]
    method: MethodName,
    /// Number of passes, p (irf, mirf) [default: 1]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u32).range(1..))]
    passes: Option<u32>,
    /// Most basis functions solved together, g (irf) [default: 100]
    #[arg(long, value_name = "G", value_parser = at_least_one)]
    granularity: Option<usize>,
    /// Last degree of the first block, s (sirf, mirf) [default: 0]
    #[arg(long, value_name = "S")]
    start_degree: Option<usize>,
    /// Weights of the vertices: uniform, area (their share of the sphere), or a file with one value for each
    #[arg(long, value_name = "uniform|area|FILE", default_value = "uniform")]
    weights: String,
    /// Scalar type of the basis to use [default: what the store holds, f64 first]
    #[arg(long, value_enum)]
    dtype: Option<Dtype>,
    /// Memory to keep to, mapped files included
    #[arg(long, value_name = "SIZE", default_value = "256MiB")]
    memory: Size,
    #[command(flatten)]
    threads: Threads,
    /// Folder for the models, NAME.spharm.npz; for one surface also a file, whose name ends in .npz [default: here]
    #[arg(short, long, value_name = "OUT")]
    output: Option<PathBuf>,
    /// Also write the paper's complex coefficients, NAME.spharm.csv, beside each model
    #[arg(long)]
    coefficients_csv: bool,
    /// Write a report to FILE
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Print the report as JSON in place of the table
    #[arg(long)]
    json: bool,
    /// Check every byte of the basis against its hash first
    #[arg(long)]
    verify: bool,
    /// Refuse surfaces that aren't closed and of genus zero
    #[arg(long)]
    strict: bool,
    /// Replace outputs that exist
    #[arg(long)]
    force: bool,
    /// Leave surfaces out whose output exists
    #[arg(long, conflicts_with = "force")]
    skip_existing: bool,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum MethodName {
    Irf,
    Sirf,
    Mirf,
    Nlsf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Dtype {
    F64,
    F32,
}

fn at_least_one(text: &str) -> Result<usize, String> {
    match text {
        "inf" => Ok(usize::MAX),
        _ => text.parse().ok().filter(|&n| n > 0).ok_or_else(|| "expected a whole number from 1, or inf".to_owned()),
    }
}

/// Most sweeps beyond the one pass of nlsf: each takes the error that rounding left down by eps times the condition.
const REFINEMENTS: usize = 5;
/// More surfaces at a time gain nothing: their products then take much longer than reading the basis.
const MOST_TOGETHER: usize = 128;

fn main() -> ExitCode {
    let cli = Cli::parse();
    let method = method_of(&cli);
    spharm_cli::exit::run(|| work(&cli, method))
}

/// The method that the flags name; flags that don't belong to it are usage errors.
fn method_of(cli: &Cli) -> Method {
    let refuse = |flag: &str, method: &str, hint: &str| -> ! {
        let message = format!("{flag} doesn't go with --method {method}{hint}");
        Cli::command().error(ErrorKind::ArgumentConflict, message).exit()
    };
    if cli.start_degree.is_some() && !matches!(cli.method, MethodName::Sirf | MethodName::Mirf) {
        refuse("--start-degree", "irf or nlsf", "");
    }
    if cli.granularity.is_some() && cli.method != MethodName::Irf {
        refuse("--granularity", "sirf, mirf or nlsf", "");
    }
    if cli.passes.is_some_and(|p| p > 1) && matches!(cli.method, MethodName::Sirf | MethodName::Nlsf) {
        refuse("--passes", "sirf or nlsf", ", which have one pass; several passes of sirf are mirf");
    }
    let (passes, start_degree) = (cli.passes.unwrap_or(1) as usize, cli.start_degree.unwrap_or(0));
    match cli.method {
        MethodName::Irf => Method::Irf { passes, granularity: cli.granularity.unwrap_or(100) },
        MethodName::Sirf => Method::Sirf { start_degree },
        MethodName::Mirf => Method::Mirf { passes, start_degree },
        MethodName::Nlsf => Method::Nlsf,
    }
}

fn work(cli: &Cli, method: Method) -> Result<()> {
    let started = Instant::now();
    let console = cli.common.console();
    let cancel = spharm_cli::exit::cancel();
    raise_file_limit();
    let items = items(cli, &console)?;
    if items.is_empty() {
        return print("nothing to do: every output exists");
    }
    if let Some(path) = &cli.report {
        refuse_existing(path, cli.force, "report", "--report")?;
    }
    let sphere = read_sphere(&cli.sphere, &console)?;
    let weights = weights(&cli.weights, &sphere)?;
    let pool = cli.threads.pool()?;
    let (scheme, scalar) = open_scheme(cli, &sphere)?;
    if cli.verify {
        verify(&scheme, &console, cancel)?;
    }
    let mut seconds = Seconds { read: started.elapsed().as_secs_f64(), ..Seconds::default() };
    let key = scheme.key();
    let operator = DiskOperator::new(scheme);
    let threads = cli.threads.count();
    let mut job = Job { cli, console, sphere, weights, key, scalar, method, operator, seconds, threads };
    let fits = pool.install(|| job.run(&items, cancel))?;
    seconds = job.seconds;
    seconds.total = started.elapsed().as_secs_f64();
    finish(cli, &job, fits, seconds)
}

fn weights(choice: &str, sphere: &Sphere) -> Result<Option<Vec<f64>>> {
    match choice {
        "uniform" => Ok(None),
        "area" if sphere.faces.is_empty() => {
            bail!("--weights area needs triangles, and {} has none; give a sphere mesh", sphere.path.display())
        }
        "area" => Ok(Some(sphere.areas())),
        file => {
            let signal = read_signal(file)?;
            let (n, expected) = (signal.vertices, sphere.directions.len());
            if signal.channels != 1 || n != expected {
                bail!("{file}: expected one weight for each of {expected} vertices, found {n} x {}", signal.channels);
            }
            Ok(Some(signal.values))
        }
    }
}

fn open_scheme(cli: &Cli, sphere: &Sphere) -> Result<(Scheme, Scalar)> {
    let n = sphere.directions.len();
    let open = |scalar| Scheme::open(&cli.store, SchemeKey::of(&sphere.directions, scalar), n, cli.max_degree);
    if let Err(error) = std::fs::read_dir(&cli.store) {
        bail!("{}: cannot open the store: {error}; build one with basis-build", cli.store.display());
    }
    match cli.dtype {
        Some(Dtype::F64) => Ok((open(Scalar::F64)?, Scalar::F64)),
        Some(Dtype::F32) => Ok((open(Scalar::F32)?, Scalar::F32)),
        None => match open(Scalar::F64) {
            Err(error @ StoreError::NoSuchScheme { .. }) => match open(Scalar::F32) {
                Err(StoreError::NoSuchScheme { .. }) => Err(error.into()),
                single => Ok((single?, Scalar::F32)),
            },
            double => Ok((double?, Scalar::F64)),
        },
    }
}

fn verify(scheme: &Scheme, console: &Console, cancel: &AtomicBool) -> Result<()> {
    let bytes = scheme.files().iter().map(spharm_store::DegreeFile::file_len).sum();
    let progress = console.progress("verify", bytes, Unit::Bytes);
    let mut buffer = Vec::new();
    for file in scheme.files() {
        if cancel.load(Ordering::Relaxed) {
            return Err(StoreError::Interrupted.into());
        }
        catalog::verify(file, &mut buffer)?;
        progress.add(file.file_len());
    }
    Ok(())
}
