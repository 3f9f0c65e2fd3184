//! The meshes that subjects are registered by, with their landmarks, as the table and the list that stages read.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm::cohort::Row;
use spharm::files::ModelFiles;
use spharm::parametrize::volume::is_volume;
use spharm_cli::paths::utf8;

/// The mesh of a row: of a volume's label the one that its fit has written beside its model.
pub(super) fn of_row(row: &Row, model: &Path) -> PathBuf {
    match row.label.is_some() || is_volume(&row.surface) {
        true => ModelFiles { model: model.to_owned() }.surface(),
        false => row.surface.clone(),
    }
}

/// Text of the table, of ids, meshes and landmarks, for a file in `folder`: the same from whichever folder the study is
/// called.
///
/// # Errors
///
/// When a mesh isn't there, or its path isn't text.
pub(super) fn table(subjects: &[(&str, &Path, Option<&Path>)], folder: &Path) -> Result<String> {
    let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
    let landmarks = subjects.iter().any(|(.., landmarks)| landmarks.is_some());
    writer.write_record(["id", "surface"].into_iter().chain(landmarks.then_some("landmarks")))?;
    for &(id, surface, landmarks) in subjects {
        if !surface.is_file() {
            bail!(
                "{id}: {}: there is no such file; method \"joint\" in [align] needs the models alone",
                surface.display()
            );
        }
        let cell = |file: &Path| Ok(utf8(&from_folder(folder, file)?)?.to_owned());
        let cells = std::iter::once(surface).chain(landmarks).map(cell).collect::<Result<Vec<String>>>()?;
        writer.write_record(std::iter::once(id).chain(cells.iter().map(String::as_str)))?;
    }
    Ok(String::from_utf8(writer.into_inner()?)?)
}

/// Text of the list of the landmarks' files, for a file in `folder`.
///
/// # Errors
///
/// When one isn't there, or its path isn't text.
pub(super) fn landmarks(subjects: &[(&str, &Path, Option<&Path>)], folder: &Path) -> Result<String> {
    let files = subjects.iter().filter_map(|(.., landmarks)| *landmarks);
    files.map(|file| Ok(utf8(&from_folder(folder, file)?)?.to_owned() + "\n")).collect()
}

/// The path from one folder to a file in another, both of which are there, without their links.
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
