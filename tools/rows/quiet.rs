//! The progress of one group among many.

use std::fmt;

use spharm::{Level, Monitor};
use spharm_cli::monitor::ConsoleMonitor;

/// Within a progress that counts rows: stages aren't shown, and what is worth knowing of one group is a detail of many.
pub(super) struct Quiet<'a>(pub(super) &'a ConsoleMonitor);

impl Monitor for Quiet<'_> {
    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        self.0.note(if level == Level::Info { Level::Detail } else { level }, text);
    }

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}
