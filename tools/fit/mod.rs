//! `fit`: fits surfaces and signals on the sphere.

mod args;
mod moments;
mod settings;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use serde_json::{Map, json};
use spharm::parametrize::volume::is_volume;
use spharm::{FitParams, Preparation, Sphere};
use spharm_cli::Usage;
use spharm_cli::console::Console;
use spharm_cli::inputs::{expand_lists, keep_each_once, read_sphere};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::names::model_files;
use spharm_cli::paths::shown;
use spharm_cli::surfaces::{Labels, surfaces as named};
use spharm_cohort::files::ModelFiles;
use spharm_cohort::reader::SurfaceReader;
use spharm_cohort::rerun::IfExists;
use spharm_cohort::run::{Cohort, RunParams};
use spharm_cohort::{FolderMeshes, Manifest, Row, meshes_of_folder, volumes_hint};
use spharm_surface::SurfaceError;

pub(crate) use self::args::Cli;
use self::args::Input;
use crate::rows::{self, Options, Previewed, if_exists};

pub(crate) fn run(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    rows::set_log(&cli.cohort);
    let (params, monitor) = (settings::params(cli)?, ConsoleMonitor::new(cli.common.console()));
    if let Some(path) = &cli.input.moments {
        return moments::run(cli, path, &params, &monitor);
    }
    let mut options = options(cli, params)?;
    // This reader keeps the volume that it read last in memory until the run starts; the run creates a reader of its
    // own.
    let reader = SurfaceReader::new(options.run.preparation);
    let cohort = match &cli.input.manifest {
        Some(path) => of_manifest(cli, Manifest::read(path)?)?,
        None => of_list(cli, &options, &reader, &monitor)?,
    };
    if cli.method.max_degree.is_none() {
        options.run.fit.max_degree = chosen_degree(cli, &cohort, &options, &reader, &monitor)?;
    }
    drop(reader);
    rows::run(&cohort, &options, &monitor, started)
}

/// Chooses the common degree of all models, and prints this degree.
fn chosen_degree(
    cli: &Cli,
    cohort: &Cohort,
    options: &Options,
    reader: &SurfaceReader,
    monitor: &ConsoleMonitor,
) -> Result<usize> {
    let (accuracy, params) = (cli.method.accuracy, &options.run.fit);
    let keep = match options.run.if_exists {
        IfExists::Refuse | IfExists::Skip => true,
        IfExists::Update => accuracy.is_none(),
        IfExists::Replace => false,
    };
    let choose = || spharm_cohort::degree::choose(cohort, accuracy, keep, params, reader, monitor);
    let chosen = options.threads.pool()?.install(choose).map_err(|error| {
        let signal = matches!(&error, spharm::Error::Surface(SurfaceError::NotAMesh { .. }));
        let error = anyhow::Error::from(error);
        if signal { error.context("signals need --max-degree L") } else { error }
    })?;
    let text = format!("{chosen}; use --max-degree L for another degree");
    match chosen.reached() {
        true => monitor.console().note(text),
        false => monitor.console().warn(text),
    }
    Ok(chosen.degree())
}

/// Previews the fits of the rows of `manifest`. The manifest's file doesn't have to exist yet.
pub(crate) fn preview(cli: &Cli, manifest: Manifest) -> Result<Previewed> {
    let (options, monitor) = (options(cli, settings::params(cli)?)?, ConsoleMonitor::new(cli.common.console()));
    rows::preview(&of_manifest(cli, manifest)?, &options, &monitor)
}

fn options(cli: &Cli, params: FitParams) -> Result<Options> {
    let input = &cli.input;
    let about = [
        ("tool", json!("fit")),
        ("store", json!(params.store.as_ref().map(shown))),
        ("manifest", json!(input.manifest.as_ref().map(shown))),
        ("shard", json!(cli.cohort.shard.map(|shard| shard.to_string()))),
        ("sphere", json!(input.sphere.as_ref().map(shown))),
        ("weights", json!(input.weights)),
    ];
    let mut run = RunParams::new(params);
    run.preparation = preparation(input)?;
    run.mask.clone_from(&input.mask);
    run.coefficients_csv = cli.output.coefficients_csv;
    run.if_exists = if_exists(cli.output.force, cli.output.update, cli.output.skip_existing);
    Ok(Options {
        report: cli.output.report.clone(),
        json: cli.output.json,
        about: about.into_iter().map(|(name, value)| (name.to_owned(), value)).collect::<Map<_, _>>(),
        aligned_later: cli.output.aligned_later,
        ..Options::new(run, cli.resources.threads).with(&cli.cohort)
    })
}

