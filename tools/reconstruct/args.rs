//! Arguments of `reconstruct`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::threads::Threads;

/// Evaluate models at the vertices of any sphere
///
/// Without further options the surface that was fitted comes back, smoothed. With a lower --max-degree it becomes
/// coarser, with --icosphere or --sphere it comes on another mesh. A model of a signal gives a signal.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm reconstruct --model bunny.spharm.npz -o bunny60.ply",
        "spharm reconstruct --model bunny.spharm.npz --max-degree 10 --icosphere 5 -o coarse.obj",
        "spharm reconstruct --model models --icosphere 6 -o surfaces --format ply",
    ],
    &[help::MESHES, help::SIGNALS],
))]
pub(crate) struct Cli {
    /// Models, as `spharm fit` writes them
    ///
    /// Files, folders, whose .npz files are taken, or @LIST with a path a line.
    #[arg(long, value_name = "MODEL.spharm.npz", num_args = 1.., required = true, help_heading = INPUT)]
    pub(super) model: Vec<PathBuf>,
    /// Highest degree to use [default: the model's]
    #[arg(long, alias = "degree", value_name = "L", help_heading = METHOD)]
    pub(super) max_degree: Option<usize>,
    #[command(flatten)]
    pub(super) sampling: Sampling,
    /// File to write; for several models a folder
    ///
    /// The format of a file is that of its name: .ply, .surf.gii, .obj, ...; for signals .func.gii, .csv, ...
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Format of the files in a folder [default: surf.gii, for signals func.gii]
    #[arg(long, value_name = "ENDING", help_heading = OUTPUT)]
    pub(super) format: Option<String>,
    /// Write 64-bit positions where the format has a choice
    #[arg(long, help_heading = OUTPUT)]
    pub(super) double: bool,
    /// Replace outputs that exist
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}

/// Where a model is evaluated.
#[derive(Debug, Args)]
#[group(multiple = false)]
pub(super) struct Sampling {
    /// Evaluate at the vertices of a sphere mesh
    #[arg(long, value_name = "SPHERE", help_heading = METHOD)]
    pub(super) sphere: Option<PathBuf>,
    /// Evaluate at the vertices of an icosphere
    ///
    /// Of N subdivisions: 10 4^N + 2 vertices.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=12), help_heading = METHOD)]
    pub(super) icosphere: Option<u32>,
    /// Evaluate at the vertices that were fitted; the default
    ///
    /// Of a surface whose handles were cut (--cut-handles), the fillings are left out and the seams welded, so that it
    /// has its handles again. With --sphere and the sphere of the cut surface it comes as it was cut.
    #[arg(long, help_heading = METHOD)]
    pub(super) original: bool,
}
