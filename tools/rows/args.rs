//! Arguments shared by the verbs that fit many surfaces.

use std::path::PathBuf;

use clap::ValueEnum;
use spharm_cohort::Shard;

#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Cohorts")]
pub(crate) struct CohortArgs {
    /// Part of the rows to process: I/N, such as 0/10, or slurm
    ///
    /// Part I/N consists of the rows whose number, counted from 0, is I modulo N. With slurm, I and N are read from
    /// the environment of a job array.
    #[arg(long, value_name = "I/N|slurm")]
    pub(crate) shard: Option<Shard>,
    /// Continue if a surface can't be fitted; list the failures at the end
    ///
    /// If a surface fails, the exit status is 1. The failures don't affect the models of other surfaces.
    #[arg(long)]
    pub(crate) keep_going: bool,
    /// Append the outcome of each row to a table
    ///
    /// The table is tab-separated and has the columns id, state (done, skipped, failed, interrupted), msd, xsd,
    /// seconds, error and output. A row's line is written when the row is finished; if a row has several lines, only
    /// the last line is used. Each shard needs its own file; `spharm status` combines the files.
    #[arg(long, value_name = "FILE.tsv")]
    pub(crate) status: Option<PathBuf>,
    /// Report the work to be done, without doing it
    ///
    /// Checks all existing models, and reads the first surfaces and spheres. If the fits need a basis store, all
    /// spheres are read, and the store and the memory are checked for each sphere. Of all other files, at most the
    /// first bytes are read, to check that the files exist and that FreeSurfer and PLY files have as many vertices as
    /// their spheres. Other errors in these files are found only by the fit itself. The exit status is 1 if any row
    /// would fail.
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Format of the lines on stderr: text, or one JSON object per line
    ///
    /// Each row has the event start, followed by done, failed, skipped or interrupted. The events note, warning,
    /// progress and error contain a text; the event end contains the counts.
    #[arg(long, value_enum, value_name = "text|json", default_value = "text", hide_possible_values = true)]
    pub(crate) log: Log,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Log {
    Text,
    Json,
}
