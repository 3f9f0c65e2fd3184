//! Runs work on a thread pool of this process, while the calling thread checks for signals and reports progress.
//!
//! Python handles signals on its main thread, between its own instructions, and a callback needs the interpreter. So
//! the work runs on a thread of its own, and the calling thread wakes up every [`WAKE`], releasing the interpreter in
//! between.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use spharm::{Monitor, Stage};

use crate::errors::{Failure, exception};

/// Time between two checks for signals.
const WAKE: Duration = Duration::from_millis(20);
/// Time for work to stop before an exception is raised without waiting for it.
const GRACE: Duration = Duration::from_millis(100);

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns the pool of `threads` threads, by default as many as the machine has.
///
/// rayon's global pool would hang forever in a forked child, in which the parent's threads don't exist. So each process
/// has pools of its own, and those of the parent are leaked, since dropping one waits for its threads.
///
/// # Errors
///
/// `ValueError` for zero threads, `RuntimeError` if the system can't start them.
pub(crate) fn pool(threads: Option<usize>) -> PyResult<Arc<rayon::ThreadPool>> {
    type Pools = Vec<(u32, usize, Arc<rayon::ThreadPool>)>;
    static POOLS: Mutex<Pools> = Mutex::new(Vec::new());
    let available = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.unwrap_or_else(available);
    if threads == 0 {
        return Err(pyo3::exceptions::PyValueError::new_err("threads: expected at least 1, found 0"));
    }
    let process = std::process::id();
    let mut pools = lock(&POOLS);
    let (ours, others): (Pools, Pools) = std::mem::take(&mut *pools).into_iter().partition(|(of, ..)| *of == process);
    others.into_iter().for_each(std::mem::forget);
    *pools = ours;
    if let Some((_, _, pool)) = pools.iter().find(|(_, count, _)| *count == threads) {
        return Ok(Arc::clone(pool));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool =
        Arc::new(pool.map_err(|error| PyRuntimeError::new_err(format!("cannot start {threads} threads: {error}")))?);
    pools.push((process, threads, Arc::clone(&pool)));
    Ok(pool)
}

/// The progress of a stage: its name, the steps done, and the total number of steps, zero if unknown.
#[derive(Clone, PartialEq)]
struct Progress {
    stage: &'static str,
    done: u64,
    total: u64,
}

/// Collects the progress of the work for the waiting thread.
#[derive(Default)]
struct Watch {
    cancel: AtomicBool,
    /// Stages that have begun since the last check, the current one last.
    stages: Mutex<VecDeque<Progress>>,
}

impl Monitor for Watch {
    fn begin(&self, stage: Stage, total: u64) {
        lock(&self.stages).push_back(Progress { stage: stage.name, done: 0, total });
    }

    fn step(&self, steps: u64) {
        if let Some(stage) = lock(&self.stages).back_mut() {
            stage.done += steps;
        }
    }

    fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }
}

impl Watch {
    /// Returns the changes: finished stages, which are removed, and the state of the current one, which is kept.
    fn news(&self, last: &mut Option<Progress>) -> Vec<Progress> {
        let mut stages = lock(&self.stages);
        let mut news: Vec<Progress> = Vec::new();
        while stages.len() > 1 {
            news.extend(stages.pop_front());
        }
        news.extend(stages.front().cloned());
        news.retain(|progress| Some(progress) != last.as_ref());
        if let Some(progress) = news.last() {
            *last = Some(progress.clone());
        }
        news
    }
}

type Outcome<T> = Result<T, Failure>;

/// Runs work on a pool of `threads` threads. `progress(stage, done, total)` is called on the calling thread. An
/// exception in it, or one from a signal, stops the work and is raised once the work has stopped.
///
/// # Errors
///
/// The work's error, as an exception; the callback's exception; `KeyboardInterrupt`.
pub(crate) fn run<T: Send>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&dyn Monitor) -> Outcome<T> + Send,
) -> PyResult<T> {
    let (pool, watch) = (pool(threads)?, Watch::default());
    let (send, receive) = channel();
    std::thread::scope(|scope| {
        let (pool, monitor) = (&pool, &watch);
        // The receiver outlives this thread.
        scope.spawn(move || drop(send.send(guarded(pool, monitor, work))));
        wait(py, progress, &watch, receive, None)
    })
}

