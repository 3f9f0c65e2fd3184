//! Lists the surfaces in a folder.

use std::ffi::OsString;
use std::path::{Path, PathBuf};

use spharm::parametrize::volume::is_volume;
use spharm_surface::io::{FORMATS, is_named_signal, mesh_format};

use crate::error::CohortError;
use crate::manifest::{Row, check_id};

/// Endings of the names of volumes and other inputs, whose formats aren't in [`FORMATS`].
const OTHER_ENDINGS: [&str; 9] =
    [".nii", ".moments", ".nrrd", ".nhdr", ".ome.tif", ".ome.tiff", ".tif", ".tiff", ".npy"];

/// Lists the surfaces in a folder as rows, in natural order: `cell.2.ply` comes before `cell.10.ply`.
///
/// A row is made for each mesh and each label volume whose name has the ending of its format; its id is the name
/// without the ending. Hidden files are skipped, as are files with `sphere` in their names, such as the spheres that a
/// run writes. Folders within the folder aren't searched.
///
/// # Errors
///
/// [`CohortError::Io`] if the folder can't be read, [`CohortError::NoSurfaces`] if it has no surfaces, and
/// [`CohortError::FileId`] if a name can't be an id or two files have the same id.
pub fn rows_of_folder(folder: impl AsRef<Path>) -> Result<Vec<Row>, CohortError> {
    let folder = folder.as_ref();
    let failed = |source| CohortError::Io { path: folder.to_owned(), action: "read the folder", source };
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if is_named_surface(&path) && path.is_file() {
            paths.push(path);
        }
    }
    if paths.is_empty() {
        return Err(CohortError::NoSurfaces { path: folder.to_owned() });
    }
    alphanumeric_sort::sort_path_slice(&mut paths);
    let mut rows: Vec<Row> = Vec::with_capacity(paths.len());
    for surface in paths {
        let id = file_stem(&surface).to_string_lossy().into_owned();
        let same = rows.iter().find(|row| row.id == id).map(|row| format!("{} has it, too", row.surface.display()));
        let invalid = check_id(&id).err().map(|valid| format!("expected {valid}"));
        if let Some(problem) = same.or(invalid) {
            return Err(CohortError::FileId { path: surface, id, problem });
        }
        rows.push(Row { id, surface, ..Row::default() });
    }
    Ok(rows)
}

/// Returns whether a file's name implies a mesh or a label volume, rather than a sphere, a signal or something else.
fn is_named_surface(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let mesh = mesh_format(path).is_some_and(|format| !format.hemisphere_prefix) && !is_named_signal(path);
    !name.starts_with('.') && !name.contains("sphere") && (mesh || is_volume(path))
}

/// Returns the name of an input without folder and format, with the exact bytes, for use in file names:
/// `lh.pial.surf.gii` becomes `lh.pial`.
#[must_use]
pub fn file_stem(path: &Path) -> OsString {
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let lower = name.to_ascii_lowercase();
    let unpacked = lower.strip_suffix(".gz").unwrap_or(&lower);
    let proper = FORMATS.iter().filter(|format| !format.hemisphere_prefix).flat_map(|format| format.endings);
    let endings =
        proper.chain(&OTHER_ENDINGS).filter(|ending| unpacked.ends_with(**ending) && unpacked.len() > ending.len());
    // Both `.surf.gii` and `.gii` are endings; the longest match is removed.
    let length = endings.map(|ending| unpacked.len() - ending.len()).min().unwrap_or(name.len());
    // Each call of `Path::file_stem` removes the last dot and what follows it, so an ending with n dots takes n calls.
    let dots = name.get(length..).unwrap_or_default().matches('.').count();
    let mut exact = PathBuf::from(path.file_name().unwrap_or_default());
    (0..dots).for_each(|_| exact = PathBuf::from(exact.file_stem().unwrap_or_default()));
    exact.into_os_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn surfaces_are_listed_in_natural_order_without_spheres_and_signals() {
        let folder = tempfile::tempdir().unwrap();
        let names = [
            "cell.10.ply",
            "cell.2.ply",
            "b.surf.gii",
            "c.STL.gz",
            "d.nii.gz",
            "x.vtu",
            "c.sphere.surf.gii",
            "thickness.shape.gii",
            "ages.csv",
            "cell.2.spharm.npz",
            ".hidden.ply",
            "lh.curv",
        ];
        for name in names {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        std::fs::create_dir(folder.path().join("folder.ply")).unwrap();
        let rows = rows_of_folder(folder.path()).unwrap();
        let ids: Vec<&str> = rows.iter().map(|row| row.id.as_str()).collect();
        assert_eq!(ids, ["b", "c", "cell.2", "cell.10", "d", "x"]);
        assert_eq!(rows[2].surface, folder.path().join("cell.2.ply"));
        std::fs::write(folder.path().join("b.ply"), "").unwrap();
        let error = rows_of_folder(folder.path()).unwrap_err().to_string();
        assert!(error.contains("b.surf.gii") && error.contains("b.ply"), "{error}");
    }

    #[test]
    fn folders_without_surfaces_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("ages.csv"), "").unwrap();
        assert!(matches!(rows_of_folder(folder.path()), Err(CohortError::NoSurfaces { .. })));
        let missing = folder.path().join("missing");
        assert!(matches!(rows_of_folder(&missing), Err(CohortError::Io { path, .. }) if path == missing));
    }

    #[test]
    fn stems_lose_the_format_only() {
        for (path, expected) in [
            ("a/lh.pial.surf.gii", "lh.pial"),
            ("fsaverage5.pial_left.gii.gz", "fsaverage5.pial_left"),
            ("lh.pial", "lh.pial"),
            ("HEAD.OBJ", "HEAD"),
            ("lh.thickness.fwhm10.mgz", "lh.thickness.fwhm10"),
            ("spot.obj.gz", "spot"),
            ("cells.nii.gz", "cells"),
            ("cells.ome.tif", "cells"),
            (".gii", ".gii"),
        ] {
            assert_eq!(file_stem(Path::new(path)), expected);
        }
    }
}
