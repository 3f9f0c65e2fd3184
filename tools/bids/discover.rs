//! Finds the surfaces of a dataset and their registered spheres.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use super::args::{Cli, Hemi, Surface};

/// A surface to fit, found in the dataset.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Found {
    /// The subject's label, without `sub-`.
    pub(super) subject: String,
    /// The session's label, if the subject has sessions.
    pub(super) session: Option<String>,
    pub(super) hemi: Hemi,
    pub(super) surface: Surface,
    pub(super) mesh: PathBuf,
    pub(super) sphere: PathBuf,
}

/// Surfaces found in a dataset, and surfaces that were requested but not found.
#[derive(Debug, Default)]
pub(super) struct Dataset {
    pub(super) found: Vec<Found>,
    /// For each missing surface, its id in status files and the reason why it is missing.
    pub(super) missing: Vec<(String, String)>,
}

/// Folder from which surfaces are read; the variant is the folder's format.
enum Source {
    /// GIfTI files with BIDS names, in `anat` folders.
    Derivative(PathBuf),
    /// A folder of FreeSurfer subjects.
    FreeSurfer(PathBuf),
}

/// Finds the requested surfaces of the requested subjects.
///
/// # Errors
///
/// If the dataset has no folder of surfaces, or no requested surface is found in any subject.
pub(super) fn discover(cli: &Cli) -> Result<Dataset> {
    let source = source(cli)?;
    let root = match &source {
        Source::Derivative(root) | Source::FreeSurfer(root) => root,
    };
    let subjects = subjects(cli, root)?;
    let mut dataset = Dataset::default();
    for subject in &subjects {
        let folders = match &source {
            Source::FreeSurfer(root) => vec![(None, root.join(format!("sub-{subject}")).join("surf"))],
            Source::Derivative(root) => anatomies(&root.join(format!("sub-{subject}")))?,
        };
        for &hemi in &cli.hemi {
            for &surface in &cli.surfaces {
                let before = dataset.found.len();
                for (session, folder) in &folders {
                    let pair = match source {
                        Source::FreeSurfer(_) => freesurfer(folder, hemi, surface),
                        Source::Derivative(_) => derivative(folder, subject, session.as_deref(), hemi, surface)?,
                    };
                    if let Some((mesh, sphere)) = pair {
                        let (subject, session) = (subject.clone(), session.clone());
                        dataset.found.push(Found { subject, session, hemi, surface, mesh, sphere });
                    }
                }
                if dataset.found.len() == before {
                    let wanted = format!("hemi-{} {}", hemi.label(), surface.name());
                    let id = format!("sub-{subject}_hemi-{}_{}", hemi.label(), surface.name());
                    dataset
                        .missing
                        .push((id, format!("sub-{subject}: found no surface {wanted} with a registered sphere")));
                }
            }
        }
    }
    if dataset.found.is_empty() {
        bail!(
            "{}: found no surface with a registered sphere for any of the {} subjects",
            root.display(),
            subjects.len()
        );
    }
    Ok(dataset)
}

fn source(cli: &Cli) -> Result<Source> {
    if let Some(folder) = &cli.freesurfer {
        if !folder.is_dir() {
            bail!("{}: expected FreeSurfer's SUBJECTS_DIR, but this isn't a folder", folder.display());
        }
        return Ok(Source::FreeSurfer(folder.clone()));
    }
    let at = |name: &str| cli.dataset.join(name);
    let derivatives = ["derivatives/smriprep", "derivatives/fmriprep"].map(at);
    let freesurfer = ["derivatives/freesurfer", "sourcedata/freesurfer"].map(at);
    if let Some(found) = derivatives.into_iter().find(|folder| has_surfaces(folder)) {
        return Ok(Source::Derivative(found));
    }
    match freesurfer.into_iter().find(|folder| folder.is_dir()) {
        Some(found) => Ok(Source::FreeSurfer(found)),
        None => bail!(
            "{}: expected surfaces in derivatives/smriprep, derivatives/fmriprep, derivatives/freesurfer or \
             sourcedata/freesurfer, found none of these folders; give another folder with --freesurfer",
            cli.dataset.display()
        ),
    }
}

/// Returns whether a derivative dataset contains a surface of any subject.
fn has_surfaces(folder: &Path) -> bool {
    let is_surface = |path: &PathBuf| path.to_string_lossy().ends_with(".surf.gii");
    let subjects = names(folder).unwrap_or_default();
    subjects.iter().filter(|name| name.starts_with("sub-")).any(|name| {
        let anatomies = anatomies(&folder.join(name)).unwrap_or_default();
        anatomies.iter().any(|(_, folder)| files(folder).unwrap_or_default().iter().any(is_surface))
    })
}

