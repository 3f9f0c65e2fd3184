//! Surfaces that come without a sphere: each is mapped to one first, which is kept beside its model.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use spharm_cli::console::Console;
use spharm_cli::exit::leave_if_cancelled;
use spharm_cli::output::refuse_existing;
use spharm_harmonics::Directions;
use spharm_parametrize::{CaldParams, Report, auto};
use spharm_surface::Sphere;
use spharm_surface::io::{WriteOptions, read_mesh, write_mesh};

use super::Cli;
use super::outputs::Item;
use crate::stages::shown;

/// Root mean square of the log area ratio that a map may have for the sake of the fit over it.
const AREA: f64 = 0.25;

/// `NAME.sphere.surf.gii` beside `NAME.spharm.npz`.
pub(crate) fn sphere_of(output: &Path) -> PathBuf {
    let name = output.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = name.strip_suffix(".npz").unwrap_or(&name);
    output.with_file_name(format!("{}.sphere.surf.gii", stem.strip_suffix(".spharm").unwrap_or(stem)))
}

/// Refuses spheres that would be overwritten unasked.
pub(crate) fn refuse(cli: &Cli, items: &[Item]) -> Result<()> {
    items.iter().try_for_each(|item| refuse_existing(&sphere_of(&item.output), cli.force, "sphere", "--output"))
}

/// Maps one surface to the sphere, writes the sphere, and says what it did.
pub(crate) fn parametrize(cli: &Cli, item: &Item, console: &Console) -> Result<(Sphere, Report)> {
    let mesh = read_mesh(&item.input)?;
    let mut show = shown(console);
    let mut progress = |event| {
        leave_if_cancelled();
        show(event);
    };
    let params = CaldParams { area: AREA, degree: Some(cli.max_degree), ..CaldParams::default() };
    let found = auto(&mesh, &params, &mut progress).with_context(|| item.input.display().to_string())?;
    drop(show);
    let path = sphere_of(&item.output);
    if let Some(folder) = path.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display()))?;
    }
    write_mesh(&path, &found.sphere, &WriteOptions { overwrite: cli.force, double: true })?;
    let report = found.report;
    console.note(format!(
        "{}: no --sphere; mapped by {} in {:.1} s, log area ratio {:.3} rms, to {}",
        item.input.display(),
        report.method,
        report.seconds,
        report.quality.area_rms,
        path.display()
    ));
    report.notes.iter().for_each(|note| console.note(note));
    let directions = Directions::from_vertices(&found.sphere.vertices).with_context(|| path.display().to_string())?;
    let sphere = Sphere { path: Some(path), faces: found.sphere.faces, ..Sphere::from_directions(directions) };
    Ok((sphere, report))
}
