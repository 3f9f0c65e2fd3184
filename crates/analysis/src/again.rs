//! Writes the outputs of a resumed run, some of which the interrupted run may have written already.
//!
//! A resumed run produces the same bytes as an uninterrupted run. Therefore, an existing file with the same bytes is an
//! output of the interrupted run and is kept. An existing file with other bytes is replaced only with `--force`.

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

/// Opens the state file of an alignment, and prints how much of the alignment an earlier run has finished.
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
        monitor.console().note(format!("{}: resuming an earlier run that finished {found}", path.display()));
    }
    Ok(journal)
}

/// Rules for writing outputs that may already exist.
#[derive(Debug, Clone, Copy)]
pub(super) struct Again {
    /// Whether the state file of an earlier run exists.
    resumed: bool,
    force: bool,
}

impl Again {
    /// Creates the rules from `force` and from `state`, the path of the state file, which is given if `--resume` is
    /// used.
    pub(super) fn new(state: Option<&Path>, force: bool) -> Self {
        Self { resumed: state.is_some_and(Path::exists), force }
    }

    /// Returns whether outputs may exist when the run begins.
    pub(super) fn expected(self) -> bool {
        self.force || self.resumed
    }

    /// Writes a model. A resumed run keeps an existing file with the same bytes, and refuses a file with other bytes.
    pub(super) fn write(self, path: &Path, model: &Model) -> Result<()> {
        if self.resumed && !self.force && path.exists() {
            let mut bytes = Vec::new();
            model.write_to(&mut bytes).with_context(|| path.display().to_string())?;
            return same(path, &bytes);
        }
        prepare(path)?;
        Ok(model.write_with(path, self.force)?)
    }

    /// Writes JSON. A resumed run keeps an existing file with the same bytes, and refuses a file with other bytes.
    pub(super) fn write_json(self, path: &Path, value: &Value) -> Result<()> {
        let text = format!("{}\n", printable::json(&serde_json::to_string_pretty(value)?));
        if self.resumed && !self.force && path.exists() {
            return same(path, text.as_bytes());
        }
        prepare(path)?;
        Ok(write_new(path, self.force, |out| out.write_all(text.as_bytes()))?)
    }

    /// Returns whether the report may replace an existing one. A resumed run may replace a report on the same models,
    /// because the two reports differ only in the recorded times.
    pub(super) fn replaces_report(self, path: Option<&Path>, models: &Value) -> bool {
        let Some(path) = path.filter(|path| self.resumed && !is_stdout(path)) else { return self.force };
        let there =
            spharm_files::read(path, MOST_OWN).ok().and_then(|bytes| serde_json::from_slice::<Value>(&bytes).ok());
        self.force || there.is_some_and(|there| there["models"] == *models)
    }
}

/// Refuses an existing file at `path` if its contents differ from `bytes`, the result of this run.
fn same(path: &Path, bytes: &[u8]) -> Result<()> {
    if !spharm_files::read(path, bytes.len() as u64).is_ok_and(|found| found == bytes) {
        bail!(
            "{}: the file exists and differs from the result of this run; choose another output or give --force",
            path.display()
        );
    }
    Ok(())
}
