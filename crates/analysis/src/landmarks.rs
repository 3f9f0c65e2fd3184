//! Finds the landmark files of models, matches the landmarks' names, and warns about implausible positions.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use spharm::Coefficients;
use spharm_cli::console::Console;
use spharm_cli::inputs::expand_lists;
use spharm_cli::output::first_of;
use spharm_cli::paths::model_name;
use spharm_harmonics::Directions;
use spharm_surface::generate::icosphere;
use spharm_surface::geometry::{Vec3, bounds, diagonal};
use spharm_surface::io::landmarks::{Landmarks, unit_factor, unit_hint};
use spharm_surface::{Mesh, Similarity};
use spharm_transform::synthesis;

/// Extensions of landmark files. An extension such as `.json` comes after a longer extension that ends with it, such as
/// `.mrk.json`.
const ENDINGS: [&str; 5] = [".mrk.json", ".fcsv", ".json", ".csv", ".tsv"];
/// Largest distance of a landmark from its surface, as a fraction of the surface's extent, that gives no warning.
const OFF: f64 = 0.05;

/// Corresponding landmarks of all models.
pub(super) struct Marks {
    pub(super) names: Vec<String>,
    /// Positions in the models' frames: for each model, one position per landmark name.
    pub(super) points: Vec<Vec<Vec3>>,
    pub(super) warnings: Vec<String>,
}

/// Reads the landmarks of models, if any are given. If `transforms` are given, they map the landmarks' frames to the
/// models' frames and are applied to the landmarks.
pub(super) fn of_models(
    named: &[PathBuf],
    models: &[PathBuf],
    members: &[Coefficients],
    transforms: Option<&[Similarity]>,
    console: &Console,
) -> Result<Option<Marks>> {
    if named.is_empty() {
        return Ok(None);
    }
    let sphere = icosphere(4);
    let directions = Directions::from_vertices(&sphere.vertices)?;
    let surface = |index: usize| -> Result<Mesh> {
        let values = synthesis(&directions, members[index].values().view())?;
        let mesh = sphere.with_vertices(values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect());
        Ok(match transforms {
            Some(all) => all[index].inverse().apply_mesh(&mesh),
            None => mesh,
        })
    };
    let mut marks = of_surfaces(named, models, surface)?;
    for (points, to_model) in marks.points.iter_mut().zip(transforms.unwrap_or_default()) {
        points.iter_mut().for_each(|point| *point = to_model.apply(*point));
    }
    marks.warnings.iter().for_each(|warning| console.warn(warning));
    Ok(Some(marks))
}

/// Reads the landmarks of surfaces from files named after the surfaces. Warnings are returned, not printed.
pub(super) fn of_surfaces(
    named: &[PathBuf],
    paths: &[PathBuf],
    surface: impl Fn(usize) -> Result<Mesh>,
) -> Result<Marks> {
    let files = files(named, paths)?;
    let mut warnings = Vec::new();
    let mut subjects = Vec::with_capacity(files.len());
    for (index, file) in files.iter().enumerate() {
        let (landmarks, said) = on_surface(file, &surface(index)?)?;
        warnings.extend(said);
        subjects.push(landmarks);
    }
    let matched = Landmarks::matched(&subjects);
    if matched.names.is_empty() {
        bail!("--landmarks: no landmark name occurs in all {} files{}", files.len(), differing(&files, &subjects));
    }
    warnings.extend(omitted(&files, &matched.alone));
    Ok(Marks { names: matched.names, points: matched.points, warnings })
}