/// As [`run`], for work that owns its data: an exception is raised without waiting for work that can't be stopped
/// immediately, such as disk access. The work then ends on its own, in the same way as if it is stopped.
///
/// # Errors
///
/// Those of [`run`].
pub(crate) fn run_owned<T: Send + 'static>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&dyn Monitor) -> Outcome<T> + Send + 'static,
) -> PyResult<T> {
    let (pool, watch) = (pool(threads)?, Arc::new(Watch::default()));
    let (send, receive) = channel();
    let monitor = Arc::clone(&watch);
    // The receiver may be gone.
    std::thread::spawn(move || drop(send.send(guarded(&pool, &monitor, work))));
    wait(py, progress, &watch, receive, Some(GRACE))
}

/// Runs the work and catches panics: a panic is a bug in the library, but must not end the interpreter.
fn guarded<T: Send>(
    pool: &rayon::ThreadPool,
    monitor: &Watch,
    work: impl FnOnce(&dyn Monitor) -> Outcome<T> + Send,
) -> Outcome<T> {
    catch_unwind(AssertUnwindSafe(|| pool.install(|| work(monitor)))).unwrap_or(Err(Failure::Panic))
}

/// Waits for the work without holding the interpreter, except for signals and progress; for no longer than `grace` once
/// the work is to stop.
fn wait<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    watch: &Watch,
    receive: Receiver<Outcome<T>>,
    grace: Option<Duration>,
) -> PyResult<T> {
    // A receiver isn't `Sync`, which releasing the interpreter requires.
    let receive = Mutex::new(receive);
    let (mut stop, mut last): (Option<(PyErr, Instant)>, _) = (None, None);
    loop {
        let result = py.detach(|| match lock(&receive).recv_timeout(WAKE) {
            Ok(result) => Some(result),
            Err(RecvTimeoutError::Timeout) => None,
            Err(RecvTimeoutError::Disconnected) => Some(Err(Failure::Panic)),
        });
        let mut error = None;
        if let (None, Some(progress)) = (&stop, progress) {
            let calls = watch.news(&mut last).into_iter();
            error = calls.map(|now| progress.call1((now.stage, now.done, now.total))).find_map(Result::err);
        }
        if let (None, None, None) = (&stop, &error, &result) {
            error = py.check_signals().err();
        }
        stop = stop.or(error.map(|error| (error, Instant::now())));
        match (result, stop) {
            (Some(_), Some((error, _))) => return Err(error),
            (Some(result), None) => return result.map_err(|failure| exception(py, failure)),
            (None, Some((error, since))) if grace.is_some_and(|grace| since.elapsed() >= grace) => return Err(error),
            (None, pending) => stop = pending,
        }
        watch.cancel.store(stop.is_some(), Ordering::Relaxed);
    }
}

/// Work on a thread of its own, whose messages Python receives one by one. It is stopped when this is dropped.
pub(crate) struct Started(Arc<Watch>);

impl Started {
    /// Starts work on a pool of `threads` threads.
    ///
    /// # Errors
    ///
    /// Those of [`pool`].
    pub(crate) fn new(threads: Option<usize>, work: impl FnOnce(&dyn Monitor) + Send + 'static) -> PyResult<Self> {
        let (pool, watch) = (pool(threads)?, Arc::new(Watch::default()));
        let monitor = Arc::clone(&watch);
        let work = move |monitor: &dyn Monitor| {
            work(monitor);
            Ok(())
        };
        std::thread::spawn(move || drop(guarded(&pool, &monitor, work)));
        Ok(Self(watch))
    }

    /// Waits for a message without holding the interpreter; `None` once the work has ended.
    ///
    /// # Errors
    ///
    /// The exception from a signal, which stops the work.
    pub(crate) fn wait<T: Send>(&self, py: Python<'_>, receive: &Mutex<Receiver<T>>) -> PyResult<Option<T>> {
        loop {
            // Stages are for callbacks, and there is none here.
            lock(&self.0.stages).clear();
            match py.detach(|| lock(receive).recv_timeout(WAKE)) {
                Ok(message) => return Ok(Some(message)),
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
                Err(RecvTimeoutError::Timeout) => py.check_signals().inspect_err(|_| self.stop())?,
            }
        }
    }

    /// Stops the work as soon as possible.
    pub(crate) fn stop(&self) {
        self.0.cancel.store(true, Ordering::Relaxed);
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        self.stop();
    }
}
