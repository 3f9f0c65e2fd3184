//! The progress of one group among many.

use std::fmt;

use spharm::{Level, Monitor};

/// Hides the stages of a group, since progress is counted in rows, and demotes its notes to details.
pub(super) struct Quiet<'a>(pub(super) &'a dyn Monitor);

impl Monitor for Quiet<'_> {
    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        self.0.note(if level == Level::Info { Level::Detail } else { level }, text);
    }

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}
