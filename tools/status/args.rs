//! The arguments of `status`.

use std::path::PathBuf;

use spharm_cli::{Common, help};

/// Add up what the processes of a cohort have done
///
/// Reads the tables that fit --status and others wrote. A row that several of them have counts as done where its model
/// is there.
#[derive(Debug, clap::Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm status status/",
        "spharm status status/ --manifest subjects.tsv --failed rest.tsv",
    ],
    &[],
))]
pub(crate) struct Cli {
    /// Status files, or folders of them
    #[arg(required = true, value_name = "FILE|DIR", help_heading = help::INPUT)]
    pub(super) files: Vec<PathBuf>,
    /// The cohort's manifest: tells which rows were never begun
    #[arg(long, value_name = "TABLE.tsv", help_heading = help::INPUT)]
    pub(super) manifest: Option<PathBuf>,
    /// Write a manifest of the rows without a model
    #[arg(long, value_name = "OUT.tsv", requires = "manifest", help_heading = help::OUTPUT)]
    pub(super) failed: Option<PathBuf>,
    /// Print JSON in place of the table, with every failure
    #[arg(long, help_heading = help::OUTPUT)]
    pub(super) json: bool,
    /// Replace an output that exists
    #[arg(long, help_heading = help::OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) common: Common,
}
