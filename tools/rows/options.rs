//! Settings of a verb that apply to all of its rows.

use std::path::PathBuf;

use serde_json::{Map, Value};
use spharm_cli::threads::Threads;
use spharm_cohort::rerun::IfExists;
use spharm_cohort::run::RunParams;

use super::args::CohortArgs;

/// Settings of a verb that apply to all of its rows.
pub(crate) struct Options {
    /// Settings of the run.
    pub(crate) run: RunParams,
    /// Whether the run is only previewed.
    pub(crate) dry_run: bool,
    /// Path of the report's file.
    pub(crate) report: Option<PathBuf>,
    /// Whether the report is printed instead of the table.
    pub(crate) json: bool,
    pub(crate) threads: Threads,
    /// Fields of the report that describe the call.
    pub(crate) about: Map<String, Value>,
    /// Whether a later step aligns models that don't correspond.
    pub(crate) aligned_later: bool,
}

impl Options {
    /// Creates the options of a run that prints its table and writes no report.
    pub(crate) fn new(run: RunParams, threads: Threads) -> Self {
        let (report, about) = (None, Map::new());
        Self { run, dry_run: false, report, json: false, threads, about, aligned_later: false }
    }

    /// Applies the arguments that all verbs with rows share, such as `--shard` and `--dry-run`.
    pub(crate) fn with(mut self, cohort: &CohortArgs) -> Self {
        (self.run.keep_going, self.run.status) = (cohort.keep_going, cohort.status.clone());
        Self { dry_run: cohort.dry_run, ..self }
    }

    /// Returns whether an existing report is replaced. A call that resumes an earlier call replaces that call's report.
    pub(crate) fn replaces_report(&self) -> bool {
        self.run.if_exists != IfExists::Refuse
    }
}

/// Returns the treatment of existing outputs, from the flags `--force`, `--update` and `--skip-existing`.
pub(crate) fn if_exists(force: bool, update: bool, skip_existing: bool) -> IfExists {
    match (force, update, skip_existing) {
        (true, ..) => IfExists::Replace,
        (_, true, _) => IfExists::Update,
        (.., true) => IfExists::Skip,
        _ => IfExists::Refuse,
    }
}
