//! `generate`: folded surfaces whose true parameterisation is known.

mod args;

use anyhow::Result;
use spharm_cli::output::{OutputFile, check_outputs, prepare, print};
use spharm_surface::generate::{Cortex, cortex};
use spharm_surface::io::{Output, WriteOptions, write_mesh};

pub(crate) use self::args::Cli;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let outputs = [(&cli.surface, "--surface"), (&cli.sphere, "--sphere")];
    let file = |path, flag| OutputFile::holding(path, flag, Output::OrderedMesh);
    let named = outputs.iter().filter_map(|(path, flag)| path.as_deref().map(|path| file(path, flag)));
    check_outputs(named, cli.force)?;
    let (surface, sphere) = cortex(&Cortex { subdivisions: cli.subdivisions, variant: cli.variant });
    let options = WriteOptions { overwrite: cli.force, double: cli.double };
    for (path, mesh) in [(&cli.surface, &surface), (&cli.sphere, &sphere)] {
        if let Some(path) = path {
            prepare(path)?;
            write_mesh(path, mesh, &options)?;
            print(&format!("{}: {} vertices", path.display(), mesh.vertices.len()))?;
        }
    }
    Ok(())
}
