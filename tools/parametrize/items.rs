//! Determines the surfaces to map and their output files, and checks them before any surface is mapped.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use spharm_cli::inputs::{expand_lists, stem};
use spharm_cli::output::{OutputFile, check_files, check_outputs};
use spharm_cli::surfaces::{Labels, surfaces};
use spharm_cohort::reader::SurfaceReader;
use spharm_parametrize::volume::is_volume;
use spharm_surface::io::Output;

use super::args::{Cli, MethodName};

/// A surface to map, with its output files.
pub(super) struct Item {
    pub(super) input: PathBuf,
    /// Label in a volume; `None` for a mesh.
    pub(super) label: Option<i64>,
    pub(super) sphere: PathBuf,
    pub(super) surface: Option<PathBuf>,
}

impl Item {
    /// Returns the input's name for messages: the file, and the label in a volume.
    pub(super) fn name(&self) -> String {
        match self.label {
            Some(label) => format!("{}, label {label}", self.input.display()),
            None => self.input.display().to_string(),
        }
    }

    /// Returns whether the sphere's file stores metadata, as GIfTI does.
    pub(super) fn keeps_metadata(&self) -> bool {
        let name = self.sphere.to_string_lossy().to_lowercase();
        name.trim_end_matches(".gz").ends_with(".gii")
    }
}

/// Returns the surfaces with their output files. Refuses arguments that conflict, and outputs that would be
/// overwritten.
pub(super) fn items(cli: &Cli, reader: &SurfaceReader, monitor: &dyn spharm::Monitor) -> Result<Vec<Item>> {
    let report = cli.report.as_deref().map(|path| OutputFile::new(path, "--report"));
    check_outputs(report, cli.force)?;
    let file = cli.label.len() < 2 && !cli.label.contains(&Labels::All) && !cli.output.is_dir();
    let paths = cli.paths();
    if let [input] = &paths[..] {
        check(cli, input)?;
        if file {
            // Check the arguments first, because reading the volume takes a while.
            single(cli, input, None)?;
        }
    }
    let inputs = surfaces(reader, &expand_lists(&paths)?, &cli.label, true, monitor)?;
    inputs.iter().try_for_each(|(input, _)| check(cli, input))?;
    let items = match &inputs[..] {
        [(input, label)] if file && *input == paths[0] => vec![single(cli, input, *label)?],
        _ => several(cli, inputs)?,
    };
    let spheres = items.iter().map(|item| OutputFile::holding(&item.sphere, "--output", Output::OrderedMesh));
    let surfaces = items.iter().filter_map(|item| item.surface.as_deref());
    let surfaces = surfaces.map(|path| OutputFile::holding(path, "--surface-output", Output::OrderedMesh));
    let given = items.iter().map(|item| item.input.as_path());
    check_files(given, spheres.chain(surfaces).chain(report), cli.force)?;
    Ok(items)
}

/// Refuses arguments that don't apply to an input.
fn check(cli: &Cli, input: &Path) -> Result<()> {
    let volume = is_volume(input);
    if volume && cli.wrap.is_some() {
        bail!("{}: --wrap can only be used for meshes; use --fix to repair a label of a volume", input.display());
    }
    let by_cald = !volume && !matches!(cli.method, MethodName::Conformal | MethodName::Stretch);
    if !by_cald && (cli.area.is_some() || cli.max_degree.is_some()) {
        bail!("--area and --max-degree can only be used for meshes, with --method cald, auto or deform");
    }
    match cli.method {
        MethodName::EqualArea if !volume => {
            bail!(
                "--method equal-area can only be used for volumes (.nii, .mgz, .nrrd, .tif, .npy); use --method cald \
                 for meshes"
            )
        }
        MethodName::Deform if cli.resample_to.is_some() => {
            bail!("--method deform creates its own sampling; omit --resample-to")
        }
        MethodName::Deform => Ok(()),
        _ if cli.subdivisions.is_some() => {
            bail!("--subdivisions can only be used with --method deform; use --resample-to icosphere:N")
        }
        _ => Ok(()),
    }
}

/// Returns the reason why the mapped surface differs from the input, or `None` if the input itself is mapped.
fn new_surface(cli: &Cli, input: &Path) -> Option<&'static str> {
    match (cli.method, &cli.resample_to) {
        (MethodName::Deform, _) => Some("deform makes"),
        (_, Some(_)) => Some("--resample-to makes"),
        _ if is_volume(input) => Some("mapping a volume makes"),
        _ if cli.cut_handles => Some("--cut-handles makes"),
        _ if cli.fix => Some("--fix makes"),
        _ if cli.wrap.is_some() => Some("--wrap makes"),
        _ => None,
    }
}

fn single(cli: &Cli, input: &Path, label: Option<i64>) -> Result<Item> {
    let surface = match (&cli.surface_output, new_surface(cli, input)) {
        (Some(path), _) => Some(path.clone()),
        (None, None) => None,
        (None, Some(why)) => match beside(&cli.output) {
            Some(path) => Some(path),
            None => bail!(
                "{why} a new surface, with the same triangles as the sphere; give a file for it with --surface-output"
            ),
        },
    };
    Ok(Item { input: input.to_owned(), label, sphere: cli.output.clone(), surface })
}

/// Returns the default path of the surface that is written next to a sphere, such as `x.ply` for `x.sphere.ply`.
fn beside(sphere: &Path) -> Option<PathBuf> {
    let name = sphere.file_name()?.to_string_lossy().into_owned();
    let (stem, ending) = name.split_once(".sphere.")?;
    Some(sphere.with_file_name(format!("{stem}.{ending}")))
}

fn several(cli: &Cli, inputs: Vec<(PathBuf, Option<i64>)>) -> Result<Vec<Item>> {
    let folders = [Some((&cli.output, "--output")), cli.surface_output.as_ref().map(|path| (path, "--surface-output"))];
    for (path, flag) in folders.into_iter().flatten() {
        // A path with the extension of a known format is the path of a file, not of a folder.
        if !path.is_dir() && path.file_name().is_some_and(|name| stem(path) != name.to_string_lossy()) {
            bail!(
                "{}: one file can't hold the results of {} surfaces; {flag} must name a folder",
                path.display(),
                inputs.len()
            );
        }
    }
    let spheres = cli.name_template.outputs(&inputs, &cli.output, ".sphere.surf.gii")?;
    let folder = cli.surface_output.as_ref().unwrap_or(&cli.output);
    let surfaces = cli.name_template.outputs(&inputs, folder, ".surf.gii")?;
    let item = |(((input, label), sphere), surface): (((PathBuf, Option<i64>), PathBuf), PathBuf)| {
        let wanted = cli.surface_output.is_some() || new_surface(cli, &input).is_some();
        Item { surface: wanted.then_some(surface), input, label, sphere }
    };
    Ok(inputs.into_iter().zip(spheres).zip(surfaces).map(item).collect())
}