fn preparation(input: &Input) -> Result<Preparation> {
    let (reading, label_surface) = (input.volume.reading(), input.label_surface.surface(&input.volume)?);
    let Input { fix, wrap, cut_handles, largest_repair, .. } = *input;
    if let Some(volume) = input.surface.iter().find(|path| wrap.is_some() && is_volume(path)) {
        bail!("{}: --wrap can only be used for meshes; use --fix to repair a label of a volume", volume.display());
    }
    Ok(Preparation { reading, label_surface, fix, wrap, cut_handles, largest_repair })
}

/// Returns the rows of a manifest that belong to the shard. Rows without a sphere use `--sphere`, and volumes without a
/// label use `--label`.
fn of_manifest(cli: &Cli, mut manifest: Manifest) -> Result<Cohort> {
    let shard = cli.cohort.shard.unwrap_or_default();
    match cli.input.label[..] {
        [] => {}
        [Labels::One(label)] => manifest.label_volumes(label),
        _ => return Err(Usage::conflict("with --manifest, --label must be one number: a row has one model").into()),
    }
    Ok(Cohort::of_manifest(manifest, cli.output.output.clone(), shard).with_sphere(cli.input.sphere.clone()))
}

/// Returns a row for each surface in the arguments. Also reads the sphere given by `--sphere`, if any.
fn of_list(cli: &Cli, options: &Options, reader: &SurfaceReader, monitor: &ConsoleMonitor) -> Result<Cohort> {
    let (input, console) = (&cli.input, monitor.console());
    let read = |path: &PathBuf| -> Result<Sphere> { read_sphere(path, input.strict, console) };
    let sphere = input.sphere.as_ref().map(read).transpose()?;
    let of_volumes = sphere.is_none();
    let paths = files(input, console)?;
    let surfaces = if options.run.keep_going {
        let mut surfaces = Vec::new();
        for path in paths {
            match named(reader, std::slice::from_ref(&path), &input.label, of_volumes, monitor) {
                Ok(found) => surfaces.extend(found),
                // If a volume is refused, for example because it can't be read, keep it as a row without a label. This
                // row fails later for the same reason, without stopping the other rows.
                Err(_) if is_volume(&path) => surfaces.push((path, None)),
                Err(error) => return Err(error),
            }
        }
        surfaces
    } else {
        named(reader, &paths, &input.label, of_volumes, monitor)?
    };
    let models = model_files(cli.output.output.as_deref(), &cli.output.name_template, &surfaces)?;
    let row = |((surface, label), model): ((PathBuf, Option<i64>), PathBuf)| Row {
        id: ModelFiles { model: model.clone() }.name(),
        surface,
        sphere: input.sphere.clone(),
        output: Some(model),
        label,
        ..Row::default()
    };
    let rows: Vec<Row> = surfaces.into_iter().zip(models).map(row).collect();
    let shard = cli.cohort.shard.unwrap_or_default();
    let mut cohort = Cohort::new(shard.of(&rows).cloned().collect(), PathBuf::new());
    (cohort.sphere, cohort.check_first) = (sphere, true);
    Ok(cohort)
}

/// Returns the given files without duplicates. Each @LIST is replaced by the paths in it, and each folder by the meshes
/// in it.
fn files(input: &Input, console: &Console) -> Result<Vec<PathBuf>> {
    let weights = Some(Path::new(&input.weights));
    let used = [input.sphere.as_deref(), input.mask.as_deref(), weights].into_iter().flatten().collect::<Vec<_>>();
    let mut files = Vec::new();
    for path in expand_lists(&input.paths())? {
        if !path.is_dir() {
            files.push(path);
            continue;
        }
        let FolderMeshes { meshes, others, volumes } = meshes_of_folder(&path, &used)?;
        if others > 0 {
            let (found, all) = (meshes.len(), meshes.len() + others);
            console.note(format!(
                "{}: fitting {found} of {all} files; the others are skipped, because they are spheres or outputs of \
                 fits, or don't have the name of a mesh{}",
                path.display(),
                volumes_hint(&path, volumes)
            ));
        }
        files.extend(meshes);
    }
    keep_each_once(&mut files);
    Ok(files)
}
