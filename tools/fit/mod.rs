//! `fit`: fits surfaces and signals on the sphere.

mod bare;
mod between;
mod exact;
mod hold_out;
mod job;
mod outputs;
mod quadrature;
mod report;
mod streamed;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Result, bail};
use clap::ValueEnum;
use spharm_cli::console::{Console, Unit};
use spharm_cli::inputs::read_sphere;
use spharm_cli::machine::raise_file_limit;
use spharm_cli::output::{print, refuse_existing};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_cli::{Common, Usage};
use spharm_harmonics::{MAX_DEGREE, basis_size};
use spharm_solver::Method;
use spharm_store::{Scalar, Scheme, SchemeKey, StoreError, catalog};
use spharm_surface::Sphere;
use spharm_surface::io::read_signal;

use self::between::Between;
use self::hold_out::HoldOut;
use self::job::Job;
use self::outputs::{Item, items};
use self::report::{BatchReport, Fitted, Mapped, Seconds, finish};

/// Fit surfaces, or any signals on the sphere, with spherical harmonics
///
/// Without --store: the exact least squares, by fast transforms. With --store: iterative residual fitting over a basis that
/// basis-build has made for the same sphere, in bounded memory. All surfaces of one call are fitted together, in as few
/// sweeps as the memory allows.
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// Folder of the basis store
    #[arg(long, value_name = "DIR", env = "SPHARM_STORE")]
    store: Option<PathBuf>,
    /// The sphere: a mesh around the origin, or a CSV of theta,phi; without it each surface is mapped to one of its own
    /// first, as parametrize does, which is written beside its model
    #[arg(long, value_name = "SPHERE")]
    sphere: Option<PathBuf>,
    /// Surfaces, or signals (GIfTI, FreeSurfer curv, CSV with a row a vertex), on the sphere's vertices; @LIST takes the
    /// paths from a file, one a line, relative to it, # for comments
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    surface: Vec<PathBuf>,
    /// Highest degree, inclusive
    #[arg(long, value_name = "L")]
    max_degree: usize,
    /// Exact least squares, iterative residual fitting and the paper's special cases of it over a store, the paper's full
    /// least squares over a store, or quadrature on a resampled grid [default: irf with --store, else lsq]
    #[arg(long, value_enum)]
    method: Option<MethodName>,
    /// Number of passes, p (irf, mirf) [default: 1; with --accelerate 16]
    #[arg(long, value_name = "P", value_parser = clap::value_parser!(u32).range(1..))]
    passes: Option<u32>,
    /// Most basis functions solved together, g (irf) [default: 100]
    #[arg(long, value_name = "G", value_parser = at_least_one)]
    granularity: Option<usize>,
    /// Conjugate gradients over pairs of passes, one forward and one backward (irf, mirf): the least squares in far fewer
    /// passes where the sampling is irregular; --passes bounds them, and they end early when nothing is left to gain
    #[arg(long)]
    accelerate: bool,
    /// Last degree of the first block, s (sirf, mirf) [default: 0]
    #[arg(long, value_name = "S")]
    start_degree: Option<usize>,
    /// Weights of the vertices: uniform, area (their share of the sphere), or a file with one value for each
    #[arg(long, value_name = "uniform|area|FILE", default_value = "uniform")]
    weights: String,
    /// Smoothness penalty (lsq): adds LAMBDA sum (l (l + 1))^2 a^2 to the squared distances; auto chooses it for each
    /// surface by generalised cross-validation [default: 0 with --sphere; without, what weighs a hundredth of the vertices
    /// at the highest degree and holds the model between them]
    #[arg(long, value_name = "LAMBDA|auto")]
    smoothness: Option<Smoothness>,
    /// Also write each coefficient's standard error, NAME.spharm.stderr.npy (lsq)
    #[arg(long)]
    stderr: bool,
    /// Leave this fraction of the vertices out of the fit, and tell the distances there
    #[arg(long, value_name = "FRACTION", value_parser = fraction)]
    hold_out: Option<f64>,
    /// Optimality to reach (lsq): the gradient in relation to that of no fit at all
    #[arg(long, value_name = "T", default_value = "1e-10", value_parser = tolerance)]
    tolerance: f64,
    /// Most iterations (lsq)
    #[arg(long, value_name = "N", default_value_t = 3000)]
    max_iterations: usize,
    /// What the iterations are preconditioned with (lsq); auto makes a factor where they are slow
    #[arg(long, value_enum, default_value_t = PreconditionerName::Auto)]
    preconditioner: PreconditionerName,
    /// Highest degree of --preconditioner low-degrees [default: 20]
    #[arg(long, value_name = "L0")]
    low_degrees: Option<usize>,
    /// Scalar type of the basis to use [default: what the store holds, f64 first]
    #[arg(long, value_enum)]
    dtype: Option<Dtype>,
    /// Memory to keep to, mapped files included [default: 256MiB over a store, else half of what is free]
    #[arg(long, value_name = "SIZE")]
    memory: Option<Size>,
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
    /// Refuse surfaces that aren't closed and of genus zero, and fits that don't reach the tolerance
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
    Lsq,
    Irf,
    Sirf,
    Mirf,
    Nlsf,
    Quadrature,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum PreconditionerName {
    Auto,
    None,
    Density,
    LowDegrees,
    Factor,
}

