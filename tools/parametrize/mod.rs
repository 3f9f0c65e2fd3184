//! `parametrize`: maps closed surfaces onto the sphere, one to one.

mod args;
mod items;
mod output;

use anyhow::{Context, Result};
use spharm::Preparation;
use spharm_cli::inputs::expand_lists;
use spharm_cli::memory::Budget;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{is_stdout, prepare, print, print_json, write_json};
use spharm_cohort::reader::SurfaceReader;
use spharm_parametrize::{
    CaldParams, ConformalParams, DeformParams, EqualAreaParams, Input, Method, Parametrization, Sampling, Source,
    StretchParams,
};
use spharm_surface::Seam;
use spharm_surface::io::{WriteOptions, to_write_mesh, write_mesh};

pub(crate) use self::args::Cli;
use self::args::MethodName;
use self::items::{Item, items};
use self::output::{Written, described};

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    let monitor = ConsoleMonitor::new(console);
    let reader = SurfaceReader::new(Preparation {
        reading: cli.volume.reading(),
        label_surface: cli.label_surface.surface(&cli.volume)?,
        fix: cli.fix,
        largest_repair: cli.largest_repair,
        wrap: cli.wrap,
        cut_handles: cli.cut_handles,
    });
    let budget = cli.memory.budget(cli.threads.count());
    for input in expand_lists(&cli.paths())? {
        budget.check_inputs("parametrize", [input.as_path()])?;
    }
    let items = items(cli, &reader, &monitor)?;
    let pool = cli.threads.pool()?;
    let to_stdout = cli.report.as_deref().is_some_and(is_stdout);
    let mut written = Vec::new();
    for item in &items {
        let one = pool.install(|| one(cli, item, &reader, budget, &monitor))?;
        if !cli.json && !to_stdout {
            print(&one.table())?;
        }
        written.push(one);
    }
    reader.warnings().iter().for_each(|warning| console.warn(warning));
    if let Some(path) = &cli.report {
        match &written[..] {
            [one] => write_json(path, cli.force, one)?,
            several => write_json(path, cli.force, &several)?,
        }
    }
    match &written[..] {
        _ if !cli.json || to_stdout => Ok(()),
        [one] => print_json(one),
        several => print_json(&several),
    }
}

/// Maps one surface and writes its files.
fn one(cli: &Cli, item: &Item, reader: &SurfaceReader, budget: Budget, monitor: &ConsoleMonitor) -> Result<Written> {
    let console = monitor.console();
    let input = reader.read(&item.input, item.label, monitor).with_context(|| item.input.display().to_string())?;
    console.note(format_args!("{}: {}", item.input.display(), described(&input)));
    for change in input.changes(cli.cut_handles) {
        console.warn(format_args!("{}: {change}", item.name()));
    }
    let mut found = parametrize(cli, &input, budget, monitor).with_context(|| item.name())?;
    if let Some(cut) = input.cut() {
        cut.mark(&mut found.sphere);
        if Seam::of(&found.sphere.meta).is_none() {
            console.warn(
                "the resampled sphere doesn't store the seams where handles were cut, so models on this sphere \
                 reconstruct the cut surface",
            );
        } else if !item.keeps_metadata() {
            console.warn(format_args!(
                "{}: this format doesn't store the seams where handles were cut, so models on this sphere reconstruct \
                 the cut surface; write .surf.gii instead",
                item.sphere.display()
            ));
        }
    }
    found.report.warnings.iter().for_each(|warning| console.warn(format_args!("{}: {warning}", item.name())));
    found.report.notes.iter().for_each(|note| console.note(note));

    if !to_write_mesh(&item.sphere)?.holds_double(true) {
        found.check_single_precision().with_context(|| item.sphere.display().to_string())?;
    }
    let options = WriteOptions { overwrite: cli.force, double: true };
    let outputs = [(Some(&item.sphere), &found.sphere), (item.surface.as_ref(), &found.surface)];
    for (path, mesh) in outputs {
        if let Some(path) = path {
            prepare(path)?;
            write_mesh(path, mesh, &options)?;
        }
    }
    Ok(Written::new(cli, item, &input, found))
}

fn parametrize(cli: &Cli, input: &Input, budget: Budget, monitor: &ConsoleMonitor) -> Result<Parametrization> {
    let seed = cli.seed;
    let default = CaldParams::default();
    let params = CaldParams { area: cli.area.unwrap_or(default.area), degree: cli.max_degree, seed, ..default };
    let method = match cli.method {
        MethodName::Auto => Method::Auto(params),
        MethodName::Cald => Method::Cald(params),
        MethodName::EqualArea => Method::EqualArea(EqualAreaParams::default()),
        MethodName::Conformal => Method::Conformal(ConformalParams { seed, ..ConformalParams::default() }),
        MethodName::Stretch => Method::Stretch(StretchParams { seed, ..StretchParams::default() }),
        MethodName::Deform => {
            let deform = DeformParams { subdivisions: cli.subdivisions, ..DeformParams::default() };
            Method::Deform { params: deform, map: params }
        }
    };
    let vertices = Source::from(input).vertices();
    let resampling = cli.resample_to.as_ref().map_or(0, Sampling::bytes);
    let mapping = method.bytes(vertices);
    let what = format!("mapping {vertices} vertices");
    let coarser = match cli.resample_to {
        Some(Sampling::Icosphere(subdivisions)) => 0..subdivisions,
        _ => 0..0,
    };
    let coarser = coarser.rev().map(|n| (n, mapping.saturating_add(Sampling::Icosphere(n).bytes())));
    let coarser = coarser.map(|(n, needed)| (format!("--resample-to icosphere:{n}"), needed));
    budget.check_or(what, mapping.saturating_add(resampling), coarser)?;
    let found = method.run(input, monitor)?;
    match &cli.resample_to {
        Some(sampling) => Ok(found.resampled(&sampling.sphere()?, monitor)?),
        None => Ok(found),
    }
}
