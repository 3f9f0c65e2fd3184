//! Progress and cancellation of long computations.
//!
//! Every function of this project that may take longer than a second takes a `&dyn Monitor`. It announces a stage,
//! counts its steps, and asks between steps whether it is to stop. Programs show a bar, a binding calls back, and
//! [`Silent`] does nothing.
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

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};

/// What one step of a stage is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Unit {
    /// Bytes, shown as sizes.
    Bytes,
    /// Floating-point operations.
    Flops,
    /// Something else, named in the plural: "columns".
    Count(&'static str),
}

/// A part of a computation whose progress is shown on its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stage {
    /// A word or two, in lower case: "fit".
    pub name: &'static str,
    /// What its steps are.
    pub unit: Unit,
}

impl Stage {
    /// A stage whose steps are things that can be counted.
    pub const fn counted(name: &'static str, unit: &'static str) -> Self {
        Self { name, unit: Unit::Count(unit) }
    }

    /// A stage whose steps are bytes.
    pub const fn bytes(name: &'static str) -> Self {
        Self { name, unit: Unit::Bytes }
    }
}

/// How much a note matters.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Level {
    /// What is being done at the moment, shown beside the progress and replaced by the next one.
    Status,
    /// For those who asked for more.
    Detail,
    /// Worth knowing.
    Info,
}

/// Receives the progress of a computation and may stop it. Called from several threads.
///
/// Warnings about a result are not sent here: they are part of the result.
pub trait Monitor: Sync {
    /// A stage of `total` steps begins; zero when their number is not known. A stage that was under way ends.
    fn begin(&self, stage: Stage, total: u64) {
        let _ = (stage, total);
    }

    /// `steps` more steps of the stage are done.
    fn step(&self, steps: u64) {
        let _ = steps;
    }

    /// The stage is over.
    fn end(&self) {}

    /// Text for a person.
    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        let _ = (level, text);
    }

    /// Whether the computation is to stop as soon as it can.
    fn cancelled(&self) -> bool {
        false
    }

    /// `Err` when the computation is to stop.
    ///
    /// # Errors
    ///
    /// [`Interrupted`] when [`Monitor::cancelled`].
    fn check(&self) -> Result<(), Interrupted> {
        if self.cancelled() { Err(Interrupted) } else { Ok(()) }
    }
}

/// The computation was asked to stop, and did.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("interrupted")]
pub struct Interrupted;

/// Shows nothing and never stops.
#[derive(Debug, Clone, Copy, Default)]
pub struct Silent;

impl Monitor for Silent {}

/// For work within a step of a stage: passes on the wish to stop, and shows nothing.
pub struct OnlyCancel<'a>(pub &'a dyn Monitor);

impl Monitor for OnlyCancel<'_> {
    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}

/// Stops the computation once the flag is set, and shows nothing.
impl Monitor for AtomicBool {
    fn cancelled(&self) -> bool {
        self.load(Ordering::Relaxed)
    }
}
