//! `fit`: fits surfaces and signals to a basis in a store.

use std::collections::VecDeque;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use clap::error::ErrorKind;
use clap::{CommandFactory, Parser, ValueEnum};
use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;
use serde::Serialize;
use spharm_cli::Common;
use spharm_cli::console::{Console, Unit};
use spharm_cli::inputs::{Sphere, Target, expand_lists, read_sphere, read_target, stem, unique_stems};
use spharm_cli::machine::{Memory, Versions, check_limits, memory, raise_file_limit, versions};
use spharm_cli::output::{print, print_json, table, write_json};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_solver::report::SweepReport;
use spharm_solver::{ChunkedRows, DiskOperator, FitEvent, FitParams, FitReport, Fitter, Method, Operator, SolverError};
use spharm_store::{Scalar, Scheme, SchemeKey, StoreError, catalog};
use spharm_surface::io::{read_signal, write_new};
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::model::{Model, write_complex_csv};

/// Fit surfaces, or any signals on the sphere, with spherical harmonics
///
/// The basis comes from a store that basis-build has made for the same sphere. All surfaces of one call are fitted
/// together, in as few sweeps over the store as the memory allows.
#[derive(Debug, Parser)]
#[command(name = "fit", version)]
struct Cli {
    /// Folder of the basis store
    #[arg(long, value_name = "DIR", env = "SPHARM_STORE")]
    store: PathBuf,
    /// The sphere that the basis was built for
    #[arg(long, value_name = "SPHERE")]
    sphere: PathBuf,
    /// Surfaces or signals on the sphere's vertices; @LIST takes the paths from a file, one a line
    #[arg(long, value_name = "FILE", num_args = 1.., required = true)]
    surface: Vec<PathBuf>,
    /// Highest degree, inclusive
    #[arg(long, value_name = "L")]
    max_degree: usize,
    /// Iterative residual fitting, the paper's special cases of it, or the full least squares
    #[arg(long, value_enum, default_value_t = MethodName::Irf)]
    method: MethodName,
    /// Number of passes, p (irf, mirf)
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
    /// File for one surface, folder for several [default: NAME.spharm.npz here]
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

/// g, where the method has one that isn't infinite.
fn granularity_of(method: Method) -> Option<usize> {
    match method {
        Method::Irf { granularity, .. } if granularity < usize::MAX => Some(granularity),
        _ => None,
    }
}

/// s, where the method has one.
fn start_degree_of(method: Method) -> Option<usize> {
    match method {
        Method::Sirf { start_degree } | Method::Mirf { start_degree, .. } => Some(start_degree),
        Method::Irf { .. } | Method::Nlsf => None,
    }
}

/// One surface to fit and where its model goes.
struct Item {
    input: PathBuf,
    output: PathBuf,
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
    if let Some(report) = cli.report.as_deref().filter(|path| path.exists() && !cli.force) {
        bail!("{}: the report exists; choose another --report or give --force", report.display());
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

#[derive(Debug, Clone, Copy, Default, Serialize)]
struct Seconds {
    read: f64,
    plan: f64,
    solve: f64,
    write: f64,
    total: f64,
}

/// Whether `--output` means a folder: it is one, ends in a slash, or a list was given.
fn names_folder(cli: &Cli, output: &Path) -> bool {
    let is_list = |path: &PathBuf| path.to_str().is_some_and(|text| text.starts_with('@'));
    output.is_dir() || output.to_string_lossy().ends_with('/') || cli.surface.iter().any(is_list)
}

/// `NAME.spharm.csv` beside `NAME.spharm.npz`.
fn csv_of(output: &Path) -> PathBuf {
    let text = output.to_string_lossy();
    PathBuf::from(format!("{}.csv", text.strip_suffix(".npz").unwrap_or(&text)))
}

/// Inputs and outputs; refuses before any work what would clash or overwrite.
fn items(cli: &Cli, console: &Console) -> Result<Vec<Item>> {
    let inputs = expand_lists(&cli.surface)?;
    let mut items: Vec<Item> = match (&inputs[..], &cli.output) {
        ([input], Some(output)) if !names_folder(cli, output) => {
            vec![Item { input: input.clone(), output: output.clone() }]
        }
        (_, folder) => {
            let folder = folder.clone().unwrap_or_default();
            let named = inputs.iter().zip(unique_stems(&inputs));
            named
                .map(|(input, name)| Item { output: folder.join(format!("{name}.spharm.npz")), input: input.clone() })
                .collect()
        }
    };
    let mut outputs: Vec<&Path> = items.iter().map(|item| item.output.as_path()).collect();
    outputs.sort_unstable();
    if let Some(pair) = outputs.windows(2).find(|pair| pair[0] == pair[1]) {
        bail!("two surfaces would be written to {}; rename one or fit them apart", pair[0].display());
    }
    let before = items.len();
    if cli.skip_existing {
        items.retain(|item| !item.output.exists());
        if items.len() < before {
            console.note(format!("{} outputs exist and are left alone", before - items.len()));
        }
    } else if !cli.force
        && let Some(item) = items.iter().find(|item| item.output.exists())
    {
        bail!(
            "{}: the output exists; choose another --output, or give --force or --skip-existing",
            item.output.display()
        );
    }
    for item in &items {
        let csv = csv_of(&item.output);
        if cli.coefficients_csv && !cli.force && csv.exists() {
            bail!("{}: the output exists; choose another --output or give --force", csv.display());
        }
        if !item.input.is_file() {
            let what = if item.input.exists() { "not a regular file" } else { "no such file" };
            bail!("{}: {what}", item.input.display());
        }
    }
    Ok(items)
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

struct Job<'c> {
    cli: &'c Cli,
    console: Console,
    sphere: Sphere,
    weights: Option<Vec<f64>>,
    key: SchemeKey,
    scalar: Scalar,
    method: Method,
    operator: DiskOperator,
    seconds: Seconds,
    threads: usize,
}

/// A fitted surface, as the report shows it.
#[derive(Debug, Clone, Serialize)]
struct Fitted {
    input: PathBuf,
    output: PathBuf,
    channels: usize,
    /// Cube root of the bounding box's volume, in the input's unit; none for what has no volume.
    scale: Option<f64>,
    passes: Vec<Distances>,
}

/// Distances after one sweep; msd and xsd with the bounding box scaled to volume 1.
#[derive(Debug, Clone, Copy, Serialize)]
struct Distances {
    /// Whether this sweep came after the passes asked for, to remove what rounding had left.
    refinement: bool,
    msd: Option<f64>,
    xsd: Option<f64>,
    msd_raw: f64,
    xsd_raw: f64,
}

/// Targets in the order of the items, read a few at a time.
struct Queue<'i> {
    rest: std::slice::Iter<'i, Item>,
    ready: VecDeque<(&'i Item, Target)>,
}

/// Targets side by side in one array, the columns of each, and what is known about each.
struct Batch<'i> {
    items: Vec<&'i Item>,
    targets: ChunkedRows,
    groups: Vec<Range<usize>>,
    about: Vec<About>,
}

impl Job<'_> {
    fn run(&mut self, items: &[Item], cancel: &AtomicBool) -> Result<(Vec<Fitted>, Vec<FitReport>)> {
        let mut queue = Queue { rest: items.iter(), ready: VecDeque::new() };
        let mark = Instant::now();
        self.fill(&mut queue)?;
        self.seconds.read += mark.elapsed().as_secs_f64();
        // The first one tells the channels of all, which are the same in most studies.
        let channels = queue.ready[0].1.channels;
        self.lower_threads(channels);
        let mut seconds = self.seconds;
        let done = self.fit_all(items.len(), channels, queue, &mut seconds, cancel)?;
        self.seconds = seconds;
        Ok(done)
    }

