//! `generate`: writes folded surfaces with known true parameterisation.

mod args;
mod group;

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use spharm_cli::output::{OutputFile, check_outputs, prepare, print_line};
use spharm_surface::generate::{Cortex, Study, cortex, cortex_bytes, icosphere_counts};
use spharm_surface::io::{Output, WriteOptions, write_mesh, write_new};

pub(crate) use self::args::Cli;

/// Bytes of memory per vertex, including its triangles, while a mesh is written: GIfTI compresses entire arrays.
const WRITING: u64 = 48;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    if let Some(folder) = &cli.study {
        return study(cli, folder);
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

/// Writes the meshes of a study and its table.
fn study(cli: &Cli, folder: &Path) -> Result<()> {
    if !cli.bump.is_finite() {
        bail!("--bump is {}; it must be finite", cli.bump);
    }
    let study = Study { seed: cli.variant, bump: cli.bump, ..Study::default() };
    let half = cli.subjects.div_ceil(2);
    let digits = cli.subjects.to_string().len().max(2);
    let subject = |number: u64| {
        let second = number >= half;
        let (group, index) = if second { ("b", number - half) } else { ("a", number) };
        (format!("{group}{:0digits$}", index + 1), group, index, second)
    };
    // Only one mesh is in memory at a time.
    let needed = cortex_bytes(study.subdivisions) + WRITING * icosphere_counts(study.subdivisions)[0];
    cli.memory.budget(1).check("generate --study", needed)?;
    let subjects: Vec<_> = (0..cli.subjects).map(subject).collect();
    let meshes: Vec<PathBuf> = subjects.iter().map(|(name, ..)| folder.join(format!("{name}.ply"))).collect();
    let table = folder.join("study.csv");
    let files = meshes.iter().map(|path| OutputFile::holding(path, "--study", Output::OrderedMesh));
    check_outputs(files.chain([OutputFile::new(&table, "--study")]), cli.force)?;
    prepare(&table)?;
    let mut text = "id,surface,group\n".to_owned();
    for ((name, group, index, second), path) in subjects.iter().zip(&meshes) {
        let options = WriteOptions { overwrite: cli.force, double: cli.double };
        write_mesh(path, &study.subject(*index, *second), &options)?;
        text += &format!("{name},{name}.ply,{group}\n");
    }
    write_new(&table, cli.force, |out| out.write_all(text.as_bytes()))?;
    print_line(&format!("{}: {} meshes, study.csv", folder.display(), meshes.len()))
}