/// The smoothness asked for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Smoothness {
    Auto,
    Lambda(f64),
}

impl std::str::FromStr for Smoothness {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" {
            return Ok(Self::Auto);
        }
        let lambda = text.parse().ok().filter(|lambda: &f64| *lambda >= 0.0 && lambda.is_finite());
        lambda.map(Self::Lambda).ok_or_else(|| "expected a number from 0, or auto".to_owned())
    }
}

/// What to do with the targets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum How {
    /// Residual fitting over a store.
    Streamed(Method),
    /// Least squares by transforms.
    Lsq,
    /// A resampled grid.
    Quadrature,
}

impl How {
    /// The method's name, in lower case.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Streamed(method) => method.name(),
            Self::Lsq => "lsq",
            Self::Quadrature => "quadrature",
        }
    }

    /// Passes over the basis.
    pub(crate) fn passes(self) -> usize {
        match self {
            Self::Streamed(method) => method.passes(),
            _ => 1,
        }
    }
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

fn fraction(text: &str) -> Result<f64, String> {
    let fraction = text.parse().ok().filter(|fraction: &f64| *fraction > 0.0 && *fraction < 1.0);
    fraction.ok_or_else(|| "expected a fraction between 0 and 1".to_owned())
}

fn tolerance(text: &str) -> Result<f64, String> {
    let tolerance = text.parse().ok().filter(|tolerance: &f64| *tolerance > 0.0 && *tolerance < 1.0);
    tolerance.ok_or_else(|| "expected a number between 0 and 1".to_owned())
}

/// Most sweeps beyond the one pass of nlsf: each takes the error that rounding left down by eps times the condition.
const REFINEMENTS: usize = 5;
/// Passes of an accelerated fit: eight iterations, with which even samplings are done.
const ACCELERATED_PASSES: u32 = 16;
/// More surfaces at a time gain nothing: their products then take much longer than reading the basis.
const MOST_TOGETHER: usize = 128;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    work(cli, how(cli)?)
}

