//! State of a call of the verb `study`.

use std::path::{Path, PathBuf};

use anyhow::Result;
use spharm_cli::console::Console;
use spharm_cohort::Manifest;

use super::args::Cli;
use super::plan::Plan;
use super::provenance::Provenance;
use super::warnings::Flagged;

/// Minimum number of subjects in a group.
pub(super) const LEAST: usize = 3;

/// Preview of the fits of a study's subjects.
pub struct Preview {
    /// The text to print.
    pub text: String,
    /// The error with which the fits would end, if any.
    pub error: Option<anyhow::Error>,
}

/// Function that previews a `fit` command on the rows of a manifest.
pub type PreviewFit = dyn Fn(&[String], Manifest) -> Result<Preview>;

/// State of a call of the verb `study`.
pub(super) struct Call<'a> {
    pub(super) cli: &'a Cli,
    pub(super) plan: &'a Plan,
    /// Record of an earlier run, with which the results are compared.
    pub(super) recorded: Option<&'a Provenance>,
    pub(super) spharm: &'a dyn Fn(&[String]) -> Result<()>,
    pub(super) console: Console,
    /// Stages that have ended.
    pub(super) rows: Vec<Done>,
    /// Subjects flagged by the quality control, the worst first.
    pub(super) flagged: Vec<Flagged>,
    /// Subjects that couldn't be fitted, with the reasons.
    pub(super) failed: Vec<(String, String)>,
    /// Warnings about the whole group.
    pub(super) warnings: Vec<String>,
    /// Comparison with the results of an earlier run, if `--again` requests it.
    pub(super) compared: Option<Compared>,
}

/// A stage that has ended.
pub(super) struct Done {
    pub(super) stage: String,
    /// Outcome: `done`, or `up to date`.
    pub(super) state: String,
    pub(super) seconds: f64,
}

/// Comparison of the results with the results of an earlier run.
pub(super) struct Compared {
    /// Number of results that were compared.
    pub(super) count: usize,
    /// Results that differ or are missing.
    pub(super) differ: Vec<PathBuf>,
}

impl Compared {
    pub(super) fn new(recorded: &Provenance, made: &Provenance) -> Self {
        let (count, differ) = recorded.compare(made);
        Self { count, differ: differ.into_iter().map(Path::to_owned).collect() }
    }
}
