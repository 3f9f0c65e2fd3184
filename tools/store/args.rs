//! Arguments of `store`.

use std::path::PathBuf;

use clap::{Args, Subcommand};
use spharm_cli::Common;
use spharm_cli::help::{self, OUTPUT};
use spharm_cli::threads::Threads;

/// List, verify and clean up basis stores
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &["spharm store list basis", "spharm store show basis 3f2a --json", "spharm store verify basis", "spharm store gc basis -n"],
    &[],
))]
pub(crate) struct Cli {
    #[command(subcommand)]
    pub(super) command: Command,
    #[command(flatten)]
    pub(super) common: Common,
}

#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// List the sampling schemes of a store, one per line
    List {
        /// Folder of the store
        #[arg(env = "SPHARM_STORE")]
        dir: PathBuf,
        /// Print JSON in place of the table
        #[arg(long, help_heading = OUTPUT)]
        json: bool,
    },
    /// List the files of one or all sampling schemes: one line per degree of the basis, then one line per stored
    /// Cholesky factor
    Show {
        #[command(flatten)]
        which: Which,
        /// Print JSON in place of the table
        #[arg(long, help_heading = OUTPUT)]
        json: bool,
    },
    /// Check all files against their hashes; the exit status is 1 if a file is damaged
    Verify {
        #[command(flatten)]
        which: Which,
        #[command(flatten)]
        threads: Threads,
    },
    /// Remove the unfinished files that interrupted builds left behind
    Gc {
        /// Folder of the store
        #[arg(env = "SPHARM_STORE")]
        dir: PathBuf,
        /// Only list the files to be removed
        #[arg(short = 'n', long)]
        dry_run: bool,
    },
}

/// A store, and one or all of its schemes.
#[derive(Debug, Args)]
pub(super) struct Which {
    /// Folder of the store
    #[arg(env = "SPHARM_STORE")]
    pub(super) dir: PathBuf,
    /// Key of a scheme, or its first digits [default: all schemes]
    pub(super) key: Option<String>,
}