/// The method that the flags name; flags that don't belong to it are usage errors.
fn how(cli: &Cli) -> Result<How> {
    let method = cli.method.unwrap_or(if cli.store.is_some() { MethodName::Irf } else { MethodName::Lsq });
    let name = method.to_possible_value().map_or(String::new(), |value| value.get_name().to_owned());
    let refuse = |flag: &str, hint: &str| Usage::conflict(format!("{flag} doesn't go with --method {name}{hint}"));
    let streamed = !matches!(method, MethodName::Lsq | MethodName::Quadrature);
    if streamed && cli.store.is_none() {
        bail!(Usage::missing(format!("--method {name} needs --store DIR, with a basis that basis-build has made")));
    }
    if streamed && cli.sphere.is_none() {
        bail!(Usage::missing(format!("--method {name} needs --sphere SPHERE, the one that the basis was built for")));
    }
    if cli.start_degree.is_some() && !matches!(method, MethodName::Sirf | MethodName::Mirf) {
        bail!(refuse("--start-degree", ""));
    }
    if cli.granularity.is_some() && method != MethodName::Irf {
        bail!(refuse("--granularity", ""));
    }
    if cli.passes.is_some_and(|p| p > 1) && !matches!(method, MethodName::Irf | MethodName::Mirf) {
        bail!(refuse("--passes", "; several passes of sirf are mirf"));
    }
    if cli.accelerate && !matches!(method, MethodName::Irf | MethodName::Mirf) {
        bail!(refuse("--accelerate", "; use --method irf or mirf"));
    }
    if method != MethodName::Lsq {
        let of_lsq = [
            (cli.smoothness.is_some(), "--smoothness"),
            (cli.stderr, "--stderr"),
            (cli.preconditioner != PreconditionerName::Auto, "--preconditioner"),
        ];
        if let Some((_, flag)) = of_lsq.into_iter().find(|(given, _)| *given) {
            bail!(refuse(flag, "; use --method lsq"));
        }
    }
    if method == MethodName::Quadrature && (cli.weights != "uniform" || cli.hold_out.is_some()) {
        bail!(refuse("--weights or --hold-out", ""));
    }
    if !streamed && (cli.dtype.is_some() || cli.verify) {
        bail!(refuse("--dtype or --verify", ", which doesn't read a basis"));
    }
    if cli.low_degrees.is_some() && cli.preconditioner != PreconditionerName::LowDegrees {
        bail!(refuse("--low-degrees", " without --preconditioner low-degrees"));
    }
    let passes = cli.passes.unwrap_or(if cli.accelerate { ACCELERATED_PASSES } else { 1 }) as usize;
    let start_degree = cli.start_degree.unwrap_or(0);
    Ok(match method {
        MethodName::Lsq => How::Lsq,
        MethodName::Quadrature => How::Quadrature,
        MethodName::Irf => How::Streamed(Method::Irf { passes, granularity: cli.granularity.unwrap_or(100) }),
        MethodName::Sirf => How::Streamed(Method::Sirf { start_degree }),
        MethodName::Mirf => How::Streamed(Method::Mirf { passes, start_degree }),
        MethodName::Nlsf => How::Streamed(Method::Nlsf),
    })
}

fn work(cli: &Cli, how: How) -> Result<()> {
    let started = Instant::now();
    let console = cli.common.console();
    let cancel = spharm_cli::exit::cancel();
    raise_file_limit();
    if cli.max_degree > MAX_DEGREE {
        bail!("--max-degree {}: the highest degree is {MAX_DEGREE}", cli.max_degree);
    }
    let items = items(cli, &console)?;
    if items.is_empty() {
        return print("nothing to do: every output exists");
    }
    if let Some(path) = &cli.report {
        refuse_existing(path, cli.force, "report", "--report")?;
    }
    let pool = cli.threads.pool()?;
    let mut seconds = Seconds::default();
    let (mut fitted, mut batches, mut scheme) = (Vec::new(), Vec::new(), None);
    if let Some(path) = &cli.sphere {
        let sphere = read_sphere(path, &console)?;
        seconds.read += started.elapsed().as_secs_f64();
        let fits = pool.install(|| fit_on(cli, how, console, sphere, &items, &mut seconds, cancel))?;
        (fitted, batches) = (fits.fitted, fits.batches);
        scheme = Some(fits.scheme);
    } else {
        bare::refuse(cli, &items)?;
        for item in &items {
            let (sphere, report) = pool.install(|| bare::parametrize(cli, item, &console))?;
            seconds.parametrize += report.seconds;
            let path = sphere.name().to_owned();
            let one = std::slice::from_ref(item);
            let fits = pool.install(|| fit_on(cli, how, console, sphere, one, &mut seconds, cancel));
            // A sphere without its model would stand in the way of the next attempt.
            let fits = fits.inspect_err(|_| drop(std::fs::remove_file(&path)))?;
            fitted.extend(fits.fitted.into_iter().map(|mut fitted| {
                fitted.parametrization = Some(Mapped { sphere: path.clone(), report: report.clone() });
                fitted
            }));
            batches.extend(fits.batches);
        }
    }
    seconds.total = started.elapsed().as_secs_f64();
    finish(cli, &console, how, scheme, (fitted, batches), seconds)
}

