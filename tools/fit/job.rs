//! What all methods share: targets read a few at a time, batches of them, models written.

use std::collections::VecDeque;
use std::ops::Range;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result};
use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;
use spharm_cli::console::Console;
use spharm_cli::inputs::read_target;
use spharm_cli::machine::available_memory;
use spharm_harmonics::Coefficients;
use spharm_solver::report::Residual;
use spharm_store::{Scalar, SchemeKey};
use spharm_surface::io::write_new;
use spharm_surface::model::{Model, write_complex_csv};
use spharm_surface::{Kind, Sphere, Target};

use super::between::Between;
use super::hold_out::HoldOut;
use super::outputs::{Item, csv_of, errors_of};
use super::report::{About, BatchReport, Distances, Fitted, Provenance, Seconds, granularity_of, start_degree_of};
use super::{Cli, How, Smoothness};

pub(crate) struct Job<'c> {
    pub(crate) cli: &'c Cli,
    pub(crate) console: Console,
    pub(crate) sphere: Sphere,
    /// Weights of the vertices; zero for those that are held out.
    pub(crate) weights: Option<Vec<f64>>,
    pub(crate) hold_out: Option<HoldOut>,
    pub(crate) between: Option<Between>,
    pub(crate) key: SchemeKey,
    pub(crate) scalar: Scalar,
    pub(crate) how: How,
    pub(crate) seconds: Seconds,
    pub(crate) threads: usize,
}

/// Targets in the order of the items, read a few at a time.
pub(crate) struct Queue<'i> {
    rest: std::slice::Iter<'i, Item>,
    ready: VecDeque<(&'i Item, Target)>,
}

impl Queue<'_> {
    /// Channels of the first target: of all of them, in most studies.
    pub(crate) fn channels(&self) -> usize {
        self.ready.front().map_or(1, |(_, target)| target.channels)
    }
}

/// Targets that are fitted together, and the columns of each.
pub(crate) struct Batch<'i> {
    items: Vec<&'i Item>,
    targets: Vec<Target>,
    pub(crate) groups: Vec<Range<usize>>,
}

/// What a method made of a batch.
pub(crate) struct Solved {
    /// Canonical coefficients, (K, columns of the batch).
    pub(crate) coefficients: Array2<f64>,
    /// Whether it was a refinement, and the residual of each target, sweep after sweep.
    pub(crate) sweeps: Vec<(bool, Vec<Residual>)>,
    /// Like the coefficients, when they were asked for.
    pub(crate) standard_errors: Option<Array2<f64>>,
    pub(crate) report: BatchReport,
}

impl Batch<'_> {
    /// Columns of all targets.
    pub(crate) fn columns(&self) -> usize {
        self.groups.last().map_or(0, |group| group.end)
    }

    /// Target after target with its columns, (n, c).
    pub(crate) fn targets(&self) -> impl Iterator<Item = (Range<usize>, ArrayView2<'_, f64>)> {
        self.groups.iter().cloned().zip(self.targets.iter().map(view))
    }

    /// All columns side by side, (n, c).
    pub(crate) fn side_by_side(&self) -> Array2<f64> {
        let rows = self.targets.first().map_or(0, |target| target.values.len() / target.channels.max(1));
        let mut all = Array2::zeros((rows, self.columns()));
        for (group, target) in self.targets() {
            all.slice_mut(s![.., group]).assign(&target);
        }
        all
    }
}

/// A target's values, (n, c).
fn view(target: &Target) -> ArrayView2<'_, f64> {
    let shape = (target.values.len() / target.channels.max(1), target.channels);
    ArrayView2::from_shape(shape, &target.values[..]).expect("a target has channels values for each vertex")
}

