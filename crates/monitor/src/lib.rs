//! Reports the progress of long computations, and lets the caller cancel them.
//!
//! Every function of this project that may take longer than a second takes a `&dyn Monitor`. The function announces a
//! stage, counts its steps, and checks between steps whether it should stop. A command-line program implements
//! `Monitor` with a progress bar, and a language binding implements it with callbacks. [`Silent`] does nothing.
//!
//! ```
//! use std::sync::atomic::{AtomicU64, Ordering};
//! use spharm_monitor::{Interrupted, Monitor, Stage};
//!
//! #[derive(Default)]
//! struct Count(AtomicU64);
//!
//! impl Monitor for Count {
//!     fn step(&self, steps: u64) {
//!         self.0.fetch_add(steps, Ordering::Relaxed);
//!     }
//! }
//!
//! fn work(monitor: &dyn Monitor) -> Result<(), Interrupted> {
//!     monitor.begin(Stage::counted("work", "pieces"), 3);
//!     for _ in 0..3 {
//!         monitor.check()?;
//!         monitor.step(1);
//!     }
//!     monitor.end();
//!     Ok(())
//! }
//!
//! let count = Count::default();
//! work(&count)?;
//! assert_eq!(count.0.into_inner(), 3);
//! # Ok::<(), Interrupted>(())
//! ```

mod number;

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};

pub use self::number::number;

/// Unit of a stage's steps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Unit {
    /// Bytes, shown as sizes.
    Bytes,
    /// Floating-point operations.
    Flops,
    /// Any other unit, named by a plural noun such as "columns".
    Count(&'static str),
}

/// A part of a computation, with its own progress.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stage {
    /// Name of the stage: one or two words in lower case, such as "fit".
    pub name: &'static str,
    /// Unit of the steps.
    pub unit: Unit,
}

impl Stage {
    /// Creates a stage whose steps are counted in `unit`, a plural noun.
    pub const fn counted(name: &'static str, unit: &'static str) -> Self {
        Self { name, unit: Unit::Count(unit) }
    }

    /// Creates a stage whose steps are bytes.
    pub const fn bytes(name: &'static str) -> Self {
        Self { name, unit: Unit::Bytes }
    }
}

/// Importance of a note that is shown to the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Level {
    /// Note on the current activity, shown next to the progress until the next status replaces it.
    Status,
    /// Note that is shown only to users who asked for detailed output.
    Detail,
    /// Note that is shown to all users.
    Info,
}

/// Receives the progress of a computation, and can cancel it. Several threads may call the methods at the same time.
///
/// Warnings about a result aren't sent to the monitor; they are part of the result.
pub trait Monitor: Sync {
    /// Ends the previous stage, and begins a stage of `total` steps. `total` is 0 if the number of steps is unknown.
    fn begin(&self, stage: Stage, total: u64) {
        let _ = (stage, total);
    }

    /// Advances the current stage by `steps` steps.
    fn step(&self, steps: u64) {
        let _ = steps;
    }

    /// Ends the current stage.
    fn end(&self) {}

    /// Receives a note for the user.
    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        let _ = (level, text);
    }

    /// Returns whether the computation should stop as soon as possible.
    fn cancelled(&self) -> bool {
        false
    }

    /// Returns an error if the computation should stop.
    ///
    /// # Errors
    ///
    /// [`Interrupted`] if [`Monitor::cancelled`] returns true.
    fn check(&self) -> Result<(), Interrupted> {
        if self.cancelled() { Err(Interrupted) } else { Ok(()) }
    }
}

/// Error returned if the monitor cancels a computation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// A monitor that shows nothing and never stops the computation.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Monitor for Silent {}

/// A monitor for work within a single step of a stage: forwards cancellation to another monitor, and hides progress
/// from it.
pub struct OnlyCancel<'a>(pub &'a dyn Monitor);

impl Monitor for OnlyCancel<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// A flag that serves as a monitor: it shows nothing, and cancels the computation once it is true.
impl Monitor for AtomicBool {
    fn cancelled(&self) -> bool {
        self.load(Ordering::Relaxed)
    }
}
