//! `fit`: fits surfaces and signals on the sphere.

mod args;
mod items;
mod moments;
mod output;
mod settings;
mod unread;

use std::time::Instant;

use anyhow::{Context, Result};
use spharm::files::MadeOf;
use spharm::parametrize::Input;
use spharm::parametrize::volume::VolumeSurface;
use spharm::{Fit, ManyReport, Sphere, Target, files, fit_many};
use spharm_cli::inputs::{read_sphere, read_target};
use spharm_cli::machine::raise_file_limit;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted};
use spharm_cli::surfaces::SurfaceReader;
use spharm_store::SchemeKey;

pub(crate) use self::args::Cli;
use self::items::{Item, items};
use self::output::{Call, Fitted, Mapped};
use self::unread::{Group, Kept};

pub(crate) fn run(cli: &Cli) -> Result<()> {
    let (mut params, monitor) = (settings::params(cli)?, ConsoleMonitor::new(cli.common.console()));
    if let Some(path) = &cli.input.moments {
        return moments::run(cli, path, &params, &monitor);
    }
    let (beginning, console) = (Instant::now(), monitor.console());
    raise_file_limit();
    check_outputs(cli.output.report.iter().map(|path| OutputFile::new(path, "--report")), cli.output.force)?;
    let sphere = cli.input.sphere.as_deref().map(|path| read_sphere(path, cli.input.strict, console)).transpose()?;
    if let (Some(mask), Some(sphere)) = (&cli.input.mask, &sphere) {
        params.weights = unread::masked(&params.weights, mask, sphere)?;
    }
    let mut call = Call::new(cli, &params, &monitor);
    call.started = beginning;
    let started = call.started.elapsed().as_secs_f64();
    let mut reader = SurfaceReader::new(cli.input.fix, cli.input.cut_handles, cli.input.voxel_size);
    let (items, skipped) = items(cli, &params, sphere.as_ref(), &mut reader, &monitor)?;
    if !skipped.is_empty() {
        let there = if skipped.len() == 1 { "exists and is" } else { "exist and are" };
        console.note(format!("{} {there} left alone", counted(skipped.len(), "output")));
    }
    call.skipped = skipped;
    if items.is_empty() {
        // A report is written all the same: workflows wait for it.
        return call.finish(Vec::new(), Vec::new(), [started, 0.0]);
    }
    cli.resources.threads.pool()?.install(|| match &sphere {
        Some(sphere) => {
            let (mut fitted, mut reports) = (Vec::new(), Vec::new());
            for group in unread::groups(&items, sphere, &params, cli.input.mask.is_some())? {
                let (found, report) = fit_group(&call, sphere, &group)?;
                fitted.extend(found);
                reports.push(report);
            }
            call.finish(fitted, reports, [started, 0.0])
        }
        None => each_on_its_own(&call, &items, &mut reader),
    })
}

/// Maps each surface to a sphere of its own, which is written beside its model, and fits it there.
fn each_on_its_own(call: &Call<'_>, items: &[Item], reader: &mut SurfaceReader) -> Result<()> {
    if items.len() > 1 {
        call.monitor.console().note(
            "each surface gets a sphere of its own, turned arbitrarily: coefficients of different models don't correspond; \
             for that give a common --sphere",
        );
    }
    let (mut fitted, mut reports, mut mapping) = (Vec::new(), Vec::new(), 0.0);
    for item in items {
        let found = map(call, item, reader)?;
        let report = found.parametrized.map.report.clone();
        let handles = found.handles.clone();
        let mesh_repair = found.mesh_repair.map(|repair| repair.counts().into_iter().collect());
        let mapped = Mapped { sphere: item.files.sphere(), repair: found.repair, mesh_repair, handles, report };
        mapping += mapped.report.seconds;
        let (mut one, report) = fit_mapped(call, item, &found).inspect_err(|_| found.remove())?;
        one.iter_mut().for_each(|fitted| fitted.parametrization = Some(mapped.clone()));
        fitted.extend(one);
        reports.push(report);
    }
    call.finish(fitted, reports, [0.0, mapping])
}

