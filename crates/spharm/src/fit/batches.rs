//! Reads targets a few at a time, fits them in batches, assesses the fits and passes them to the caller.

use std::collections::VecDeque;
use std::ops::Range;
use std::time::Instant;

use ndarray::{Array2, ArrayView2, s};
use rayon::prelude::*;
use spharm_harmonics::Coefficients;
use spharm_monitor::Monitor;
use spharm_solver::ResidualNorms;
use spharm_surface::range::times;
use spharm_surface::{Kind, Sphere, SurfaceError, Target};

use super::change::Change;
use super::denoise::parts;
use super::job::Job;
use super::range::{distances_of_mixed, restore, restore_batch};
use crate::assess::{Distances, HoldOut, ModelSurface, ReadSurface, SurfaceDistances, scale_of};
use crate::report::{BatchReport, Denoised, FitReport, Seconds, Settings};
use crate::{Error, Fit, FitWarning, Objective};

type Read<'a, E> = &'a (dyn Fn(usize) -> Result<Target, E> + Sync);
type Done<'a, T, E> = &'a (dyn Fn(usize, Result<Fit, E>) -> Result<T, E> + Sync);

/// State of a running call: targets that were read ahead, and the results obtained so far.
pub(crate) struct Run<'a, T, E> {
    pub(crate) job: Job<'a>,
    pub(crate) monitor: &'a dyn Monitor,
    pub(crate) count: usize,
    /// Index of each finished target, and the result that `done` returned for it.
    pub(crate) results: Vec<(usize, T)>,
    pub(crate) batches: Vec<BatchReport>,
    /// Indices of the targets of each batch, in the order of `batches`.
    pub(crate) targets: Vec<Vec<usize>>,
    pub(crate) seconds: Seconds,
    /// Number of targets read at the same time. The method's memory plan sets it; it is 1 before a plan exists.
    pub(crate) readers: usize,
    read: Read<'a, E>,
    done: Done<'a, T, E>,
    /// Index of the next target to read.
    next: usize,
    /// Targets that were read but aren't in a batch yet.
    ready: VecDeque<Ready>,
}

/// A target that was read and prepared for the fit: its index, the prepared target, and the changes made to it.
type Ready = (usize, Target, Change);

/// A target's index and the result of reading it.
type Found<E> = (usize, Result<(Target, Change), E>);

/// Targets that are fitted together, and the range of each target's columns.
pub(crate) struct Batch {
    numbers: Vec<usize>,
    targets: Vec<Target>,
    /// Changes made to each target.
    pub(crate) changes: Vec<Change>,
    pub(crate) groups: Vec<Range<usize>>,
}

/// The result of fitting a batch by one of the methods.
pub(crate) struct Solved {
    /// Canonical coefficients of the batch (basis functions x columns).
    pub(crate) coefficients: Array2<f64>,
    /// For each sweep: whether it was a refinement, and the norms of each target's residual after the sweep.
    pub(crate) sweeps: Vec<(bool, Vec<ResidualNorms>)>,
    /// Standard errors of the coefficients (basis functions x columns), if requested.
    pub(crate) standard_errors: Option<Array2<f64>>,
    /// For each target, the noise removed from it or from each of its channels. Empty without denoising.
    pub(crate) denoised: Vec<Vec<Denoised>>,
    /// Distances of each target's surface from its model, if they were measured.
    pub(crate) surface_distances: Vec<Option<SurfaceDistances>>,
    /// Warnings that apply to all targets of the batch.
    pub(crate) warnings: Vec<FitWarning>,
    /// Solution of each target. Empty for quadrature.
    pub(crate) per_target: Vec<PerTarget>,
    /// Values (p x channels) of each target's model at the centres of p triangles; empty if the method has none.
    pub(crate) at_centres: Vec<Array2<f64>>,
    pub(crate) report: BatchReport,
}

/// The solution of one target in a batch.
pub(crate) struct PerTarget {
    pub(crate) optimality: Option<f64>,
    pub(crate) warnings: Vec<FitWarning>,
}

impl Batch {
    fn new(taken: Vec<Ready>) -> Self {
        let mut end = 0;
        let groups = taken.iter().map(|(_, target, _)| {
            end += target.channels;
            end - target.channels..end
        });
        let groups = groups.collect();
        let mut batch = Self { numbers: Vec::new(), targets: Vec::new(), changes: Vec::new(), groups };
        for (number, target, change) in taken {
            batch.numbers.push(number);
            batch.targets.push(target);
            batch.changes.push(change);
        }
        batch
    }

