//! Shows a computation's progress on the console, and stops the computation at a signal.

use std::fmt;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};

use spharm_monitor::{Level, Monitor, Stage};

use crate::console::{Console, Progress};

/// Shows the stages of a computation as bars on a terminal and as lines elsewhere, and stops at SIGINT, SIGTERM or
/// SIGHUP.
#[derive(Debug)]
pub struct ConsoleMonitor {
    console: Console,
    cancel: &'static AtomicBool,
    /// Progress of the current stage.
    progress: Mutex<Option<Progress>>,
}

impl ConsoleMonitor {
    /// Creates a monitor that shows progress on `console`. From this call on, signals request a stop instead of killing
    /// the process.
    pub fn new(console: Console) -> Self {
        Self { console, cancel: crate::exit::cancel(), progress: Mutex::new(None) }
    }

    /// Returns the console, so that the caller can print other output than progress.
    pub fn console(&self) -> &Console {
        &self.console
    }

    fn progress(&self) -> MutexGuard<'_, Option<Progress>> {
        self.progress.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Monitor for ConsoleMonitor {
    fn begin(&self, stage: Stage, total: u64) {
        let mut progress = self.progress();
        // The previous bar must disappear from the screen before the next one is drawn.
        *progress = None;
        self.console.detail(stage.name);
        *progress = Some(self.console.progress(stage.name, total, stage.unit));
    }

    fn step(&self, steps: u64) {
        if let Some(progress) = &*self.progress() {
            progress.add(steps);
        }
    }

    fn end(&self) {
        *self.progress() = None;
    }

    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        let progress = self.progress();
        let print = || match level {
            Level::Detail => self.console.detail(text),
            _ => self.console.note(text),
        };
        match &*progress {
            Some(progress) if level == Level::Status => progress.say(text),
            None if level == Level::Status => {}
            Some(progress) => progress.beside(print),
            None => print(),
        }
    }

    fn cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }
}
