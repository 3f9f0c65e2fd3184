//! `fit`: fits surfaces and signals on the sphere.

mod args;
mod moments;
mod settings;

use std::path::PathBuf;
use std::time::Instant;

use anyhow::Result;
use serde_json::{Map, json};
use spharm::cohort::{Manifest, Row};
use spharm::files::ModelFiles;
use spharm::parametrize::volume::is_volume;
use spharm::rerun::IfExists;
use spharm::{FitParams, Sphere};
use spharm_cli::inputs::{expand_lists, read_sphere};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::names::model_files;
use spharm_cli::paths::shown;
use spharm_cli::surfaces::SurfaceReader;

pub(crate) use self::args::Cli;
use crate::rows::{self, Options, Preview, Rows};

pub(crate) fn run(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    rows::set_log(&cli.cohort);
    let (params, monitor) = (settings::params(cli)?, ConsoleMonitor::new(cli.common.console()));
    if let Some(path) = &cli.input.moments {
        return moments::run(cli, path, &params, &monitor);
    }
    let options = options(cli, params);
    let rows = match &cli.input.manifest {
        Some(path) => of_manifest(cli, Manifest::read(path)?),
        None => of_list(cli, &options, &monitor)?,
    };
    rows::run(rows, &options, &monitor, started)
}

/// Looks at what a fit of a manifest's rows would do, which needn't be written yet.
pub(crate) fn preview(cli: &Cli, manifest: Manifest) -> Result<Preview> {
    let (options, monitor) = (options(cli, settings::params(cli)?), ConsoleMonitor::new(cli.common.console()));
    rows::preview(&of_manifest(cli, manifest), &options, &monitor)
}

fn options(cli: &Cli, params: FitParams) -> Options {
    let input = &cli.input;
    let about = [
        ("tool", json!("fit")),
        ("store", json!(input.store.as_ref().map(shown))),
        ("manifest", json!(input.manifest.as_ref().map(shown))),
        ("shard", json!(cli.cohort.shard.map(|shard| shard.to_string()))),
        ("sphere", json!(input.sphere.as_ref().map(shown))),
        ("weights", json!(input.weights)),
    ];
    Options {
        params,
        cohort: cli.cohort.clone(),
        fix: input.fix,
        voxel_size: input.voxel_size,
        mask: input.mask.clone(),
        cut_handles: input.cut_handles,
        coefficients_csv: cli.output.coefficients_csv,
        if_exists: match &cli.output {
            output if output.force => IfExists::Replace,
            output if output.update => IfExists::Update,
            output if output.skip_existing => IfExists::Skip,
            _ => IfExists::Refuse,
        },
        report: cli.output.report.clone(),
        json: cli.output.json,
        threads: cli.resources.threads,
        about: about.into_iter().map(|(name, value)| (name.to_owned(), value)).collect::<Map<_, _>>(),
        aligned_later: cli.output.aligned_later,
        check: None,
        evaluate: None,
    }
}

/// The rows of a manifest's shard. `--sphere` is the sphere of those that have none of their own.
fn of_manifest(cli: &Cli, manifest: Manifest) -> Rows {
    let folder = cli.output.output.clone().unwrap_or_else(|| manifest.folder().to_owned());
    let shard = cli.cohort.shard.unwrap_or_default();
    let mut rows: Vec<Row> = manifest.rows;
    let (index, count) = shard.index_and_count();
    let mut number = 0;
    rows.retain(|_| {
        number += 1;
        (number - 1) % count == index
    });
    if let Some(sphere) = &cli.input.sphere {
        rows.iter_mut().filter(|row| row.sphere.is_none()).for_each(|row| row.sphere = Some(sphere.clone()));
    }
    Rows { rows, folder, sphere: None, check_first: false }
}

/// The surfaces that the arguments name; their sphere is read.
fn of_list(cli: &Cli, options: &Options, monitor: &ConsoleMonitor) -> Result<Rows> {
    let (input, console) = (&cli.input, monitor.console());
    let read = |path: &PathBuf| -> Result<Sphere> { read_sphere(path, input.strict, console) };
    let sphere = input.sphere.as_ref().map(read).transpose()?;
    let mut reader = SurfaceReader::new(input.fix, input.cut_handles, input.voxel_size);
    let of_volumes = sphere.is_none();
    let surfaces = if options.cohort.keep_going {
        let mut surfaces = Vec::new();
        for path in expand_lists(&input.surface)? {
            match reader.surfaces(std::slice::from_ref(&path), input.label, of_volumes, monitor) {
                Ok(found) => surfaces.extend(found),
                // Its row fails for the same reason, and the others don't.
                Err(_) if is_volume(&path) || path.is_dir() => surfaces.push((path, None)),
                Err(error) => return Err(error),
            }
        }
        surfaces
    } else {
        reader.surfaces(&input.surface, input.label, of_volumes, monitor)?
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
    let shard = options.cohort.shard.unwrap_or_default();
    let rows = shard.of(&rows).cloned().collect();
    Ok(Rows { rows, folder: PathBuf::new(), sphere, check_first: true })
}