    fn fit_all(
        &self,
        surfaces: usize,
        channels: usize,
        mut queue: Queue<'_>,
        seconds: &mut Seconds,
        cancel: &AtomicBool,
    ) -> Result<(Vec<Fitted>, Vec<FitReport>)> {
        let (mut fitted, mut reports) = (Vec::new(), Vec::new());
        let mark = Instant::now();
        let together = self.surfaces_together(surfaces, channels)?;
        let mut fitter = self.fitter(together, channels, surfaces > together)?;
        seconds.plan += mark.elapsed().as_secs_f64();
        self.say_plan(&fitter, surfaces, together);
        let sweeps = surfaces.div_ceil(together) * self.method.passes();
        let total = (sweeps * basis_size(self.cli.max_degree)) as u64;
        let progress = self.console.progress("fit", total, Unit::Count("columns"));
        loop {
            let mark = Instant::now();
            let Some(batch) = self.next_batch(&mut queue, fitter.channels())? else { break };
            seconds.read += mark.elapsed().as_secs_f64();
            if batch.targets.channels() > fitter.channels() {
                // One target with more channels than were planned for has a batch, and a plan, of its own.
                fitter = self.fitter(1, batch.targets.channels(), true)?;
            }
            let mark = Instant::now();
            let last = std::cell::Cell::new(0);
            let result = fitter.fit(batch.targets, &batch.groups, cancel, &|event| match event {
                FitEvent::Solving(sweep, degrees) => {
                    progress.say(format!("pass {sweep}, degrees {} to {}", degrees.start(), degrees.end()));
                }
                FitEvent::Block(sweep, done, _) if sweep <= self.method.passes() => {
                    let before = if done <= last.get() { 0 } else { last.get() };
                    progress.add((done - before) as u64);
                    last.set(done);
                }
                FitEvent::Sweep(report) => {
                    let gigabytes = report.bytes_read as f64 / 1e9;
                    self.console.detail(format!("pass {}: {:.2} s, {gigabytes:.2} GB", report.pass, report.seconds));
                }
                _ => {}
            })?;
            seconds.solve += mark.elapsed().as_secs_f64();
            let mark = Instant::now();
            let (items, groups) = (&batch.items, &batch.groups);
            fitted.extend(self.write_batch(items, groups, batch.about, &result.coefficients, &result.report)?);
            seconds.write += mark.elapsed().as_secs_f64();
            reports.push(result.report);
        }
        Ok((fitted, reports))
    }

