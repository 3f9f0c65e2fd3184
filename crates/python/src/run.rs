//! Runs work on a thread pool of this process, while the calling thread checks for signals and reports progress.
//!
//! Python handles signals only on its main thread, between instructions of Python code, and callbacks need the
//! interpreter. Therefore the work runs on a separate thread. The calling thread waits with the interpreter released,
//! and wakes up every [`WAKE`] to check for signals and to call back.

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

/// Interval at which the calling thread checks for signals and reports progress.
const WAKE: Duration = Duration::from_millis(20);
/// Time within which cancelled work should stop. After this time, the exception is raised without waiting any longer.
const GRACE: Duration = Duration::from_millis(100);
/// If at least this many pools exist, idle pools are dropped before another pool is created.
const KEPT: usize = 16;

pub(crate) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Returns a pool of `threads` threads; by default, as many threads as the machine can run at the same time. Pools are
/// kept for later calls. Simultaneous calls share a pool of several threads. A pool of one thread serves only one call
/// at a time, because further calls would have to wait for the first.
///
/// rayon's global pool can't be used: after a fork, the pool's threads don't exist in the child process, so work on it
/// would never end. Therefore each process creates its own pools. A child process leaks the pools of its parent,
/// because dropping a pool would wait for the pool's threads, which don't exist in the child process.
///
/// # Errors
///
/// `ValueError` for zero threads, `RuntimeError` if the system can't start the threads.
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
    // Callers get pools only under this lock, so an idle pool stays idle while the lock is held.
    let idle = |pool: &Arc<rayon::ThreadPool>| Arc::strong_count(pool) == 1;
    if let Some((.., pool)) = pools.iter().find(|(_, count, pool)| *count == threads && (threads > 1 || idle(pool))) {
        return Ok(Arc::clone(pool));
    }
    if pools.len() >= KEPT {
        pools.retain(|(.., pool)| !idle(pool));
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let pool =
        Arc::new(pool.map_err(|error| PyRuntimeError::new_err(format!("cannot start {threads} threads: {error}")))?);
    pools.push((process, threads, Arc::clone(&pool)));
    Ok(pool)
}

/// Progress of a stage: its name, the number of steps done, and the total number of steps, 0 if unknown.
#[derive(Clone, PartialEq)]
struct Progress {
    stage: &'static str,
    done: u64,
    total: u64,
}

/// A monitor that collects the progress of the work for the waiting thread.
#[derive(Default)]
struct Watch {
    cancel: AtomicBool,
    /// Stages that have begun since the last check. The last stage in the list is the current stage.
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
    /// Returns the progress that hasn't been reported: the stages that have ended, and the current stage if it has
    /// changed since `last`. Stages that have ended are removed from the list.
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

/// Runs work on a pool of `threads` threads, and calls `progress(stage, done, total)` on the calling thread. If
/// `progress` or a signal raises an exception, the work is cancelled, and the exception is raised after the work has
/// stopped.
///
/// # Errors
///
/// The error of the work as an exception, an exception raised by `progress`, or `KeyboardInterrupt`.
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
        // Sending can't fail, because the receiver exists until this scope ends.
        scope.spawn(move || drop(send.send(guarded(pool, monitor, work))));
        wait(py, progress, &watch, receive, None)
    })
}

/// Runs work as [`run`] does. Because the work owns its data, an exception is raised after [`GRACE`] even if the work
/// hasn't stopped, for example during disk access. The cancelled work then ends on its own.
///
/// # Errors
///
/// The errors of [`run`].
pub(crate) fn run_owned<T: Send + 'static>(
    py: Python<'_>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&dyn Monitor) -> Outcome<T> + Send + 'static,
) -> PyResult<T> {
    let (pool, watch) = (pool(threads)?, Arc::new(Watch::default()));
    let (send, receive) = channel();
    let monitor = Arc::clone(&watch);
    // Sending fails if the caller has stopped waiting; the result is then dropped.
    std::thread::spawn(move || drop(send.send(guarded(&pool, &monitor, work))));
    wait(py, progress, &watch, receive, Some(GRACE))
}

/// Runs the work and catches panics. A panic is a bug in the library, but must not end the interpreter's process.
fn guarded<T: Send>(
    pool: &rayon::ThreadPool,
    monitor: &Watch,
    work: impl FnOnce(&dyn Monitor) -> Outcome<T> + Send,
) -> Outcome<T> {
    catch_unwind(AssertUnwindSafe(|| pool.install(|| work(monitor)))).unwrap_or(Err(Failure::Panic))
}

/// Waits for the result of the work. The interpreter is released during the wait, and held only for signals and
/// progress. After a cancellation, the function waits at most `grace`. Without `grace`, it waits until the work has
/// stopped.
fn wait<T: Send>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    watch: &Watch,
    receive: Receiver<Outcome<T>>,
    grace: Option<Duration>,
) -> PyResult<T> {
    // The interpreter can be released only if values used meanwhile are `Sync`. A receiver isn't, so it is in a mutex.
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

/// Work on a separate thread, which sends messages to Python. The work is cancelled when this object is dropped.
pub(crate) struct Started(Arc<Watch>);

impl Started {
    /// Starts work on a pool of `threads` threads.
    ///
    /// # Errors
    ///
    /// The errors of [`pool`].
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

    /// Waits for the next message, with the interpreter released. Returns `None` when the work has ended.
    ///
    /// # Errors
    ///
    /// The exception raised by a signal, which also cancels the work.
    pub(crate) fn wait<T: Send>(&self, py: Python<'_>, receive: &Mutex<Receiver<T>>) -> PyResult<Option<T>> {
        loop {
            // Discard the collected progress, because no callback exists that could report it.
            lock(&self.0.stages).clear();
            match py.detach(|| lock(receive).recv_timeout(WAKE)) {
                Ok(message) => return Ok(Some(message)),
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
                Err(RecvTimeoutError::Timeout) => py.check_signals().inspect_err(|_| self.stop())?,
            }
        }
    }

    /// Cancels the work. The work stops as soon as possible.
    pub(crate) fn stop(&self) {
        self.0.cancel.store(true, Ordering::Relaxed);
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        self.stop();
    }
}
