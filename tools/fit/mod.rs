//! `fit`: fits surfaces and signals on the sphere.

mod args;
mod items;
mod output;
mod settings;

use std::path::Path;
use std::sync::{Mutex, PoisonError};

use anyhow::{Context, Result, bail};
use spharm::parametrize::{CaldParams, Parametrized, parametrize_with, with_sphere};
use spharm::{Fit, ManyReport, Mesh, Sphere, check_memory, fit_many};
use spharm_cli::inputs::{read_sphere, read_target};
use spharm_cli::machine::raise_file_limit;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, prepare, print};
use spharm_surface::SphereWarning;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

pub(crate) use self::args::Cli;
use self::items::{Item, items};
use self::output::{Call, Fitted, Mapped};

pub(crate) fn run(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    let (params, monitor) = (settings::params(cli)?, ConsoleMonitor::new(console));
    let call = Call::new(cli, &params, console, &monitor);
    raise_file_limit();
    check_outputs(cli.output.report.iter().map(|path| OutputFile::new(path, "--report")), cli.output.force)?;
    let sphere = cli.input.sphere.as_deref().map(|path| read_sphere(path, &console)).transpose()?;
    let off_centre =
        |warning: &&SphereWarning| cli.input.strict && matches!(warning, SphereWarning::RadiusSpread { .. });
    let flaw = sphere.iter().flat_map(|sphere| &sphere.warnings).find(off_centre);
    if let (Some(flaw), Some(path)) = (flaw, &cli.input.sphere) {
        bail!("{}: {flaw} (--strict)", path.display());
    }
    let read = call.started.elapsed().as_secs_f64();
    let items = items(cli, &console, sphere.as_ref(), &params)?;
    if items.is_empty() {
        return print("nothing to do: every output exists");
    }
    cli.resources.threads.pool()?.install(|| match &sphere {
        Some(sphere) => {
            let (fitted, report) = fit_on(&call, sphere, &items)?;
            call.finish(Some((report.scheme, report.scalar)), fitted, vec![report], [read, 0.0])
        }
        None => each_on_its_own(&call, &items),
    })
}

/// Maps each surface to a sphere of its own, which is written beside its model, and fits it there.
fn each_on_its_own(call: &Call<'_>, items: &[Item]) -> Result<()> {
    if items.len() > 1 {
        call.console.note(
            "each surface gets a sphere of its own, turned arbitrarily: coefficients of different models don't correspond; \
             for that give a common --sphere",
        );
    }
    let (mut fitted, mut reports, mut mapping) = (Vec::new(), Vec::new(), 0.0);
    for item in items {
        let (sphere, mapped) = map(call, item)?;
        mapping += mapped.report.seconds;
        // A sphere without its model would stand in the way of the next attempt.
        let fits = fit_on(call, &sphere, std::slice::from_ref(item));
        let (mut found, report) = fits.inspect_err(|_| drop(std::fs::remove_file(&mapped.sphere)))?;
        found.iter_mut().for_each(|fitted| fitted.parametrization = Some(mapped.clone()));
        fitted.extend(found);
        reports.push(report);
    }
    call.finish(None, fitted, reports, [0.0, mapping])
}

/// Maps one surface to the sphere, and writes the sphere.
fn map(call: &Call<'_>, item: &Item) -> Result<(Sphere, Mapped)> {
    let input = item.input.display();
    let (mesh, path) = (read_mesh(&item.input)?, item.files.sphere());
    check_memory(&mesh, call.params)?;
    let left_over = if call.cli.output.skip_existing { left_over(&path, &mesh) } else { None };
    let found = if let Some(found) = left_over {
        call.console.note(format!("{}: the sphere that an earlier call made of {input} is used again", path.display()));
        found
    } else {
        let params = CaldParams::for_degree(call.params.max_degree);
        let found = parametrize_with(&mesh, &params, call.monitor).with_context(|| input.to_string())?;
        prepare(&path)?;
        write_mesh(&path, &found.map.sphere, &WriteOptions { overwrite: item.replace, double: true })?;
        let report = &found.map.report;
        call.console.note(format!(
            "{input}: no --sphere; mapped by {} in {:.1} s, log area ratio {:.3} rms, to {}",
            report.method,
            report.seconds,
            report.quality.area_rms,
            path.display()
        ));
        report.warnings.iter().for_each(|warning| call.console.warn(warning));
        report.notes.iter().for_each(|note| call.console.note(note));
        found
    };
    let mapped = Mapped { sphere: path.clone(), report: found.map.report };
    Ok((Sphere { path: Some(path), ..found.sphere }, mapped))
}

/// The sphere of a mesh that an earlier call left, where it is one.
fn left_over(path: &Path, mesh: &Mesh) -> Option<Parametrized> {
    path.exists().then(|| with_sphere(mesh, &read_mesh(path).ok()?).ok()).flatten()
}

/// Fits surfaces on a sphere and writes their models.
fn fit_on(call: &Call<'_>, sphere: &Sphere, items: &[Item]) -> Result<(Vec<Fitted>, ManyReport)> {
    let (cli, fitted) = (call.cli, Mutex::new(Vec::new()));
    let read = |number: usize| read_target(&items[number].input, sphere, cli.input.strict, &call.console);
    let done = |number: usize, fit: Fit| -> Result<()> {
        let item = &items[number];
        call.warn_of(item, &fit);
        item.files.write(sphere, &fit, Some(&item.record), cli.output.coefficients_csv, item.replace)?;
        let one = (number, Fitted::new(item, fit.report));
        fitted.lock().unwrap_or_else(PoisonError::into_inner).push(one);
        Ok(())
    };
    let report = fit_many(sphere, items.len(), &read, call.params, &done, call.monitor)?;
    let mut fitted = fitted.into_inner().unwrap_or_else(PoisonError::into_inner);
    fitted.sort_by_key(|(number, _)| *number);
    Ok((fitted.into_iter().map(|(_, fitted)| fitted).collect(), report))
}
