//! Outputs of a run that goes on where an earlier one was ended, which may have begun to write them.
//!
//! What such a run makes is the same to the last bit. So a file that is there and has these bytes is its own and stays.
//! Any other one is somebody else's, and isn't replaced without `--force`.

use std::path::Path;

use anyhow::{Context, Result, bail};
use serde_json::Value;
use spharm::shape::{Journal, ProcrustesParams};
use spharm::{Coefficients, Model};
use spharm_cli::inputs::MOST_OWN;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{counted, is_stdout, prepare};
use spharm_cli::printable;
use spharm_surface::io::write_new;

/// Opens the file of an alignment, and says what is there of it.
pub(super) fn journal(
    path: &Path,
    members: &[Coefficients],
    params: &ProcrustesParams,
    monitor: &ConsoleMonitor,
) -> Result<Journal> {
    prepare(path)?;
    let journal = Journal::open(path, members, params)?;
    if journal.found() > 0 {
        let found = counted(journal.found(), "alignment");
        monitor.console().note(format!("{}: goes on after {found} of an earlier run", path.display()));
    }
    Ok(journal)
}

/// How outputs are written.
#[derive(Debug, Clone, Copy)]
pub(super) struct Again {
    /// There is a state of an earlier run.
    resumed: bool,
    force: bool,
}

impl Again {
    /// Of the file that keeps the state of an earlier run, if there is one, and whether outputs are replaced.
    pub(super) fn new(state: Option<&Path>, force: bool) -> Self {
        Self { resumed: state.is_some_and(Path::exists), force }
    }

    /// Whether outputs may be there before any work.
    pub(super) fn expected(self) -> bool {
        self.force || self.resumed
    }

    /// Writes a model, unless it is there.
    pub(super) fn write(self, path: &Path, model: &Model) -> Result<()> {
        if self.resumed && !self.force && path.exists() {
            let mut bytes = Vec::new();
            model.write_to(&mut bytes).with_context(|| path.display().to_string())?;
            return same(path, &bytes);
        }
        prepare(path)?;
        Ok(model.write_with(path, self.force)?)
    }

    /// Writes JSON, unless it is there.
    pub(super) fn write_json(self, path: &Path, value: &Value) -> Result<()> {
        let text = format!("{}\n", printable::json(&serde_json::to_string_pretty(value)?));
        if self.resumed && !self.force && path.exists() {
            return same(path, text.as_bytes());
        }
        prepare(path)?;
        Ok(write_new(path, self.force, |out| out.write_all(text.as_bytes()))?)
    }

    /// Whether the report replaces the one that is there: that of the same models, which has other seconds.
    pub(super) fn replaces_report(self, path: Option<&Path>, models: &Value) -> bool {
        let Some(path) = path.filter(|path| self.resumed && !is_stdout(path)) else { return self.force };
        let there =
            spharm_files::read(path, MOST_OWN).ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
        self.force || there.is_some_and(|there| there["models"] == *models)
    }
}

/// Refuses a file that has other bytes.
fn same(path: &Path, bytes: &[u8]) -> Result<()> {
    if !spharm_files::read(path, bytes.len() as u64).is_ok_and(|found| found == bytes) {
        bail!(
            "{}: the file exists and isn't what this run makes; choose another output or give --force",
            path.display()
        );
    }
    Ok(())
}
