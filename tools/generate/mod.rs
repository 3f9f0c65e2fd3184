//! `generate`: writes folded surfaces whose true parameterisation is known.

mod args;
mod group;
mod study;

use anyhow::Result;
use spharm_cli::output::{OutputFile, check_outputs, prepare, print_line};
use spharm_surface::generate::{Cortex, cortex, cortex_bytes, icosphere_counts};
use spharm_surface::io::{Output, WriteOptions, write_mesh};

pub(crate) use self::args::Cli;

/// Memory, in bytes per vertex, for writing a mesh, including its triangles. The GIfTI writer holds each array
/// completely, to compress it.
const WRITING: u64 = 48;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    if let Some(folder) = &cli.study {
        return study::meshes(cli, folder);
    }
    if let Some(folder) = &cli.volumes {
        return study::volumes(cli, folder);
    }
    if let Some((family, folder)) = cli.group.as_deref().zip(cli.output_dir.as_deref()) {
        return group::group(cli, family, folder);
    }
    let chosen = cli.subdivisions.unwrap_or(6);
    let outputs = [(&cli.surface, "--surface"), (&cli.sphere, "--sphere")];
    let file = |path, flag| OutputFile::holding(path, flag, Output::OrderedMesh);
    let named = outputs.iter().filter_map(|(path, flag)| path.as_deref().map(|path| file(path, flag)));
    check_outputs(named, cli.force)?;
    let needed = |subdivisions| cortex_bytes(subdivisions).saturating_add(WRITING * icosphere_counts(subdivisions)[0]);
    let what = format!("generate --subdivisions {}", chosen);
    let fewer = (0..chosen).rev().map(|fewer| (format!("--subdivisions {fewer}"), needed(fewer)));
    cli.memory.budget(1).check_or(what, needed(chosen), fewer)?;
    let (surface, sphere) = cortex(&Cortex { subdivisions: chosen, variant: cli.variant });
    let options = WriteOptions { overwrite: cli.force, double: cli.double };
    for (path, mesh) in [(&cli.surface, &surface), (&cli.sphere, &sphere)] {
        if let Some(path) = path {
            prepare(path)?;
            write_mesh(path, mesh, &options)?;
            print_line(&format!("{}: {} vertices", path.display(), mesh.vertices.len()))?;
        }
    }
    Ok(())
}
