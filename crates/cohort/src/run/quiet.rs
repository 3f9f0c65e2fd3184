//! Hides the progress of a single group when a run has several groups.

use std::fmt;

use spharm::{Level, Monitor};

/// A monitor for one group: it hides the stages of the group, because the run counts progress in rows, and reports the
/// group's notes as details.
pub(super) struct Quiet<'a>(pub(super) &'a dyn Monitor);

impl Monitor for Quiet<'_> {
    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        self.0.note(if level == Level::Info { Level::Detail } else { level }, text);
    }

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}