    fn fitter(&self, together: usize, channels: usize, reuse: bool) -> Result<Fitter<'_>> {
        let fitter = Fitter::new(&self.operator, together * channels, self.params(together, channels, reuse));
        let fitter = fitter.map_err(|error| match error {
            error @ SolverError::Weight { .. } => {
                anyhow::Error::from(error).context(format!("--weights {}", self.cli.weights))
            }
            error => error.into(),
        })?;
        self.check_limits(&fitter)?;
        Ok(fitter)
    }

    /// Reads the next few targets, one for each thread.
    fn fill<'i>(&self, queue: &mut Queue<'i>) -> Result<()> {
        let next: Vec<&Item> = queue.rest.by_ref().take(self.threads).collect();
        let read = |item: &&'i Item| -> Result<(&'i Item, Target)> {
            Ok((item, read_target(&item.input, &self.sphere, self.cli.strict, &self.console)?))
        };
        let targets: Vec<(&Item, Target)> = next.par_iter().map(read).collect::<Result<_>>()?;
        queue.ready.extend(targets);
        Ok(())
    }

    /// As many targets as have at most `channels` columns together, and at least one; `None` when all are done.
    fn next_batch<'i>(&self, queue: &mut Queue<'i>, channels: usize) -> Result<Option<Batch<'i>>> {
        let (mut taken, mut columns) = (Vec::new(), 0);
        loop {
            if queue.ready.is_empty() {
                self.fill(queue)?;
            }
            let Some((_, target)) = queue.ready.front() else { break };
            if !taken.is_empty() && columns + target.channels > channels {
                break;
            }
            columns += target.channels;
            taken.extend(queue.ready.pop_front());
        }
        if taken.is_empty() {
            return Ok(None);
        }
        let n = self.sphere.directions.len();
        let mut targets = ChunkedRows::zeros(n, columns, self.operator.chunk_rows());
        let (mut items, mut groups, mut about, mut at) = (Vec::new(), Vec::new(), Vec::new(), 0);
        for (item, target) in taken {
            targets.set_columns(at, ArrayView2::from_shape((n, target.channels), &target.values[..])?);
            groups.push(at..at + target.channels);
            at += target.channels;
            about.push(About::of(&target));
            items.push(item);
        }
        Ok(Some(Batch { items, targets, groups, about }))
    }

    fn write_batch(
        &self,
        batch: &[&Item],
        groups: &[Range<usize>],
        about: Vec<About>,
        coefficients: &Coefficients,
        report: &FitReport,
    ) -> Result<Vec<Fitted>> {
        let one = |((index, item), about): ((usize, &&Item), About)| -> Result<Fitted> {
            let distances = report.sweeps.iter().map(|sweep| about.distances(sweep, index)).collect();
            let fitted = Fitted {
                input: item.input.clone(),
                output: item.output.clone(),
                channels: groups[index].len(),
                scale: about.scale,
                passes: distances,
            };
            let values: Array2<f64> = coefficients.values().slice(s![.., groups[index].clone()]).to_owned();
            self.write(&fitted, &about, Coefficients::new(values)?)?;
            Ok(fitted)
        };
        let work: Vec<_> = batch.iter().enumerate().zip(about).collect();
        work.into_par_iter().map(one).collect()
    }

    fn write(&self, fitted: &Fitted, about: &About, coefficients: Coefficients) -> Result<()> {
        let output = &fitted.output;
        if let Some(folder) = output.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display()))?;
        }
        let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
        let provenance = Provenance {
            tool: "fit",
            versions: versions(),
            input: name(&fitted.input),
            sphere: name(&self.sphere.path),
            method: self.method.name(),
            passes: self.method.passes(),
            granularity: granularity_of(self.method),
            start_degree: start_degree_of(self.method),
            weights: &self.cli.weights,
            dtype: self.scalar.name(),
            surface: about.surface,
            scale: fitted.scale,
            distances: fitted.passes.last().copied(),
            anatomical_structure_primary: about.anatomical_structure.as_deref(),
        };
        if self.cli.coefficients_csv {
            write_new(csv_of(output), self.cli.force, |out| write_complex_csv(&coefficients, out))?;
        }
        let model = Model {
            coefficients,
            directions: self.sphere.directions.as_slice().to_vec(),
            faces: self.sphere.faces.clone(),
            scheme_key: self.key.to_string(),
            provenance: serde_json::to_string(&provenance)?,
        };
        write_new(output, self.cli.force, |out| model.write(out))?;
        Ok(())
    }

    fn params(&self, together: usize, channels: usize, reuse: bool) -> FitParams {
        FitParams {
            max_degree: self.cli.max_degree,
            method: self.method,
            refinements: if self.method == Method::Nlsf { REFINEMENTS } else { 0 },
            weights: self.weights.clone(),
            memory: self.cli.memory.0,
            held: self.held(together, channels),
            threads: self.threads,
            reuse,
        }
    }

    /// Bytes that the tool holds beside the solver: the program, the sphere, the targets as they were read, and a surface
    /// for each thread while it is read or written.
    fn held(&self, together: usize, channels: usize) -> usize {
        /// The program, its stacks and allocator, measured on a fit of a small mesh.
        const BASE: usize = 12 << 20;
        let n = self.sphere.directions.len();
        let sphere = 24 * n + 12 * self.sphere.faces.len();
        // A file as text, decoded, and as a mesh with its topology.
        let reading = 5 * sphere + 16 * n * channels;
        BASE + sphere + 8 * n * channels * together + reading * self.threads.min(together)
    }

    /// As many surfaces as fit the budget with every block whole in memory; if that is none, as many as fit at all.
    fn surfaces_together(&self, surfaces: usize, channels: usize) -> Result<usize> {
        let plan = |together: usize| {
            let params = self.params(together, channels, surfaces > together);
            spharm_solver::plan(&self.operator, together * channels, &params)
        };
        let whole = |&together: &usize| plan(together).is_ok_and(|plan| plan.whole.iter().all(|&whole| whole));
        let most = surfaces.min(MOST_TOGETHER);
        if let Some(together) = (1..=most).rev().find(whole) {
            return Ok(together);
        }
        match (1..=most).rev().find(|&together| plan(together).is_ok()) {
            Some(together) => Ok(together),
            // Says what would be enough for one.
            None => Ok(plan(1).map(|_| 1)?),
        }
    }

    /// Each thread has sums of its own: on a node with many cores they may be what doesn't fit the budget.
    fn lower_threads(&mut self, channels: usize) {
        let asked = self.threads;
        let fits = |job: &Self| {
            let params = job.params(1, channels, false);
            spharm_solver::plan(&job.operator, channels, &params).is_ok()
        };
        while self.threads > 1 && !fits(self) {
            self.threads -= 1;
        }
        if self.threads < asked && fits(self) {
            self.console.note(format!("{} threads in place of {asked}, to keep to the memory", self.threads));
        }
    }

    fn check_limits(&self, fitter: &Fitter<'_>) -> Result<()> {
        let plan = fitter.plan();
        let blas = self.threads * spharm_solver::dense::RESERVED_PER_THREAD;
        let decoded = if self.operator.is_direct() { 0 } else { plan.basis };
        check_limits(plan.arrays + plan.work + plan.factors + blas + decoded, plan.basis)
    }

    fn say_plan(&self, fitter: &Fitter<'_>, surfaces: usize, together: usize) {
        let plan = fitter.plan();
        let blocks = fitter.blocks().len();
        self.console.note(format!(
            "{surfaces} of n = {}, L = {}: {} with {} pass(es) of {blocks} block(s), {together} at a time, {} of {} planned",
            self.operator.rows(),
            self.cli.max_degree,
            self.method.name(),
            self.method.passes(),
            Size(plan.total),
            Size(plan.budget),
        ));
        if !plan.whole.iter().all(|&whole| whole) {
            let twice = plan.whole.iter().filter(|&&whole| !whole).count();
            self.console.note(format!("{twice} block(s) don't fit the memory and are read again for each use"));
        }
    }
}