/// Returns the labels of the requested subjects, or of all subjects if none is requested.
fn subjects(cli: &Cli, root: &Path) -> Result<Vec<String>> {
    if cli.participant_label.is_empty() {
        let mut labels: Vec<String> = names(root)?
            .into_iter()
            .filter(|name| root.join(name).is_dir())
            .filter_map(|name| name.strip_prefix("sub-").map(str::to_owned))
            .collect();
        labels.sort_unstable();
        if labels.is_empty() {
            bail!("{}: expected folders named sub-LABEL, found none", root.display());
        }
        return Ok(labels);
    }
    let label = |text: &String| -> Result<String> {
        let label = text.strip_prefix("sub-").unwrap_or(text);
        if label.is_empty() || !label.chars().all(char::is_alphanumeric) {
            bail!("--participant-label: expected letters and digits, found {text:?}");
        }
        if !root.join(format!("sub-{label}")).is_dir() {
            bail!("{}: no folder sub-{label}", root.display());
        }
        Ok(label.to_owned())
    };
    cli.participant_label.iter().map(label).collect()
}

/// Returns the `anat` folders of a subject, each with the label of its session, if any.
fn anatomies(subject: &Path) -> Result<Vec<(Option<String>, PathBuf)>> {
    let mut folders = vec![(None, subject.join("anat"))];
    let mut sessions = names(subject)?;
    sessions.sort_unstable();
    for name in sessions {
        if let Some(label) = name.strip_prefix("ses-") {
            folders.push((Some(label.to_owned()), subject.join(&name).join("anat")));
        }
    }
    folders.retain(|(_, folder)| folder.is_dir());
    Ok(folders)
}

fn freesurfer(folder: &Path, hemi: Hemi, surface: Surface) -> Option<(PathBuf, PathBuf)> {
    // FreeSurfer's name of the surface halfway between white and pial is `graymid`. sMRIPrep adds this surface under
    // the name `midthickness`.
    let names: &[&str] = match surface {
        Surface::Midthickness => &["midthickness", "graymid"],
        other => &[other.name()],
    };
    let at = |name: &str| folder.join(format!("{}.{name}", hemi.prefix()));
    let mesh = names.iter().map(|name| at(name)).find(|path| path.is_file())?;
    Some((mesh, at("sphere.reg"))).filter(|(_, sphere)| sphere.is_file())
}

/// Finds a subject's surface in its native space (no `space` in the file's name), and its sphere registered to
/// fsaverage or fsLR.
fn derivative(
    folder: &Path,
    subject: &str,
    session: Option<&str>,
    hemi: Hemi,
    surface: Surface,
) -> Result<Option<(PathBuf, PathBuf)>> {
    let start = match session {
        Some(session) => format!("sub-{subject}_ses-{session}_"),
        None => format!("sub-{subject}_"),
    };
    let mut all = files(folder)?;
    all.sort_unstable();
    let entities = |path: &PathBuf| -> Option<Vec<String>> {
        let name = path.file_name()?.to_str()?.strip_suffix(".surf.gii")?;
        let parts: Vec<String> = name.strip_prefix(&start)?.split('_').map(str::to_owned).collect();
        parts.contains(&format!("hemi-{}", hemi.label())).then_some(parts)
    };
    let has = |parts: &[String], wanted: &str| parts.iter().any(|part| part == wanted);
    let any = |parts: &[String], key: &str| parts.iter().any(|part| part.starts_with(key));
    let is_mesh = |parts: &[String]| {
        parts.last().is_some_and(|suffix| suffix == surface.name()) && !any(parts, "space-") && !any(parts, "desc-")
    };
    let is_sphere = |parts: &[String], wanted: &[&str]| {
        parts.last().is_some_and(|suffix| suffix == "sphere") && wanted.iter().all(|w| has(parts, w))
    };
    let find =
        |test: &dyn Fn(&[String]) -> bool| all.iter().find(|path| entities(path).is_some_and(|parts| test(&parts)));
    let spheres: [&[&str]; 3] = [&["space-fsaverage", "desc-reg"], &["desc-reg"], &["space-fsLR", "desc-msmsulc"]];
    let sphere = spheres.iter().find_map(|wanted| find(&|parts| is_sphere(parts, wanted)));
    Ok(find(&is_mesh).cloned().zip(sphere.cloned()))
}

fn names(folder: &Path) -> Result<Vec<String>> {
    let read = || format!("{}: cannot read the folder", folder.display());
    let entries: Vec<_> = std::fs::read_dir(folder).with_context(read)?.collect::<Result<_, _>>().with_context(read)?;
    Ok(entries.iter().filter_map(|entry| entry.file_name().into_string().ok()).collect())
}

fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    Ok(names(folder)?.into_iter().map(|name| folder.join(name)).filter(|path| path.is_file()).collect())
}