/// What came of the surfaces on one sphere.
struct Fits {
    fitted: Vec<Fitted>,
    batches: Vec<BatchReport>,
    scheme: (SchemeKey, Scalar),
}

/// Fits surfaces that share a sphere.
fn fit_on(
    cli: &Cli,
    how: How,
    console: Console,
    sphere: Sphere,
    items: &[Item],
    seconds: &mut Seconds,
    cancel: &AtomicBool,
) -> Result<Fits> {
    let hold_out = cli.hold_out.map(|fraction| HoldOut::new(sphere.directions.len(), fraction));
    let mut weights = weights(&cli.weights, &sphere)?;
    if let (Some(hold_out), Some(fraction)) = (&hold_out, cli.hold_out) {
        if hold_out.count() == 0 {
            bail!(
                "--hold-out {fraction} leaves none of {} vertices out; give a larger fraction",
                sphere.directions.len()
            );
        }
        console.note(format!("{} vertices are held out", hold_out.count()));
        weights = Some(hold_out.apply(weights));
    }
    let opened = match (how, &cli.store) {
        (How::Streamed(_), Some(store)) => Some(open_scheme(cli, store, &sphere)?),
        _ => None,
    };
    if let (true, Some((scheme, _))) = (cli.verify, &opened) {
        verify(scheme, &console, cancel)?;
    }
    let scalar = opened.as_ref().map_or(Scalar::F64, |(_, scalar)| *scalar);
    let key = opened.as_ref().map_or_else(|| SchemeKey::of(&sphere.directions, scalar), |(scheme, _)| scheme.key());
    let threads = cli.threads.count();
    let between = Between::new(&sphere, basis_size(cli.max_degree))?;
    let mut job =
        Job { cli, console, sphere, weights, hold_out, between, key, scalar, how, seconds: *seconds, threads };
    let (fitted, batches) = match (how, opened) {
        (How::Streamed(method), Some((scheme, _))) => streamed::run(&mut job, method, scheme, items, cancel),
        (How::Quadrature, _) => quadrature::run(&mut job, items, cancel),
        _ => exact::run(&mut job, items, cancel),
    }?;
    *seconds = job.seconds;
    Ok(Fits { fitted, batches, scheme: (key, scalar) })
}

fn weights(choice: &str, sphere: &Sphere) -> Result<Option<Vec<f64>>> {
    match choice {
        "uniform" => Ok(None),
        "area" if sphere.faces.is_empty() => {
            bail!("--weights area needs triangles, and {} has none; give a sphere mesh", sphere.name().display())
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

fn open_scheme(cli: &Cli, store: &Path, sphere: &Sphere) -> Result<(Scheme, Scalar)> {
    let n = sphere.directions.len();
    let open = |scalar| Scheme::open(store, SchemeKey::of(&sphere.directions, scalar), n, cli.max_degree);
    if let Err(error) = std::fs::read_dir(store) {
        bail!("{}: cannot open the store: {error}; build one with basis-build", store.display());
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
            return Err(StoreError::from(spharm_monitor::Interrupted).into());
        }
        catalog::verify(file, &mut buffer)?;
        progress.add(file.file_len());
    }
    Ok(())
}
