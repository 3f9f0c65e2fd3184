//! Arguments of `paper`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT, RESOURCES};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;

/// Repeat the experiments of Shen and Chung (3DPVT 2006) and compare with the paper's results
///
/// The experiments run on a generated cortex of 40,962 vertices and on the surfaces in --data. The results of each
/// experiment are written as CSV and as SVG. A summary of all experiments is written to paper.md and printed. The run
/// takes a few minutes, and needs 3.2 GiB of disk space for the largest basis.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &["spharm paper --quick -o results", "spharm paper --data ../shared/data --memory 2GiB -o results"],
    &[],
))]
pub(crate) struct Cli {
    /// Folder with the paper's surfaces
    ///
    /// The folder may contain cort40962, head27618, the hippocampi hippo_a01_l to hippo_a03_l, and reference.json.
    #[arg(long, value_name = "DIR", conflicts_with = "quick", help_heading = INPUT)]
    pub(super) data: Option<PathBuf>,
    /// Folder of the results; created if it doesn't exist
    #[arg(short, long, value_name = "DIR", default_value = "paper", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Folder of a basis store, to which missing bases are added [default: a store in --output that is removed at the
    /// end]
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    pub(super) store: Option<PathBuf>,
    /// Replace existing results
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    /// Use a small surface and low degrees, to check in a few seconds that everything works
    #[arg(long, help_heading = METHOD)]
    pub(super) quick: bool,
    /// Memory that each build and each fit may use, mapped files included
    #[arg(long, value_name = "SIZE", default_value = "1GiB", help_heading = RESOURCES)]
    pub(super) memory: Size,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}
