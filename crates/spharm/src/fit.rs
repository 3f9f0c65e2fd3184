//! Fits one target, or many targets that share a sphere, as many at a time as memory allows.

mod batches;
mod by_channel;
mod change;
mod check;
mod denoise;
mod detail;
mod from_moments;
mod irf;
mod job;
mod lsq;
mod lsq_plan;
mod planned;
mod quadrature;
mod range;
mod seam;
mod shared;
mod stored_factor;
mod surface;
mod surface_plan;
mod surface_sums;
mod undetermined;
mod vertex_noise;
mod zeros;

pub(crate) use check::check_sizes;
pub use check::{check_mapping, check_memory};
pub use from_moments::{MomentsFit, MomentsReport, fit_moments};
pub use planned::PlannedSphere;
pub use quadrature::Quadrature;

use std::borrow::Cow;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;

use ndarray::Array2;
use spharm_harmonics::Coefficients;
use spharm_monitor::{Monitor, Silent, Stage};
use spharm_surface::{Mesh, Signal, Sphere, SurfaceError, Target};

use crate::report::{FitReport, ManyReport};
use crate::{Error, FitParams, Method};
use batches::Run;
use job::Job;

/// The coefficients of one target, and a report on the fit.
#[derive(Debug, Clone)]
pub struct Fit {
    /// Canonical coefficients in the target's unit: one row per basis function, one column per channel.
    pub coefficients: Coefficients,
    /// Standard errors of the coefficients, if requested, in an array of the coefficients' shape.
    pub standard_errors: Option<Array2<f64>>,
    /// Distances between model and target, and warnings.
    pub report: FitReport,
}

/// Data that can be fitted over a sphere.
pub trait ToTarget {
    /// Returns the target, checked against the sphere. Values at vertices of weight 0 may be NaN or infinite, since
    /// fits don't read them.
    ///
    /// # Errors
    ///
    /// The errors of [`Target::from_mesh_with_gaps`] and [`Target::from_signal_with_gaps`].
    fn to_target(&self, sphere: &Sphere) -> Result<Cow<'_, Target>, SurfaceError>;
}

impl ToTarget for Mesh {
    fn to_target(&self, sphere: &Sphere) -> Result<Cow<'_, Target>, SurfaceError> {
        Target::from_mesh_with_gaps(self, sphere).map(Cow::Owned)
    }
}

impl ToTarget for Signal {
    fn to_target(&self, sphere: &Sphere) -> Result<Cow<'_, Target>, SurfaceError> {
        Target::from_signal_with_gaps(self.clone(), sphere).map(Cow::Owned)
    }
}

impl ToTarget for Target {
    fn to_target(&self, _: &Sphere) -> Result<Cow<'_, Target>, SurfaceError> {
        Ok(Cow::Borrowed(self))
    }
}

/// Fits a surface or a signal over a sphere with the same vertices.
///
/// ```
/// use spharm::prelude::*;
/// use spharm::generate::{Cortex, cortex};
///
/// let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
/// let sphere = Sphere::from_mesh(&sphere)?;
/// let fit = spharm::fit(&sphere, &surface, &FitParams::lsq(10))?;
/// assert_eq!(fit.coefficients.values().dim(), (121, 3));
/// assert!(fit.report.msd.is_some_and(|msd| msd < 1e-2));
/// # Ok::<(), spharm::Error>(())
/// ```
///
/// # Errors
///
/// An [`Error`] if the target doesn't match the sphere, settings are incompatible, memory doesn't suffice, or a store
/// can't be read.
pub fn fit(sphere: &Sphere, target: &impl ToTarget, params: &FitParams) -> Result<Fit, Error> {
    fit_with(sphere, target, params, &Silent)
}

/// Fits a target as [`fit()`] does, with progress and cancellation.
///
/// # Errors
///
/// The errors of [`fit()`]; [`Error::is_interrupted`] if the monitor stopped the fit.
pub fn fit_with(
    sphere: &Sphere,
    target: &impl ToTarget,
    params: &FitParams,
    monitor: &dyn Monitor,
) -> Result<Fit, Error> {
    Ok(fit_target(sphere, target.to_target(sphere)?.into_owned(), params, monitor)?.0)
}

/// Fits a target as [`fit_with`] does, without copying it. Also returns the sampling scheme, the solver's report and
/// the wall time.
///
/// # Errors
///
/// The errors of [`fit_with`].
pub fn fit_target(
    sphere: &Sphere,
    target: Target,
    params: &FitParams,
    monitor: &dyn Monitor,
) -> Result<(Fit, ManyReport), Error> {
    fit_one(sphere, None, target, params, monitor)
}

impl PlannedSphere {
    /// Fits a target over the sphere.
    ///
    /// # Errors
    ///
    /// The errors of [`fit_target`].
    pub fn fit(&self, target: Target, params: &FitParams, monitor: &dyn Monitor) -> Result<(Fit, ManyReport), Error> {
        fit_one(self.sphere(), Some(self), target, params, monitor)
    }
}

