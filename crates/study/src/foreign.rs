//! Refuses an output folder that contains files which the study would replace, but which no earlier run has written.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::{Result, bail};
use spharm_cli::output::first_of;
use spharm_cli::paths::shown;

use super::plan::Plan;
use super::stage::Stage;
use super::{methods, provenance};

/// Maximum number of files and folders that the message names.
const NAMED: usize = 12;

/// Checks that the outputs of the stages don't exist before the first run of a study.
///
/// # Errors
///
/// If an output exists and the output folder has no records of an earlier run. The error names the existing outputs.
pub(super) fn check(plan: &Plan, stages: &[Stage]) -> Result<()> {
    // If records exist, an earlier run made the outputs. This includes outputs without a record, because the run may
    // have ended before it could record them.
    if plan.records().is_dir() {
        return Ok(());
    }
    let own = [methods::FILE, provenance::FILE].map(|name| plan.output.join(name));
    let outputs = stages.iter().flat_map(|stage| &stage.outputs).chain(&own);
    let name = |path: &Path| shown(path.strip_prefix(&plan.output).unwrap_or(path));
    let found: BTreeSet<String> = outputs.filter(|path| is_used(path)).map(|path| name(path)).collect();
    if found.is_empty() {
        return Ok(());
    }
    bail!(
        "{}: expected a folder without files that the study would replace, found {} but no records of an earlier run; \
         choose another `output` in {} or another --output, or give --force to replace these files",
        plan.output.display(),
        first_of(found.iter().map(String::as_str), NAMED),
        plan.file.display()
    )
}

/// Returns whether a path is a file, or a folder that isn't empty.
fn is_used(path: &Path) -> bool {
    match std::fs::read_dir(path) {
        Ok(mut entries) => entries.next().is_some(),
        Err(_) => path.exists(),
    }
}