/// What is kept of a target while its values are being fitted.
struct About {
    surface: bool,
    scale: Option<f64>,
    anatomical_structure: Option<String>,
}

impl About {
    fn of(target: &Target) -> Self {
        let scale = target.surface.then(|| {
            let vertices: Vec<[f64; 3]> = target.values.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect();
            // A flat surface has no volume to scale to.
            bounding_box_scale(&vertices).ok()
        });
        Self {
            surface: target.surface,
            scale: scale.flatten(),
            anatomical_structure: target.anatomical_structure.clone(),
        }
    }

    fn distances(&self, sweep: &SweepReport, index: usize) -> Distances {
        let residual = &sweep.residuals[index];
        let normalised = |value: f64| self.scale.map(|scale| value / (scale * scale));
        Distances {
            refinement: sweep.refinement,
            msd: normalised(residual.mean_square),
            xsd: normalised(residual.max_square),
            msd_raw: residual.mean_square,
            xsd_raw: residual.max_square,
        }
    }
}

#[derive(Debug, Serialize)]
struct Provenance<'a> {
    tool: &'static str,
    versions: Versions,
    input: Option<String>,
    sphere: Option<String>,
    method: &'static str,
    passes: usize,
    granularity: Option<usize>,
    start_degree: Option<usize>,
    weights: &'a str,
    dtype: &'static str,
    surface: bool,
    scale: Option<f64>,
    distances: Option<Distances>,
    anatomical_structure_primary: Option<&'a str>,
}

