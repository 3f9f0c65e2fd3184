//! Reads the spheres at whose vertices `--evaluate-on` evaluates models: an icosphere, a file, or a subject's spheres.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm::{Model, Sphere};
use spharm_cli::console::Console;
use spharm_cli::freesurfer::{Hemi, other_hemisphere};
use spharm_cli::inputs::read_sphere;
use spharm_cli::memory::Memory;
use spharm_cohort::evaluate::Evaluate;

use super::args::{Cli, On};
use crate::rows::icosphere_within;

/// Reads the spheres that `on`, the value of `--evaluate-on`, selects.
pub(super) fn evaluate(cli: &Cli, on: &On, console: &Console) -> Result<Evaluate> {
    let budget = Memory { memory: cli.memory }.budget(cli.threads.count());
    let named = match on {
        On::Icosphere(subdivisions) => {
            let option = "freesurfer --evaluate-on icosphere:";
            let sphere = icosphere_within(budget, option, *subdivisions, cli.max_degree)?;
            return Ok(Evaluate { sphere, right: None, name: format!("ico{subdivisions}") });
        }
        On::Named(named) => named,
    };
    let Files { sphere, right, name } = files(cli, named)?;
    budget.check_inputs("freesurfer --evaluate-on", std::iter::once(&sphere).chain(&right).map(PathBuf::as_path))?;
    let read = |path: &PathBuf| -> Result<Sphere> {
        let sphere = read_sphere(path, cli.strict, console)?;
        let needed =
            Model::bytes_to_evaluate(sphere.directions.len() as u64, sphere.faces.len() as u64, 3, cli.max_degree);
        budget.check(format_args!("freesurfer --evaluate-on {}", path.display()), needed)?;
        Ok(sphere)
    };
    Ok(Evaluate { sphere: read(&sphere)?, right: right.as_ref().map(read).transpose()?, name })
}

/// Files of the spheres at whose vertices models are evaluated.
struct Files {
    sphere: PathBuf,
    /// Sphere of the right hemisphere; `None` if `sphere` is used for both hemispheres or only one hemisphere is
    /// fitted.
    right: Option<PathBuf>,
    /// Name that stands for the sphere in the names of output files.
    name: String,
}

/// Finds the spheres of both hemispheres. `named` is the file of one sphere, or the name of a subject. The other
/// hemisphere's sphere is expected in the folder of the given file. A subject such as fsaverage5 is searched for in
/// SUBJECTS_DIR and among FreeSurfer's own subjects.
fn files(cli: &Cli, named: &Path) -> Result<Files> {
    if named.is_file() {
        let Some((hemi, other)) = other_hemisphere(named) else {
            return Ok(Files { sphere: named.to_owned(), right: None, name: stem(named)? });
        };
        let absolute = std::path::absolute(named).with_context(|| named.display().to_string())?;
        let subject = absolute.parent().filter(|folder| folder.file_name().is_some_and(|name| name == "surf"));
        let name = match subject.and_then(Path::parent) {
            Some(subject) => stem(subject)?,
            None => of_both(&stem(named)?, hemi),
        };
        if cli.hemi.iter().any(|of| *of != hemi) && !other.is_file() {
            bail!(
                "--evaluate-on {}: expected the sphere of the other hemisphere next to this file, found no {}",
                named.display(),
                other.display()
            );
        }
        return Ok(of_hemispheres(cli, name, |of| if of == hemi { named.to_owned() } else { other.clone() }));
    }
    let own = std::env::var_os("FREESURFER_HOME").map(|home| Path::new(&home).join("subjects"));
    let folders: Vec<PathBuf> = std::iter::once(cli.subjects_dir.clone()).chain(own).collect();
    let at =
        |folder: &PathBuf, hemi: Hemi| folder.join(named).join("surf").join(format!("{}.{}", hemi.name(), cli.sphere));
    let found = folders.iter().find(|folder| cli.hemi.iter().all(|hemi| at(folder, *hemi).is_file()));
    let Some(folder) = found else {
        let places: Vec<String> = folders.iter().map(|folder| at(folder, cli.hemi[0]).display().to_string()).collect();
        let home = if folders.len() < 2 { "; FREESURFER_HOME is not set" } else { "" };
        bail!(
            "--evaluate-on {}: expected icosphere:N, the file of a sphere, or a subject; found no {}{home}",
            named.display(),
            places.join(", no ")
        );
    };
    Ok(of_hemispheres(cli, stem(named)?, |hemi| at(folder, hemi)))
}

/// Returns a file's name without the label of the hemisphere, such as `lh.`.
fn of_both(name: &str, hemi: Hemi) -> String {
    let rest = name.strip_prefix(hemi.name()).and_then(|rest| rest.strip_prefix('.'));
    rest.map_or_else(|| name.replacen(&format!("{}_", hemi.of_bids()), "", 1), str::to_owned)
}

/// Returns the sphere files of the hemispheres that are fitted. `sphere` returns the file for a hemisphere.
fn of_hemispheres(cli: &Cli, name: String, sphere: impl Fn(Hemi) -> PathBuf) -> Files {
    let has = |hemi| cli.hemi.contains(&hemi);
    let first = if has(Hemi::Lh) { Hemi::Lh } else { Hemi::Rh };
    let right = (has(Hemi::Lh) && has(Hemi::Rh)).then(|| sphere(Hemi::Rh));
    Files { sphere: sphere(first), right, name }
}

/// Returns a file's name without its extensions.
fn stem(path: &Path) -> Result<String> {
    let name = path.file_name().and_then(|name| name.to_str());
    let name = name.with_context(|| format!("{}: expected a name in UTF-8", path.display()))?;
    Ok(name.trim_end_matches(".gii").trim_end_matches(".surf").to_owned())
}