    /// Returns the total number of columns of all targets.
    pub(crate) fn columns(&self) -> usize {
        self.groups.last().map_or(0, |group| group.end)
    }

    /// Iterates over the targets. Yields each target's columns in the batch and its values (vertices x channels).
    pub(crate) fn targets(&self) -> impl Iterator<Item = (Range<usize>, ArrayView2<'_, f64>)> {
        self.groups.iter().cloned().zip(self.targets.iter().map(values))
    }

    /// Returns each target's ranges of columns for noise estimates: one for a surface, one per channel for a signal.
    pub(crate) fn parts(&self) -> impl Iterator<Item = Vec<Range<usize>>> {
        self.groups.iter().zip(&self.targets).map(|(group, target)| parts(group, target.kind))
    }

    /// Measures the distances between surfaces and their models, one after another, since each measurement uses all
    /// threads. `coefficients` has one column per column of the batch.
    pub(crate) fn surface_distances(
        &self,
        model_surface: &ModelSurface,
        coefficients: ArrayView2<'_, f64>,
        surface: &ReadSurface,
        monitor: &dyn Monitor,
    ) -> Result<Vec<Option<SurfaceDistances>>, Error> {
        let of = |(group, target): (&Range<usize>, &Target)| {
            let coefficients = coefficients.slice(s![.., group.clone()]);
            model_surface.assess(coefficients, values(target), surface, scale_of(target), monitor)
        };
        self.groups.iter().zip(&self.targets).map(of).collect()
    }

    /// Returns the columns of all targets side by side, as an array with one row per vertex.
    pub(crate) fn side_by_side(&self) -> Array2<f64> {
        let rows = self.targets.first().map_or(0, |target| target.values.len() / target.channels.max(1));
        let mut all = Array2::zeros((rows, self.columns()));
        for (group, target) in self.targets() {
            all.slice_mut(s![.., group]).assign(&target);
        }
        all
    }
}

/// Replaces the values at unread vertices by the values at the first vertex that is read, so that unread values don't
/// affect units and sizes. Returns an error if a value at another vertex isn't finite.
fn hide(target: &mut Target, unread: Option<&[bool]>) -> Result<(), Error> {
    target.check_finite(unread)?;
    let Some(unread) = unread else { return Ok(()) };
    let channels = target.channels;
    let Some(first) = unread.iter().position(|unread| !unread) else { return Ok(()) };
    let filler = target.values[first * channels..(first + 1) * channels].to_vec();
    let rows = target.values.chunks_exact_mut(channels).zip(unread);
    rows.filter(|(_, unread)| **unread).for_each(|(row, _)| row.copy_from_slice(&filler));
    Ok(())
}

/// Returns an error if a target's number of rows differs from the number of the sphere's directions.
fn check(target: &Target, sphere: &Sphere) -> Result<(), Error> {
    let (expected, found) = (sphere.directions.len(), target.values.len() / target.channels.max(1));
    if target.channels > 0 && target.values.len() == expected * target.channels {
        return Ok(());
    }
    let path = target.path.clone().unwrap_or_else(|| "the target".into());
    Err(SurfaceError::VertexCount { path, sphere: sphere.path.clone(), expected, found }.into())
}

/// Returns a target's values as an array with one row per vertex and one column per channel.
fn values(target: &Target) -> ArrayView2<'_, f64> {
    let shape = (target.values.len() / target.channels.max(1), target.channels);
    ArrayView2::from_shape(shape, &target.values[..])
        .expect("`check` verified that a target has a value per vertex and channel")
}

impl<'a, T: Send, E: From<Error> + Send> Run<'a, T, E> {
    /// Creates the state of a call, and reads targets until one of them is valid.
    pub(crate) fn new(
        job: Job<'a>,
        count: usize,
        read: Read<'a, E>,
        done: Done<'a, T, E>,
        monitor: &'a dyn Monitor,
    ) -> Result<Self, E> {
        let (batches, seconds, ready) = (Vec::new(), Seconds::default(), VecDeque::new());
        let (results, targets) = (Vec::new(), Vec::new());
        let readers = 1;
        let mut run =
            Self { job, monitor, count, results, batches, targets, seconds, readers, read, done, next: 0, ready };
        let mark = Instant::now();
        run.fill()?;
        run.seconds.read += mark.elapsed().as_secs_f64();
        Ok(run)
    }

    /// Returns the number of channels of the next target. In most studies all targets have the same number.
    pub(crate) fn channels(&self) -> usize {
        self.ready.front().map_or(1, |(_, target, _)| target.channels)
    }

