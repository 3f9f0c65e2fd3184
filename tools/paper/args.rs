//! Arguments of `paper`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT, RESOURCES};
use spharm_cli::size::Size;
use spharm_cli::threads::Threads;

/// Repeat the experiments of Shen and Chung (3DPVT 2006) beside the paper's results
///
/// They run on a generated cortex of 40,962 vertices and on the surfaces that --data has. Each experiment is written as
/// CSV and as SVG, and all of them are summed up in paper.md, which is printed as well. It takes some minutes, and for
/// the largest basis 3.2 GiB of disk.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &["spharm paper --quick -o results", "spharm paper --data ../shared/data --memory 2GiB -o results"],
    &[],
))]
pub(crate) struct Cli {
    /// Folder with the paper's surfaces
    ///
    /// cort40962, head27618, the hippocampi hippo_a01_l to a03_l and reference.json, or some of them.
    #[arg(long, value_name = "DIR", conflicts_with = "quick", help_heading = INPUT)]
    pub(super) data: Option<PathBuf>,
    /// Folder of the results; made where it isn't there
    #[arg(short, long, value_name = "DIR", default_value = "paper", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Folder of a basis store to use and to add to [default: one in --output, removed at the end]
    #[arg(long, value_name = "DIR", help_heading = OUTPUT)]
    pub(super) store: Option<PathBuf>,
    /// Replace results that exist
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    /// A small surface and low degrees, to see in a few seconds that everything works
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