fn fit_mapped(call: &Call<'_>, item: &Item, found: &files::Mapped) -> Result<(Vec<Fitted>, ManyReport)> {
    let made_of = MadeOf {
        input: None,
        repair: found.repair.as_ref(),
        mesh_repair: found.mesh_repair.as_ref(),
        handles: found.handles.as_ref(),
    };
    let found = &found.parametrized;
    let target = Target::from_mesh(&found.map.surface, &found.sphere)?;
    fit_on(call, &found.sphere, &[item], made_of, None, &|_| Ok(target.clone()))
}

/// Fits what leaves out the same vertices over a sphere that they share.
fn fit_group(call: &Call<'_>, sphere: &Sphere, group: &Group<'_>) -> Result<(Vec<Fitted>, ManyReport)> {
    let (strict, console) = (call.cli.input.strict, call.monitor.console());
    let Some(kept) = &group.kept else {
        let read = |number: usize| read_target(&group.items[number].input, sphere, strict, console);
        return fit_on(call, sphere, &group.items, MadeOf::default(), None, &read);
    };
    let (all, count) = (sphere.directions.len(), kept.count());
    for item in &group.items {
        console.note(format!("{}: {} of {all} vertices aren't read", item.input.display(), all - count));
    }
    let read = |number: usize| {
        let path = &group.items[number].input;
        let target = match kept.read(path, sphere)? {
            Some(target) => target,
            None => read_target(path, sphere, strict, console)?,
        };
        Ok(kept.of(target))
    };
    fit_on(call, sphere, &group.items, MadeOf::default(), Some(kept), &read)
}

/// Maps one surface to the sphere.
fn map(call: &Call<'_>, item: &Item, reader: &mut SurfaceReader) -> Result<files::Mapped> {
    let input = item.input.display();
    let surface = reader.read(&item.input, item.record.label, call.monitor)?;
    if let Input::Label(VolumeSurface { repair: Some(repair), .. }) = &surface {
        call.monitor.console().warn(format!("{}: {repair}", item.record));
    }
    if let Some(repair) = surface.mesh_repair() {
        call.monitor.console().warn(format!("{}: {repair}", item.record));
    }
    if let Some(handles) = surface.handles() {
        call.monitor.console().warn(format!("{}: {handles}", item.record));
    }
    let reuse = call.cli.output.skip_existing;
    let found = item.files.map(&surface, &item.record, call.params, reuse, item.replace, call.monitor);
    let found = found.with_context(|| input.to_string())?;
    let (report, path, console) = (&found.parametrized.map.report, item.files.sphere(), call.monitor.console());
    let (path, seconds, area) = (path.display(), report.seconds, report.quality.area_rms);
    console.note(match (found.written.is_empty(), report.method) {
        (true, _) => format!("{path}: the sphere that an earlier call made of {input} is used again"),
        (_, by) => {
            format!("{input}: no --sphere; mapped by {by} in {seconds:.1} s, log area ratio {area:.3} rms, to {path}")
        }
    });
    report.warnings.iter().for_each(|warning| console.warn(warning));
    report.notes.iter().for_each(|note| console.note(note));
    Ok(found)
}

/// Fits surfaces on a sphere and writes their models. `made_of` is what was changed in what they are of, `kept` the vertices
/// that are read, where not all are.
fn fit_on(
    call: &Call<'_>,
    sphere: &Sphere,
    items: &[&Item],
    made_of: MadeOf<'_>,
    kept: Option<&Kept>,
    read: &(dyn Fn(usize) -> Result<Target> + Sync),
) -> Result<(Vec<Fitted>, ManyReport)> {
    let done = |number: usize, mut fit: Fit| -> Result<Fitted> {
        let item = items[number];
        if kept.is_some() {
            // The model is one over the whole sphere.
            let settings = &mut fit.report.settings;
            settings.scheme = SchemeKey::of(&sphere.directions, settings.scalar);
            settings.weights = call.params.weights.name().to_owned();
            settings.weights_hash = call.params.weights.hash();
        }
        call.warn_of(item, &fit);
        let made_of = MadeOf { input: Some(&item.record), ..made_of };
        item.files.write(sphere, &fit, &made_of, call.cli.output.coefficients_csv, item.replace)?;
        let unread = kept.map(|kept| sphere.directions.len() - kept.count());
        let mut fitted = Fitted::new(item, fit.report);
        fitted.unread = unread;
        Ok(fitted)
    };
    let (over, params) = kept.map_or((sphere, call.params), |kept| (&kept.sphere, &kept.params));
    fit_many(over, items.len(), read, params, &done, call.monitor)
}
