//! `generate --group`: writes the members of a family of shapes with known correspondence, with their landmarks and
//! true parameters.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use spharm_cli::output::{OutputFile, check_outputs, prepare, print_line};
use spharm_surface::generate::{Family, Group, Member, cortex_bytes, icosphere_counts};
use spharm_surface::io::landmarks::Landmarks;
use spharm_surface::io::{Output, WriteOptions, write_mesh, write_new};

use super::{Cli, WRITING};

/// Writes the meshes of a group, their landmarks and the table of their true parameters.
pub(super) fn group(cli: &Cli, family: &str, folder: &Path) -> Result<()> {
    let family = Family::ALL.into_iter().find(|known| known.name() == family).context("a family")?;
    let subdivisions = cli.subdivisions.unwrap_or(5);
    let group = Group { family, members: cli.members, seed: cli.variant, subdivisions, upright: cli.upright };
    // Memory for a single member, because members are generated and written one after another.
    let needed = |subdivisions| cortex_bytes(subdivisions).saturating_add(WRITING * icosphere_counts(subdivisions)[0]);
    let fewer = (0..subdivisions).rev().map(|fewer| (format!("--subdivisions {fewer}"), needed(fewer)));
    cli.memory.budget(1).check_or("generate --group", needed(subdivisions), fewer)?;
    let digits = cli.members.to_string().len().max(2);
    let names: Vec<String> = (1..=cli.members).map(|number| format!("s{number:0digits$}")).collect();
    let meshes: Vec<PathBuf> = names.iter().map(|name| folder.join(format!("{name}.ply"))).collect();
    let places: Vec<PathBuf> = names.iter().map(|name| folder.join(format!("{name}.json"))).collect();
    let table = folder.join("truth.csv");
    let files = meshes.iter().map(|path| OutputFile::holding(path, "--output-dir", Output::OrderedMesh));
    let others = places.iter().chain([&table]).map(|path| OutputFile::new(path, "--output-dir"));
    check_outputs(files.chain(others), cli.force)?;
    prepare(&table)?;
    let mut text = format!(
        "id,surface,landmarks,{},r11,r12,r13,r21,r22,r23,r31,r32,r33,t1,t2,t3\n",
        family.parameters().join(",")
    );
    for (index, name) in (0..).zip(&names) {
        let Member { mesh, parameters, rotation, translation, names, places: at } = group.member(index);
        let options = WriteOptions { overwrite: cli.force, double: cli.double };
        write_mesh(&meshes[index as usize], &mesh, &options)?;
        let names = names.into_iter().map(str::to_owned).collect();
        Landmarks { names, points: at, frame: None }.write(&places[index as usize], cli.force)?;
        let numbers = parameters.iter().chain(rotation.as_flattened()).chain(&translation);
        let numbers: Vec<String> = numbers.map(|number| format!("{number:?}")).collect();
        text += &format!("{name},{name}.ply,{name}.json,{}\n", numbers.join(","));
    }
    write_new(&table, cli.force, |out| out.write_all(text.as_bytes()))?;
    print_line(&format!("{}: {} meshes with landmarks, and truth.csv", folder.display(), meshes.len()))
}
