//! Arguments of the verbs that fit many surfaces.

use std::path::PathBuf;

use clap::ValueEnum;
use spharm_cohort::Shard;

#[derive(Debug, Clone, clap::Args)]
#[command(next_help_heading = "Cohorts")]
pub(crate) struct CohortArgs {
    /// Part of the rows, such as 0/10, the first of ten; or slurm
    ///
    /// Part i of n has the rows whose number, from 0, is i modulo n. slurm takes both from the
    /// environment of a job array.
    #[arg(long, value_name = "I/N|slurm")]
    pub(crate) shard: Option<Shard>,
    /// Go on where a surface can't be fitted; name those at the end
    ///
    /// The exit status is 1 then. The models of the others are the same as without them.
    #[arg(long)]
    pub(crate) keep_going: bool,
    /// Append what becomes of each row to a table
    ///
    /// Tab-separated: id, state (done, skipped, failed, interrupted), msd, xsd, seconds, error, output. A row's line is
    /// written when it is finished; of several the last counts. Each shard needs a file of its own; `spharm status`
    /// adds them up.
    #[arg(long, value_name = "FILE.tsv")]
    pub(crate) status: Option<PathBuf>,
    /// Say what would be done, and do nothing
    ///
    /// Looks at all models that exist, at the first surfaces and spheres, and whether the others are there. The exit
    /// status is 1 where rows would fail.
    #[arg(long)]
    pub(crate) dry_run: bool,
    /// Lines on stderr: text, or a JSON object each
    ///
    /// An event for each row: start, done, failed, skipped, interrupted; note, warning, progress and error have a text;
    /// end has the counts.
    #[arg(long, value_enum, value_name = "text|json", default_value = "text", hide_possible_values = true)]
    pub(crate) log: Log,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(crate) enum Log {
    Text,
    Json,
}
