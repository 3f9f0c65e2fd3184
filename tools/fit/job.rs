//! The work: batches of targets, as many columns at a time as the memory allows.

use std::collections::VecDeque;
use std::ops::Range;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use anyhow::{Context, Result};
use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;
use spharm_cli::console::{Console, Unit};
use spharm_cli::inputs::{Sphere, Target, read_target};
use spharm_cli::machine::check_limits;
use spharm_cli::size::Size;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_solver::{
    BlockOperator, ChunkedRows, DiskOperator, FitEvent, FitParams, FitReport, Fitter, Method, Operator, SolverError,
};
use spharm_store::{Scalar, SchemeKey};
use spharm_surface::io::write_new;
use spharm_surface::model::{Model, write_complex_csv};

use crate::outputs::{Item, csv_of};
use crate::report::{About, Fitted, Provenance, Seconds, granularity_of, start_degree_of};
use crate::{Cli, MOST_TOGETHER, REFINEMENTS};

pub(crate) struct Job<'c> {
    pub(crate) cli: &'c Cli,
    pub(crate) console: Console,
    pub(crate) sphere: Sphere,
    pub(crate) weights: Option<Vec<f64>>,
    pub(crate) key: SchemeKey,
    pub(crate) scalar: Scalar,
    pub(crate) method: Method,
    pub(crate) operator: DiskOperator,
    pub(crate) seconds: Seconds,
    pub(crate) threads: usize,
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
    pub(crate) fn run(&mut self, items: &[Item], cancel: &AtomicBool) -> Result<(Vec<Fitted>, Vec<FitReport>)> {
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
                    let name = if report.refinement { "refinement after pass" } else { "pass" };
                    let gigabytes = report.bytes_read as f64 / 1e9;
                    self.console.detail(format!("{name} {}: {:.2} s, {gigabytes:.2} GB", report.pass, report.seconds));
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
            versions: spharm_cli::machine::versions(),
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
