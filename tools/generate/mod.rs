//! `generate`: surfaces of our own, whose true parameterisation is known.

use std::path::PathBuf;

use anyhow::Result;
use spharm_cli::Common;
use spharm_cli::output::print;
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{WriteOptions, write_mesh};

/// Write a folded surface and its sphere, for trying things out
///
/// A smooth map bends an icosphere into a closed surface with folds like a cortex's, about 140 mm long and not
/// star-shaped. Vertex i of the surface belongs to vertex i of the sphere. The same arguments give the same bits.
#[derive(Debug, clap::Args)]
pub(crate) struct Cli {
    /// Subdivisions of the icosphere: 10 4^N + 2 vertices
    #[arg(long, value_name = "N", default_value_t = 6, value_parser = clap::value_parser!(u32).range(0..=10))]
    subdivisions: u32,
    /// Which member of the family
    #[arg(long, value_name = "SEED", default_value_t = 0)]
    variant: u64,
    /// Surface to write
    #[arg(long, value_name = "OUT")]
    surface: Option<PathBuf>,
    /// Sphere to write
    #[arg(long, value_name = "OUT", required_unless_present = "surface")]
    sphere: Option<PathBuf>,
    /// Write 64-bit positions where the format has a choice
    #[arg(long)]
    double: bool,
    /// Replace outputs that exist
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    common: Common,
}

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let (surface, sphere) = cortex(&Cortex { subdivisions: cli.subdivisions, variant: cli.variant });
    let options = WriteOptions { overwrite: cli.force, double: cli.double };
    for (path, mesh) in [(&cli.surface, &surface), (&cli.sphere, &sphere)] {
        if let Some(path) = path {
            write_mesh(path, mesh, &options)?;
            print(&format!("{}: {} vertices", path.display(), mesh.vertices.len()))?;
        }
    }
    Ok(())
}