    /// Returns whether the next target is fitted as a surface; `None` if no target is left.
    pub(crate) fn next_is_surface(&mut self) -> Result<Option<bool>, E> {
        if self.ready.is_empty() {
            self.fill()?;
        }
        Ok(self.ready.front().map(|(_, target, _)| self.job.fits_surface(target.kind)))
    }

    /// Fits batches of at most `columns` columns, and passes the fits on. A target with more columns is fitted alone.
    /// Stops when all targets are finished, or when the next target has another objective: a surface after fits of
    /// vertices, or vice versa.
    pub(crate) fn each_batch(
        &mut self,
        columns: usize,
        mut solve: impl FnMut(&Job<'a>, &Batch) -> Result<Solved, Error>,
    ) -> Result<(), E> {
        let surface = self.next_is_surface()?;
        while surface.is_some() && surface == self.next_is_surface()? {
            self.monitor.check().map_err(Error::from)?;
            let mark = Instant::now();
            let batch = self.next_batch(columns)?;
            self.seconds.read += mark.elapsed().as_secs_f64();
            self.solve(batch, &mut solve)?;
        }
        Ok(())
    }

    /// Fits a batch and passes its fits to the caller. If the batch misses the tolerance, each target is fitted
    /// separately, to find the targets that reach it.
    fn solve(
        &mut self,
        batch: Batch,
        solve: &mut impl FnMut(&Job<'a>, &Batch) -> Result<Solved, Error>,
    ) -> Result<(), E> {
        let mark = Instant::now();
        let solved = solve(&self.job, &batch);
        self.seconds.solve += mark.elapsed().as_secs_f64();
        let mark = Instant::now();
        match (solved, &batch.numbers[..]) {
            (Ok(mut solved), _) => {
                self.results.extend(self.hand_over(&batch, &solved)?);
                let exponents = batch.changes.iter().map(|change| &change.exponents);
                restore_batch(&mut solved.report, exponents, self.job.weight_exponent);
                self.batches.push(solved.report);
                self.targets.push(batch.numbers);
            }
            (Err(error @ Error::NotConverged(_)), &[number]) => {
                self.results.push((number, (self.done)(number, Err(error.into()))?));
            }
            (Err(Error::NotConverged(_)), _) => {
                for ((number, target), change) in batch.numbers.into_iter().zip(batch.targets).zip(batch.changes) {
                    self.solve(Batch::new(vec![(number, target, change)]), solve)?;
                }
                return Ok(());
            }
            (Err(error), _) => return Err(error.into()),
        }
        self.seconds.write += mark.elapsed().as_secs_f64();
        Ok(())
    }

    /// Reads the next few targets. If none of them is valid, reads further targets until one is.
    fn fill(&mut self) -> Result<(), E> {
        let (read, job) = (self.read, &self.job);
        let (sphere, unread) = (job.sphere, job.unread.as_deref());
        let one = |number: usize| -> Found<E> {
            let checked = |mut target: Target| -> Result<(Target, Change), E> {
                check(&target, sphere)?;
                hide(&mut target, unread)?;
                let change = Change::of(&mut target, job);
                Ok((target, change))
            };
            (number, read(number).and_then(checked))
        };
        while self.ready.is_empty() && self.next < self.count {
            self.monitor.check().map_err(Error::from)?;
            let end = self.count.min(self.next + self.readers);
            let found: Vec<Found<E>> = (self.next..end).into_par_iter().map(one).collect();
            self.next = end;
            for (number, target) in found {
                match target {
                    Ok((target, change)) => self.ready.push_back((number, target, change)),
                    Err(error) => self.results.push((number, (self.done)(number, Err(error))?)),
                }
            }
        }
        Ok(())
    }

    /// Takes as many targets as possible with at most `columns` columns in total, but at least one target. All targets
    /// taken have the same scaling exponents, and either all or none are fitted as surfaces.
    fn next_batch(&mut self, columns: usize) -> Result<Batch, E> {
        let (mut taken, mut width): (Vec<Ready>, usize) = (Vec::new(), 0);
        let surface = self.next_is_surface()?;
        while self.next_is_surface()? == surface {
            let Some((_, target, change)) = self.ready.front() else { break };
            if let Some((_, _, others)) = taken.last()
                && (width + target.channels > columns || change.exponents != others.exponents)
            {
                break;
            }
            width += target.channels;
            taken.extend(self.ready.pop_front());
        }
        Ok(Batch::new(taken))
    }

    fn hand_over(&self, batch: &Batch, solved: &Solved) -> Result<Vec<(usize, T)>, E> {
        let (job, done) = (&self.job, self.done);
        let one = |index: usize| -> Result<(usize, T), E> {
            let number = batch.numbers[index];
            Ok((number, done(number, fit_of(job, batch, solved, index).map_err(E::from))?))
        };
        (0..batch.targets.len()).into_par_iter().map(one).collect()
    }
}

/// Returns the assessed fit of one target in a batch.
fn fit_of(job: &Job<'_>, batch: &Batch, solved: &Solved, index: usize) -> Result<Fit, Error> {
    let (target, group, change) = (&batch.targets[index], batch.groups[index].clone(), &batch.changes[index]);
    let scale = scale_of(target);
    let mut passes: Vec<Distances> = solved
        .sweeps
        .iter()
        .map(|(refinement, residuals)| {
            Distances::new(residuals[index].mean_square, residuals[index].max_square, *refinement, scale)
        })
        .collect();
    let mut coefficients: Array2<f64> = solved.coefficients.slice(s![.., group.clone()]).to_owned();
    let (directions, unread) = (&job.sphere.directions, job.unread.as_deref());
    let mixed = distances_of_mixed(directions, unread, &change.exponents, values(target), coefficients.view())?;
    passes = mixed.map_or(passes, |distances| vec![distances]);
    let mut warnings = solved.warnings.clone();
    warnings.extend(change.warning.clone());
    let per_target = solved.per_target.get(index);
    warnings.extend(per_target.iter().flat_map(|of_target| of_target.warnings.iter().cloned()));
    warnings.extend(job.uneven_weights.clone().filter(|_| !job.fits_surface(target.kind)));
    let denoise = solved.denoised.get(index).cloned().unwrap_or_default();
    let detail = |of: &Denoised| {
        let sigma = times(of.noise.sigma, job.weight_exponent / 2);
        let noise = (of.relative_noise, &of.noise.gain[..]);
        FitWarning::of_denoised(noise, of.left_out, sigma, job.params.max_degree)
    };
    warnings.extend(denoise.iter().find_map(detail));
    let assess = |held: &HoldOut| held.assess(directions, coefficients.view(), values(target), unread, scale);
    let held_out = job.hold_out.as_ref().map(assess).transpose()?;
    let mut between = None;
    if let (Some(places), Some(at), Kind::Surface) = (&job.off_vertex, passes.last(), target.kind) {
        let model = match solved.at_centres.get(index) {
            Some(model) => model,
            None => &places.evaluate(coefficients.view())?,
        };
        let (distances, oscillation) = places.assess(model.view(), values(target), at, scale);
        warnings.extend(oscillation.map(|ratio| FitWarning::Oscillation { ratio }));
        between = Some(distances);
    }
    let last = passes.last().copied();
    let report = FitReport {
        channels: target.channels,
        scale,
        msd: last.and_then(|last| last.msd),
        xsd: last.and_then(|last| last.xsd),
        off_vertex: between.and_then(|between| between.msd),
        passes,
        between,
        surface_distance: solved.surface_distances.get(index).copied().flatten(),
        held_out,
        denoise,
        smoothness: solved.report.smoothness(),
        smoothness_by_channel: solved.report.smoothness_by_channel().to_vec(),
        optimality: per_target.and_then(|of_target| of_target.optimality).or(solved.report.optimality()),
        warnings,
        settings: Settings {
            method: job.params.method,
            objective: if job.fits_surface(target.kind) { Objective::Surface } else { Objective::Vertices },
            area: job.params.area,
            penalty: job.params.penalty_name(),
            weights: job.params.weights.name().to_owned(),
            weights_hash: job.params.weights.hash(),
            hold_out: job.params.hold_out,
            tolerance: job.params.tolerance,
            max_iterations: job.params.max_iterations,
            preconditioner: job.params.preconditioner,
            scheme: job.key,
            scalar: job.scalar,
            kind: target.kind,
            meta: target.meta.clone(),
        },
    };
    let standard_errors = solved.standard_errors.as_ref().map(|errors| errors.slice(s![.., group]).to_owned());
    change.add_middles(&mut coefficients);
    let mut fit = Fit { coefficients: Coefficients::new(coefficients)?, standard_errors, report };
    restore(&mut fit, &change.exponents, job.weight_exponent);
    match fit.coefficients.values().indexed_iter().find(|(_, value)| !value.is_finite()) {
        Some(((row, channel), &found)) => Err(Error::NotFinite { row, channel, found }),
        None => Ok(fit),
    }
}