#[derive(Debug, Serialize)]
struct Report {
    tool: &'static str,
    versions: Versions,
    store: PathBuf,
    sphere: PathBuf,
    scheme_key: String,
    dtype: &'static str,
    weights: String,
    granularity: Option<usize>,
    start_degree: Option<usize>,
    openblas: String,
    surfaces: Vec<Fitted>,
    batches: Vec<FitReport>,
    seconds: Seconds,
    memory: Memory,
}

fn finish(cli: &Cli, job: &Job<'_>, fits: (Vec<Fitted>, Vec<FitReport>), seconds: Seconds) -> Result<()> {
    let (surfaces, batches) = fits;
    let report = Report {
        tool: "fit",
        versions: versions(),
        store: cli.store.clone(),
        sphere: cli.sphere.clone(),
        scheme_key: job.key.to_string(),
        dtype: job.scalar.name(),
        weights: cli.weights.clone(),
        granularity: granularity_of(job.method),
        start_degree: start_degree_of(job.method),
        openblas: spharm_solver::dense::openblas(),
        surfaces,
        batches,
        seconds,
        memory: memory(),
    };
    for block in report.batches[0].blocks.iter().filter(|block| block.rank < block.columns) {
        job.console.warn(format!(
            "degrees {} to {}: rank {} of {} columns; the sampling doesn't determine them, the solution of least norm was taken",
            block.first_degree, block.last_degree, block.rank, block.columns
        ));
    }
    if let Some(path) = &cli.report {
        write_json(path, cli.force, &report)?;
    }
    if cli.json {
        return print_json(&report);
    }
    let mut rows = vec![["surface", "msd", "xsd", "rms", "max", "model"].map(str::to_owned).to_vec()];
    for fitted in &report.surfaces {
        let Some(last) = fitted.passes.last() else { continue };
        let normalised = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.4e}"));
        rows.push(vec![
            stem(&fitted.input),
            normalised(last.msd),
            normalised(last.xsd),
            format!("{:.4e}", last.msd_raw.sqrt()),
            format!("{:.4e}", last.xsd_raw.sqrt()),
            fitted.output.display().to_string(),
        ]);
    }
    print(&format!("{}\n{:.2} s", table(&rows), seconds.total))
}