/// Finds the file that is to blame if no landmark name occurs in all files: the first file without which the remaining
/// files have a name in common. Returns a description of this file, or an empty text if no such file exists.
fn differing(files: &[PathBuf], subjects: &[Landmarks]) -> String {
    let usual = |index: usize| {
        let others = subjects.iter().enumerate().filter(|(other, _)| *other != index);
        let names = Landmarks::matched(&others.map(|(_, own)| own.clone()).collect::<Vec<_>>()).names;
        (!names.is_empty()).then_some((index, names))
    };
    let Some((index, usual)) = (0..files.len()).find_map(usual) else { return String::new() };
    let plain = |name: &str| name.replace([' ', '-', '_'], "").to_lowercase();
    let own = &subjects[index].names;
    let near = own.iter().filter_map(|name| {
        let other = usual.iter().find(|other| plain(other) == plain(name))?;
        Some(format!("{name} instead of {other}"))
    });
    let near: Vec<String> = near.collect();
    let listed = |names: &[String]| first_of(names.iter().map(String::as_str), 5);
    let names = if near.is_empty() {
        format!("{}; the other files have {}", listed(own), listed(&usual))
    } else {
        listed(&near)
    };
    format!("; {} has {names}", files[index].display())
}

/// Returns warnings about landmarks that some files lack. For each file, `alone` lists the names that aren't common to
/// all files. If at least half of the files have a landmark, the files without the landmark are reported. Otherwise,
/// the files with the landmark are reported.
fn omitted(files: &[PathBuf], alone: &[Vec<String>]) -> Vec<String> {
    let mut counts: BTreeMap<&str, usize> = BTreeMap::new();
    alone.iter().flatten().for_each(|name| *counts.entry(name).or_default() += 1);
    let usual = |name: &str| counts.get(name).is_some_and(|count| 2 * count >= files.len());
    let mut warnings = Vec::new();
    for (file, own) in files.iter().zip(alone) {
        let lacks: Vec<&str> =
            counts.keys().copied().filter(|name| usual(name) && !own.iter().any(|of| of == name)).collect();
        if !lacks.is_empty() {
            let names = first_of(lacks, 5);
            warnings.push(format!("{}: lacks {names}; these landmarks are left out for all surfaces", file.display()));
        }
        let rare: Vec<&str> = own.iter().map(String::as_str).filter(|name| !usual(name)).collect();
        if !rare.is_empty() {
            let names = first_of(rare, 5);
            warnings.push(format!("{}: landmarks left out because other files lack them: {names}", file.display()));
        }
    }
    warnings
}

/// Reads one subject's landmarks in the frame of its surface. Returns the landmarks, and warnings about landmarks that
/// are far from the surface.
pub(super) fn on_surface(file: &Path, surface: &Mesh) -> Result<(Landmarks, Vec<String>)> {
    let mut warnings = Vec::new();
    let extent = diagonal(bounds(surface.vertices.iter().copied()));
    let placed = Landmarks::read(file)?.laid_on(surface);
    if placed.turned {
        warnings.push(format!(
            "{}: landmarks converted between LPS and RAS, so that they lie on the surface",
            file.display()
        ));
    }
    let far = |(name, distance): (&String, &f64)| (*distance > OFF * extent).then(|| format!("{name} ({distance:.3})"));
    let off: Vec<String> = placed.landmarks.names.iter().zip(&placed.distances).filter_map(far).collect();
    if !off.is_empty() {
        let off = first_of(off.iter().map(String::as_str), 5);
        let unit = unit_hint(unit_factor(&placed.landmarks.points, surface));
        warnings.push(format!("{}: landmarks far from the surface: {off}{unit}", file.display()));
    }
    Ok((placed.landmarks, warnings))
}

/// Returns the landmark file of each model.
fn files(named: &[PathBuf], models: &[PathBuf]) -> Result<Vec<PathBuf>> {
    if let [folder] = named
        && folder.is_dir()
    {
        return models.iter().map(|model| in_folder(folder, model)).collect();
    }
    let named = expand_lists(named)?;
    if named.len() != models.len() {
        bail!(
            "--landmarks: expected a folder, or a file for each of the {} models, found {} files",
            models.len(),
            named.len()
        );
    }
    Ok(named)
}

fn in_folder(folder: &Path, model: &Path) -> Result<PathBuf> {
    let name = model_name(model);
    let found = ENDINGS.iter().map(|ending| folder.join(format!("{name}{ending}"))).find(|path| path.exists());
    match found {
        Some(path) => Ok(path),
        None => bail!(
            "{}: no landmarks for {name}: expected a file named {name}, with one of the extensions {}",
            folder.display(),
            ENDINGS.join(", ")
        ),
    }
}
