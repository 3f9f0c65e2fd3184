//! `fit`: fits surfaces and signals on the sphere.

mod args;
mod items;
mod output;

use std::path::Path;
use std::sync::Mutex;

use anyhow::{Context, Result};
use spharm::parametrize::{Parametrized, parametrize_with, with_sphere};
use spharm::{Fit, ManyReport, Mesh, Sphere, check_memory, defaults, fit_many};
use spharm_cli::inputs::{read_sphere, read_target};
use spharm_cli::machine::raise_file_limit;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{print, refuse_existing};
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

pub(crate) use self::args::Cli;
use self::items::{Item, items};
use self::output::{Call, Fitted, Mapped};

pub(crate) fn run(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    let (params, monitor) = (cli.params()?, ConsoleMonitor::new(console));
    let call = Call::new(cli, &params, console, &monitor);
    raise_file_limit();
    if let Some(path) = &cli.report {
        refuse_existing(path, cli.force, "report", "--report")?;
        make_folder_of(path)?;
    }
    let sphere = cli.sphere.as_deref().map(|path| read_sphere(path, &console)).transpose()?;
    let read = call.started.elapsed().as_secs_f64();
    let items = items(cli, &console, sphere.as_ref(), &params)?;
    if items.is_empty() {
        return print("nothing to do: every output exists");
    }
    cli.threads.pool()?.install(|| match &sphere {
        Some(sphere) => on_one_sphere(&call, sphere, &items, read),
        None => each_on_its_own(&call, &items),
    })
}

/// Fits surfaces that share a sphere.
fn on_one_sphere(call: &Call<'_>, sphere: &Sphere, items: &[Item], read: f64) -> Result<()> {
    let (fitted, report) = fit_on(call, sphere, items)?;
    call.finish(Some((report.scheme, report.scalar)), fitted, vec![report], [read, 0.0])
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
    let (mesh, path) = (read_mesh(&item.input)?, item.sphere());
    check_memory(&mesh, call.params).map_err(|error| call.explain(error.into()))?;
    if call.cli.skip_existing
        && let Some(found) = left_over(&path, &mesh)
    {
        call.console.note(format!("{}: the sphere that an earlier call made of {input} is used again", path.display()));
        return Ok((
            Sphere { path: Some(path.clone()), ..found.sphere },
            Mapped { sphere: path, report: found.map.report },
        ));
    }
    let params = defaults::parametrization(call.params.max_degree);
    let found = parametrize_with(&mesh, &params, call.monitor).with_context(|| input.to_string())?;
    let report = found.map.report;
    make_folder_of(&path)?;
    write_mesh(&path, &found.map.sphere, &WriteOptions { overwrite: item.replace, double: true })?;
    call.console.note(format!(
        "{input}: no --sphere; mapped by {} in {:.1} s, log area ratio {:.3} rms, to {}",
        report.method,
        report.seconds,
        report.quality.area_rms,
        path.display()
    ));
    report.warnings.iter().for_each(|warning| call.console.warn(warning));
    report.notes.iter().for_each(|note| call.console.note(note));
    Ok((Sphere { path: Some(path.clone()), ..found.sphere }, Mapped { sphere: path, report }))
}

/// The sphere of a mesh that an earlier call left, where it is one.
fn left_over(path: &Path, mesh: &Mesh) -> Option<Parametrized> {
    path.exists().then(|| with_sphere(mesh, &read_mesh(path).ok()?).ok()).flatten()
}

/// Fits surfaces on a sphere and writes their models.
fn fit_on(call: &Call<'_>, sphere: &Sphere, items: &[Item]) -> Result<(Vec<Fitted>, ManyReport)> {
    let fitted = Mutex::new(Vec::new());
    let keep = |one| fitted.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(one);
    let read = |number: usize| read_target(&items[number].input, sphere, call.cli.strict, &call.console);
    let done = |number: usize, fit: Fit| -> Result<()> {
        let item = &items[number];
        call.warn_of(item, &fit);
        item.write(call.cli, sphere, &fit)?;
        keep((number, Fitted::new(item, fit.report)));
        Ok(())
    };
    let report = fit_many(sphere, items.len(), &read, call.params, &done, call.monitor);
    let report = report.map_err(|error| call.explain(error))?;
    let mut fitted = fitted.into_inner().unwrap_or_else(std::sync::PoisonError::into_inner);
    fitted.sort_by_key(|(number, _)| *number);
    Ok((fitted.into_iter().map(|(_, fitted)| fitted).collect(), report))
}

/// Makes the folder of a file that is going to be written.
fn make_folder_of(path: &Path) -> Result<()> {
    match path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        Some(folder) => std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display())),
        None => Ok(()),
    }
}
