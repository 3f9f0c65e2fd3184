//! The arguments of `study`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use spharm_cli::Common;
use spharm_cli::help::{self, METHOD, OUTPUT, RESOURCES};
use spharm_cli::memory::Memory;
use spharm_cli::threads::Threads;
use spharm_cohort::Shard;

/// Run a study: fit surfaces, bring subjects into correspondence, average, test, and write a page
///
/// STUDY.toml sets the subjects, the degree and the tests; `spharm study init` writes a template with comments. Each
/// stage is a spharm command, which is printed before it runs. A stage runs again only if its inputs or settings have
/// changed since the last run. Therefore, the same command resumes an interrupted study and, after a change, reruns
/// only the stages that depend on the change.
#[derive(Debug, Args)]
#[command(
    args_conflicts_with_subcommands = true,
    after_long_help = help::examples(
        &[
            "spharm study init --table subjects.tsv",
            "spharm study study.toml --dry-run",
            "spharm study study.toml",
            "spharm study --again study/provenance.json",
            "spharm study study.toml --shard 3/10    # only fits a tenth of the subjects",
        ],
        &["A subject that can't be fitted is left out and listed at the end and on the page; the exit status is then 1."],
    ),
)]
pub struct Cli {
    #[command(subcommand)]
    pub(super) command: Option<Command>,
    /// Study file
    #[arg(value_name = "STUDY.toml", required_unless_present = "again")]
    pub(super) study: Option<PathBuf>,
    /// Run the study recorded in a provenance.json again, and compare the results
    ///
    /// The table and all inputs must still have the recorded contents. The recorded number of threads and memory are
    /// used, unless other values are given. The exit status is 1 if a result differs from the recorded one.
    #[arg(long, value_name = "provenance.json", conflicts_with_all = ["study", "shard"], help_heading = METHOD)]
    pub(super) again: Option<PathBuf>,
    /// Folder for all outputs [default: `output` of the study file; with --again, the recorded `output` with -again
    /// appended]
    #[arg(short, long, value_name = "DIR", help_heading = OUTPUT)]
    pub(super) output: Option<PathBuf>,
    /// Fit only part I of N parts of the subjects (I from 0, or slurm to take I/N from the job array)
    #[arg(long, value_name = "I/N|slurm", help_heading = METHOD)]
    pub(super) shard: Option<Shard>,
    /// Print the commands without running them
    #[arg(long, help_heading = OUTPUT)]
    pub(super) dry_run: bool,
    /// Stop before the tests if the quality control flags a subject that isn't accepted
    ///
    /// If the study stops, no page is written, and the tests, the figures and the page of an earlier run are removed.
    #[arg(long, help_heading = METHOD)]
    pub(super) strict: bool,
    /// Print a report as JSON in place of the tables
    #[arg(long, conflicts_with = "dry_run", help_heading = OUTPUT)]
    pub(super) json: bool,
    /// Run all stages again; also replace files in the output folder that no earlier run has written
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) resources: Resources,
    #[command(flatten)]
    pub(super) common: Common,
}

#[derive(Debug, Args)]
#[command(next_help_heading = RESOURCES)]
pub(super) struct Resources {
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) threads: Threads,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Write a commented study file to fill in
    Init {
        /// File to write
        #[arg(default_value = "study.toml")]
        file: PathBuf,
        /// Table of the subjects, relative to the study file
        #[arg(long, value_name = "TABLE")]
        table: Option<String>,
        /// Replace a file that exists
        #[arg(long)]
        force: bool,
    },
}
