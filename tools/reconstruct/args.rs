//! Arguments of `reconstruct`.

use std::path::PathBuf;

use clap::Args;
use spharm_cli::Common;
use spharm_cli::help::{self, INPUT, METHOD, OUTPUT};
use spharm_cli::memory::Memory;
use spharm_cli::threads::Threads;

/// Evaluate models at the vertices of any sphere
///
/// Without further options, the result is a smoothed version of the fitted surface. A lower --max-degree gives a
/// coarser surface. --icosphere or --sphere gives a surface with another mesh. From a model of a signal, the result is
/// a signal.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm reconstruct bunny.spharm.npz -o bunny60.ply",
        "spharm reconstruct bunny.spharm.npz --max-degree 10 --icosphere 5 -o coarse.obj",
        "spharm reconstruct models --icosphere 6 -o surfaces --format ply",
    ],
    &[help::MESHES, help::SIGNALS],
))]
pub(crate) struct Cli {
    /// Models, as `spharm fit` writes them
    ///
    /// Give files, folders (for all .npz files in them), or @LIST for a file LIST with one path per line.
    #[arg(value_name = "MODEL.spharm.npz", required_unless_present = "model", help_heading = INPUT)]
    pub(super) models: Vec<PathBuf>,
    /// Another way to give MODEL.spharm.npz
    #[arg(long, value_name = "MODEL.spharm.npz", num_args = 1.., help_heading = INPUT)]
    pub(super) model: Vec<PathBuf>,
    /// Highest degree to use [default: the model's]
    #[arg(short = 'L', long, alias = "degree", value_name = "L", help_heading = METHOD)]
    pub(super) max_degree: Option<usize>,
    #[command(flatten)]
    pub(super) sampling: Sampling,
    /// File to write; for several models, a folder
    ///
    /// The name determines the format: .ply, .surf.gii, .obj, ...; for signals .func.gii, .csv, ...
    #[arg(short, long, value_name = "OUT", help_heading = OUTPUT)]
    pub(super) output: PathBuf,
    /// Format of the files in a folder [default: surf.gii, for signals func.gii]
    #[arg(long, value_name = "ENDING", help_heading = OUTPUT)]
    pub(super) format: Option<String>,
    /// Write 64-bit positions if the format supports them
    #[arg(long, help_heading = OUTPUT)]
    pub(super) double: bool,
    /// Print a report as JSON instead of text
    #[arg(long, help_heading = OUTPUT)]
    pub(super) json: bool,
    /// Replace existing outputs
    #[arg(long, help_heading = OUTPUT)]
    pub(super) force: bool,
    #[command(flatten)]
    pub(super) memory: Memory,
    #[command(flatten)]
    pub(super) threads: Threads,
    #[command(flatten)]
    pub(super) common: Common,
}

/// Points at which a model is evaluated.
#[derive(Debug, Args)]
#[group(multiple = false)]
pub(super) struct Sampling {
    /// Evaluate at the vertices of a sphere mesh
    #[arg(long, value_name = "SPHERE", help_heading = METHOD)]
    pub(super) sphere: Option<PathBuf>,
    /// Evaluate at the vertices of an icosphere
    ///
    /// N subdivisions give 10 * 4^N + 2 vertices.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(0..=12), help_heading = METHOD)]
    pub(super) icosphere: Option<u32>,
    /// Evaluate at the fitted vertices; the default
    ///
    /// If the surface's handles were cut (--cut-handles), the handles are restored: the fillings are omitted and the
    /// seams are welded. To obtain the cut surface itself, give the sphere of the cut surface with --sphere.
    #[arg(long, help_heading = METHOD)]
    pub(super) original: bool,
}
