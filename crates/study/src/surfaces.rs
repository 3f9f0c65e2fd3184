//! Makes the table of the meshes that are registered, with their landmarks and signals, and the list of landmark files.
//! The stages of the study read both files.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm_cli::paths::utf8;

use spharm_analysis::MIRRORED;

/// Row of a subject in the table of surfaces.
#[derive(Clone, Copy)]
pub(super) struct Member<'a> {
    pub(super) id: &'a str,
    pub(super) surface: &'a Path,
    /// Label in the volume; `None` for a mesh.
    pub(super) label: Option<i64>,
    pub(super) mirrored: bool,
    pub(super) landmarks: Option<&'a Path>,
    pub(super) signals: &'a [PathBuf],
}

/// Returns the name of the table's column for a signal, by the signal's index.
pub(super) fn signal_column(index: usize) -> String {
    format!("signal {}", index + 1)
}

/// Returns the text of the table for a file in `folder`: ids, meshes or volumes with their labels, landmarks and
/// signals. The text doesn't depend on the current folder.
///
/// # Errors
///
/// If a mesh doesn't exist, or its path isn't UTF-8.
pub(super) fn table(members: &[Member<'_>], folder: &Path) -> Result<String> {
    let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
    let landmarks = members.iter().any(|member| member.landmarks.is_some());
    let labels = members.iter().any(|member| member.label.is_some());
    let mirrored = members.iter().any(|member| member.mirrored);
    let columns = [(labels, "label"), (mirrored, MIRRORED), (landmarks, "landmarks")];
    let columns = columns.into_iter().filter(|(there, _)| *there).map(|(_, name)| name.to_owned());
    let signals = (0..members.first().map_or(0, |member| member.signals.len())).map(signal_column);
    writer.write_record(["id", "surface"].map(str::to_owned).into_iter().chain(columns).chain(signals))?;
    for &Member { id, surface, label, mirrored: is_mirrored, landmarks: marks, signals } in members {
        if !surface.is_file() {
            bail!("{id}: {}: no such file; method \"joint\" in [align] works without surfaces", surface.display());
        }
        let cell = |file: &Path| -> Result<String> { Ok(utf8(&from_folder(folder, file)?)?.to_owned()) };
        let label = labels.then(|| label.map(|label| label.to_string()).unwrap_or_default());
        let marks = marks.map(cell).transpose()?;
        let reflected = mirrored.then(|| if is_mirrored { "yes" } else { "no" }.to_owned());
        let cells = [Some(id.to_owned()), Some(cell(surface)?), label, reflected, marks];
        let signals = signals.iter().map(|file| cell(file)).collect::<Result<Vec<_>>>()?;
        writer.write_record(cells.into_iter().flatten().chain(signals))?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

/// Returns the text of the list of landmark files, for a file in `folder`.
///
/// # Errors
///
/// If the folder of a landmark file doesn't exist, or its path isn't UTF-8.
pub(super) fn landmarks(members: &[Member<'_>], folder: &Path) -> Result<String> {
    let files = members.iter().filter_map(|member| member.landmarks);
    files.map(|file| Ok(utf8(&from_folder(folder, file)?)?.to_owned() + "\n")).collect()
}

/// Returns the relative path from one folder to a file in another. Both folders must exist; links are resolved.
fn from_folder(folder: &Path, file: &Path) -> Result<PathBuf> {
    let real = |folder: &Path| {
        let folder = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
        folder.canonicalize().with_context(|| folder.display().to_string())
    };
    let (from, to) = (real(folder)?, real(file.parent().unwrap_or(Path::new("")))?);
    let name = file.file_name().unwrap_or_default();
    let shared = from.components().zip(to.components()).take_while(|(from, to)| from == to).count();
    if shared == 0 {
        return Ok(to.join(name));
    }
    let up: PathBuf = from.components().skip(shared).map(|_| "..").collect();
    Ok(up.join(to.components().skip(shared).collect::<PathBuf>()).join(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_lead_from_one_folder_to_another() {
        let site = tempfile::tempdir().unwrap();
        let at = |name: &str| site.path().join(name);
        std::fs::create_dir_all(at("out/.study")).unwrap();
        std::fs::create_dir_all(at("meshes")).unwrap();
        let found = from_folder(&at("out/.study"), &at("out/../meshes/a.ply")).unwrap();
        assert_eq!(found, Path::new("../../meshes/a.ply"));
        assert_eq!(from_folder(&at("out/.study"), &at("out/.study/b.ply")).unwrap(), Path::new("b.ply"));
        assert!(from_folder(&at("out/.study"), &at("nowhere/a.ply")).is_err());
    }
}
