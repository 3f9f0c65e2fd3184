//! The arguments of `status`.

use std::path::PathBuf;

use spharm_cli::{Common, help};

/// Summarise the progress of a cohort over all of its processes
///
/// Reads the tables written with --status by fit and other verbs. A row that occurs in several tables is reported as
/// done if its model exists.
#[derive(Debug, clap::Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm status status/",
        "spharm status status/ --manifest subjects.tsv --failed rest.tsv",
    ],
    &[],
))]
pub(crate) struct Cli {
    /// Status files, or folders of status files
    #[arg(required = true, value_name = "FILE|DIR", help_heading = help::INPUT)]
    pub(super) files: Vec<PathBuf>,
    /// The cohort's manifest, to show which rows were never started
    #[arg(long, value_name = "TABLE.tsv", help_heading = help::INPUT)]
    pub(super) manifest: Option<PathBuf>,
    /// Write a manifest of the rows without a model
    #[arg(long, value_name = "OUT.tsv", requires = "manifest", help_heading = help::OUTPUT)]
    pub(super) failed: Option<PathBuf>,
    /// Print JSON with every failure instead of the table
    #[arg(long, help_heading = help::OUTPUT)]
    pub(super) json: bool,
    /// Replace an existing output
    #[arg(long, help_heading = help::OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) common: Common,
}