impl Job<'_> {
    /// The queue of the items, its first targets read.
    pub(crate) fn queue<'i>(&mut self, items: &'i [Item]) -> Result<Queue<'i>> {
        let mut queue = Queue { rest: items.iter(), ready: VecDeque::new() };
        let mark = Instant::now();
        self.fill(&mut queue)?;
        self.seconds.read += mark.elapsed().as_secs_f64();
        Ok(queue)
    }

    /// Fits batch after batch with at most `columns` columns, and writes the models. `solve` may find a batch of one target
    /// with more.
    pub(crate) fn each_batch<'i>(
        &self,
        mut queue: Queue<'i>,
        columns: usize,
        seconds: &mut Seconds,
        mut solve: impl FnMut(&Batch<'i>) -> Result<Solved>,
    ) -> Result<(Vec<Fitted>, Vec<BatchReport>)> {
        let (mut fitted, mut reports) = (Vec::new(), Vec::new());
        loop {
            let mark = Instant::now();
            let Some(batch) = self.next_batch(&mut queue, columns)? else { break };
            seconds.read += mark.elapsed().as_secs_f64();
            let mark = Instant::now();
            let solved = solve(&batch)?;
            seconds.solve += mark.elapsed().as_secs_f64();
            let mark = Instant::now();
            fitted.extend(self.write_batch(&batch, &solved)?);
            seconds.write += mark.elapsed().as_secs_f64();
            reports.push(solved.report);
        }
        Ok((fitted, reports))
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
        let (mut items, mut targets, mut groups, mut at) = (Vec::new(), Vec::new(), Vec::new(), 0);
        for (item, target) in taken {
            groups.push(at..at + target.channels);
            at += target.channels;
            items.push(item);
            targets.push(target);
        }
        Ok(Some(Batch { items, targets, groups }))
    }

    fn write_batch(&self, batch: &Batch<'_>, solved: &Solved) -> Result<Vec<Fitted>> {
        let one = |index: usize| -> Result<Fitted> {
            let (item, target, group) = (batch.items[index], &batch.targets[index], batch.groups[index].clone());
            let about = About::of(target);
            let distances = solved.sweeps.iter().map(|(refinement, residuals)| {
                about.of_residual(residuals[index].mean_square, residuals[index].max_square, *refinement)
            });
            let values: Array2<f64> = solved.coefficients.slice(s![.., group.clone()]).to_owned();
            let hold_out = self.hold_out.as_ref();
            let held_out = hold_out
                .map(|hold_out| hold_out.judge(&self.sphere.directions, values.view(), view(target), &about))
                .transpose()?;
            let passes: Vec<Distances> = distances.collect();
            let between = match (&self.between, passes.last()) {
                (Some(places), Some(at)) if target.kind == Kind::Surface => {
                    let (between, wild) = places.judge(values.view(), view(target), at, &about)?;
                    wild.into_iter().for_each(|ratio| self.warn_of_wildness(&item.input, ratio));
                    Some(between)
                }
                _ => None,
            };
            let fitted = Fitted {
                input: item.input.clone(),
                output: item.output.clone(),
                channels: target.channels,
                scale: about.scale,
                passes,
                between,
                held_out,
                parametrization: None,
            };
            let errors = solved.standard_errors.as_ref().map(|errors| errors.slice(s![.., group]).to_owned());
            self.write(&fitted, &about, Coefficients::new(values)?, errors, solved.report.smoothness())?;
            Ok(fitted)
        };
        (0..batch.items.len()).into_par_iter().map(one).collect()
    }

    fn warn_of_wildness(&self, input: &Path, ratio: f64) {
        let smoother = match (self.how, self.cli.smoothness) {
            (How::Lsq, Some(Smoothness::Auto)) => "",
            (How::Lsq, _) => "--smoothness auto, ",
            _ => "--method lsq --smoothness auto, ",
        };
        self.console.warn(format!(
            "{}: between the vertices the model is {ratio:.0} times as far off as at them: they leave it open there; use \
             {smoother}a lower --max-degree, or a sphere that gives room to large triangles",
            input.display()
        ));
    }

    fn write(
        &self,
        fitted: &Fitted,
        about: &About,
        coefficients: Coefficients,
        errors: Option<Array2<f64>>,
        smoothness: f64,
    ) -> Result<()> {
        let output = &fitted.output;
        if let Some(folder) = output.parent().filter(|folder| !folder.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display()))?;
        }
        let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
        let provenance = Provenance {
            tool: "fit",
            versions: spharm_cli::machine::versions(),
            input: name(&fitted.input),
            sphere: self.sphere.path.as_deref().and_then(name),
            method: self.how.name(),
            passes: self.how.passes(),
            granularity: granularity_of(self.how),
            start_degree: start_degree_of(self.how),
            weights: &self.cli.weights,
            smoothness,
            dtype: self.scalar.name(),
            surface: about.surface,
            scale: fitted.scale,
            distances: fitted.passes.last().copied(),
            anatomical_structure_primary: about.anatomical_structure.as_deref(),
        };
        if self.cli.coefficients_csv {
            write_new(csv_of(output), self.cli.force, |out| write_complex_csv(&coefficients, out))?;
        }
        if let Some(errors) = errors {
            write_new(errors_of(output), self.cli.force, |out| {
                use ndarray_npy::WriteNpyExt;
                errors.write_npy(out).map_err(std::io::Error::other)
            })?;
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

    /// The budget: as asked, or what suits the method.
    pub(crate) fn memory(&self) -> usize {
        match (&self.cli.memory, self.how) {
            (Some(size), _) => size.0,
            (None, How::Streamed(_)) => 256 << 20,
            (None, _) => available_memory() / 2,
        }
    }

    /// Bytes that the tool holds beside the solver: the program, the sphere, the targets as they were read, and a surface
    /// for each thread while it is read or written.
    pub(crate) fn held(&self, together: usize, channels: usize) -> usize {
        /// The program, its stacks and allocator, measured on a fit of a small mesh.
        const BASE: usize = 12 << 20;
        let n = self.sphere.directions.len();
        let sphere = 24 * n + 12 * self.sphere.faces.len();
        // A file as text, decoded, and as a mesh with its topology.
        let reading = 5 * sphere + 16 * n * channels;
        BASE + sphere + 8 * n * channels * together + reading * self.threads.min(together)
    }
}
