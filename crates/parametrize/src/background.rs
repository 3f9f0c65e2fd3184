//! Runs long, uninterruptible calls to other libraries on a separate thread, so that the caller can still be cancelled.
//!
//! A sparse factorisation for a mesh of 160,000 vertices takes about a second and can't be cancelled. Such a call runs
//! on its own thread while the caller checks the monitor. On cancellation the caller returns at once; the thread runs
//! until the call ends, and its result is discarded.

use std::sync::mpsc::{RecvTimeoutError, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use spharm_monitor::{Interrupted, Monitor};

/// Interval at which the waiting caller checks the monitor for cancellation.
const INTERVAL: Duration = Duration::from_millis(50);

/// Runs `work`, on a separate thread if `long` is true. If the monitor asks to stop, returns at once and leaves the
/// thread running.
pub(crate) fn abandonable<T: Send + 'static>(
    long: bool,
    monitor: &dyn Monitor,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Interrupted> {
    monitor.check()?;
    if !long {
        return Ok(work());
    }
    let (done, result) = sync_channel(1);
    // If no thread can be started, `work` runs on the current thread.
    let work = Arc::new(Mutex::new(Some(work)));
    let take = |work: &Mutex<Option<_>>| work.lock().unwrap_or_else(PoisonError::into_inner).take();
    let theirs = Arc::clone(&work);
    let run = move || {
        if let Some(work) = take(&theirs) {
            // After an interruption the receiver no longer exists, so an error of `send` is ignored.
            let _ = done.send(work());
        }
    };
    let Ok(worker) = std::thread::Builder::new().name("factorisation".to_owned()).spawn(run) else {
        let work = take(&work);
        // The thread wasn't started, so `work` is still available.
        return work.map_or(Err(Interrupted), |work| Ok(work()));
    };
    loop {
        match result.recv_timeout(INTERVAL) {
            Ok(result) => return Ok(result),
            Err(RecvTimeoutError::Timeout) => monitor.check()?,
            Err(RecvTimeoutError::Disconnected) => match worker.join() {
                Err(panic) => std::panic::resume_unwind(panic),
                Ok(()) => return Err(Interrupted),
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;
    use std::sync::atomic::AtomicBool;
    use std::time::Instant;

    #[test]
    fn results_come_back_and_long_work_is_left_behind() {
        assert_eq!(abandonable(false, &Silent, || 1), Ok(1));
        assert_eq!(abandonable(true, &Silent, || 2), Ok(2));
        let stop = Arc::new(AtomicBool::new(false));
        let theirs = Arc::clone(&stop);
        let started = Instant::now();
        let found = abandonable(true, &*stop, move || {
            theirs.store(true, std::sync::atomic::Ordering::Relaxed);
            std::thread::sleep(Duration::from_secs(20));
        });
        assert_eq!(found, Err(Interrupted));
        assert!(started.elapsed() < Duration::from_secs(5));
    }

    #[test]
    #[should_panic(expected = "in the work")]
    fn panics_reach_the_caller() {
        let _ = abandonable(true, &Silent, || panic!("in the work"));
    }
}
