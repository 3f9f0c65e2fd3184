//! Hides the progress of parts of a run.

use std::fmt;

use spharm::{Level, Monitor};

/// A monitor for a part of a run, such as a group of rows. It hides the stages of the part's work, because the run
/// counts progress in rows, and passes on the part's notes as details.
pub(crate) struct Quiet<'a>(pub(crate) &'a dyn Monitor);

impl Monitor for Quiet<'_> {
    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        self.0.note(if level == Level::Info { Level::Detail } else { level }, text);
    }

    fn cancelled(&self) -> bool {
        self.0.cancelled()
    }
}