fn fit_one(
    sphere: &Sphere,
    planned: Option<&PlannedSphere>,
    target: Target,
    params: &FitParams,
    monitor: &dyn Monitor,
) -> Result<(Fit, ManyReport), Error> {
    let target = Mutex::new(Some(target));
    let taken = || target.lock().unwrap_or_else(PoisonError::into_inner).take();
    let read = |_| Ok::<_, Error>(taken().expect("the target is read only once"));
    let (mut fits, report) = fit_over((sphere, planned), 1, &read, params, &|_, fit| fit, monitor)?;
    Ok((fits.pop().expect("a target that was read without an error has a fit"), report))
}

/// Fits many targets over one sphere, as many at a time as memory allows, and passes each fit to `done` as soon as it
/// is ready.
///
/// `read` returns the target with an index in `0..count`. `read` is called in the order of the indices, but from
/// several threads, so a few targets are read at the same time. `done` receives the index of a target and its fit, also
/// from several threads. The results of `done` are returned in the targets' order. An error of `read` or `done` ends
/// the call, unlike in [`fit_each`].
///
/// # Errors
///
/// The errors of [`fit()`], `read` and `done`.
pub fn fit_many<T: Send, E: From<Error> + Send>(
    sphere: &Sphere,
    count: usize,
    read: &(dyn Fn(usize) -> Result<Target, E> + Sync),
    params: &FitParams,
    done: &(dyn Fn(usize, Fit) -> Result<T, E> + Sync),
    monitor: &dyn Monitor,
) -> Result<(Vec<T>, ManyReport), E> {
    fit_each(sphere, count, read, params, &|number, fit| done(number, fit?), monitor)
}

/// Fits many targets as [`fit_many`] does, but passes errors of single targets to `done`, which decides whether they
/// end the call. An error of a single target occurs if the target can't be read or doesn't match the sphere. With
/// [`FitParams::strict`], an error also occurs if the target's fit doesn't reach the tolerance.
///
/// Errors of single targets don't affect the other targets' coefficients.
///
/// # Errors
///
/// The errors of `done`, and those errors of [`fit()`] that concern all targets: settings, memory, the store.
pub fn fit_each<T: Send, E: From<Error> + Send>(
    sphere: &Sphere,
    count: usize,
    read: &(dyn Fn(usize) -> Result<Target, E> + Sync),
    params: &FitParams,
    done: &(dyn Fn(usize, Result<Fit, E>) -> Result<T, E> + Sync),
    monitor: &dyn Monitor,
) -> Result<(Vec<T>, ManyReport), E> {
    fit_over((sphere, None), count, read, params, done, monitor)
}

/// Fits targets like [`fit_each`], with the transforms of a planned sphere if one is given.
fn fit_over<T: Send, E: From<Error> + Send>(
    (sphere, planned): (&Sphere, Option<&PlannedSphere>),
    count: usize,
    read: &(dyn Fn(usize) -> Result<Target, E> + Sync),
    params: &FitParams,
    done: &(dyn Fn(usize, Result<Fit, E>) -> Result<T, E> + Sync),
    monitor: &dyn Monitor,
) -> Result<(Vec<T>, ManyReport), E> {
    params.check()?;
    in_pool(params.threads, || {
        let mark = Instant::now();
        let job = Job::new(sphere, planned, params, monitor)?;
        let (scheme, scalar, planning) = (job.key, job.scalar, mark.elapsed());
        let mut run = Run::new(job, count, read, done, monitor)?;
        run.seconds.plan += planning.as_secs_f64();
        match params.method {
            // No target could be read, so there is nothing to fit.
            _ if count > 0 && run.next_is_surface()?.is_none() => {}
            Method::Lsq => run_lsq(&mut run)?,
            Method::Quadrature => quadrature::run(&mut run)?,
            _ => irf::run(&mut run)?,
        }
        run.results.sort_unstable_by_key(|(number, _)| *number);
        let results = run.results.into_iter().map(|(_, result)| result).collect();
        let (batches, targets, seconds) = (run.batches, run.targets, run.seconds);
        Ok((results, ManyReport { scheme, scalar, batches, targets, seconds }))
    })
}

/// Fits all targets by the full least squares: each over its surface or at its vertices, according to the objective.
fn run_lsq<T: Send, E: From<Error> + Send>(run: &mut Run<'_, T, E>) -> Result<(), E> {
    run.monitor.begin(Stage::counted("fit", "surfaces"), run.count as u64);
    while let Some(surface) = run.next_is_surface()? {
        if surface {
            surface::run(run)?;
        } else {
            lsq::run(run)?;
        }
    }
    run.monitor.end();
    Ok(())
}

/// Runs work in a rayon pool of `threads` threads. Uses the caller's pool if it has this number of threads, or if
/// `threads` is `None`.
fn in_pool<T: Send, E: From<Error> + Send>(
    threads: Option<usize>,
    work: impl FnOnce() -> Result<T, E> + Send,
) -> Result<T, E> {
    let Some(threads) = threads else { return work() };
    if rayon::current_thread_index().is_some() && rayon::current_num_threads() == threads {
        return work();
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool = pool.map_err(|error| Error::Threads { threads, message: error.to_string() })?;
    pool.install(work)
}
