//! Lists the surfaces in a folder.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use spharm::parametrize::volume::is_volume;
use spharm_surface::io::{FORMATS, is_named_mesh, is_named_signal};

use crate::error::CohortError;
use crate::manifest::{Row, check_id};
use crate::origin::Origin;

/// Extensions of the names of volumes and other inputs, whose formats aren't in [`FORMATS`].
const OTHER_ENDINGS: [&str; 9] =
    [".nii", ".moments", ".nrrd", ".nhdr", ".ome.tif", ".ome.tiff", ".tif", ".tiff", ".npy"];

/// Lists the surfaces in a folder as rows, in natural order: `cell.2.ply` comes before `cell.10.ply`.
///
/// A row is made for each mesh and each volume (NIfTI, NRRD, TIFF) whose name has the extension of its format; its id
/// is the name without the extension. A volume's name doesn't show whether it holds labels or an image, so images get
/// rows, too. Folders within the folder aren't searched. The following files are skipped:
///
/// - hidden files and broken links
/// - spheres, such as the spheres that a run writes (`a.sphere.surf.gii`)
/// - repaired and cut surfaces beside such a sphere (`a.fixed.surf.gii`, `a.cut.surf.gii`)
/// - surfaces extracted from labels, beside such a sphere (`a.surf.gii`, if the sphere's metadata name a label)
/// - files whose names may be those of values on vertices (`.gii` alone, `.mgz`)
/// - files without the extension of a format (FreeSurfer's `lh.pial`)
///
/// Surfaces in skipped files can be listed in a table instead.
///
/// # Errors
///
/// [`CohortError::Io`] if the folder can't be read, [`CohortError::NoSurfaces`] if it has no surfaces, and
/// [`CohortError::FileId`] if a name can't be an id, or if two ids are equal or differ only in case, which some file
/// systems ignore.
pub fn rows_of_folder(folder: impl AsRef<Path>) -> Result<Vec<Row>, CohortError> {
    let folder = folder.as_ref();
    let (paths, _) = files_of(folder, is_named_surface)?;
    if paths.is_empty() {
        return Err(CohortError::NoSurfaces { path: folder.to_owned() });
    }
    let mut rows: Vec<Row> = Vec::with_capacity(paths.len());
    let mut first: HashMap<String, usize> = HashMap::with_capacity(paths.len());
    for surface in paths {
        let id = file_stem(&surface).to_string_lossy().into_owned();
        let same = first.insert(id.to_lowercase(), rows.len());
        let same = same.map(|same| format!("{} has the same id", rows[same].surface.display()));
        let unreadable = surface.file_name().and_then(|name| name.to_str()).is_none().then_some("a name in UTF-8");
        let invalid = unreadable.or(check_id(&id).err()).map(|valid| format!("expected {valid}"));
        if let Some(problem) = invalid.or(same) {
            return Err(CohortError::FileId { path: surface, id, problem });
        }
        rows.push(Row { id, surface, ..Row::default() });
    }
    Ok(rows)
}

/// The meshes in a folder, and the numbers of its other files.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FolderMeshes {
    /// Paths of the meshes, in natural order.
    pub meshes: Vec<PathBuf>,
    /// Number of the other files, except hidden ones.
    pub others: usize,
    /// Number of volumes among the other files. NumPy arrays aren't counted, because they may hold any values.
    pub volumes: usize,
}

/// Lists the meshes in a folder, and counts the other files. The meshes are those that [`rows_of_folder`] lists, except
/// the files `used`, such as the sphere over which the meshes are fitted.
///
/// # Errors
///
/// [`CohortError::Io`] if the folder can't be read, and [`CohortError::NoMeshes`] if it has no meshes.
pub fn meshes_of_folder(folder: impl AsRef<Path>, used: &[&Path]) -> Result<FolderMeshes, CohortError> {
    let folder = folder.as_ref();
    let used: Vec<PathBuf> = used.iter().filter_map(|path| path.canonicalize().ok()).collect();
    let is_used = |path: &Path| path.canonicalize().is_ok_and(|path| used.contains(&path));
    let (meshes, others) = files_of(folder, |path| is_named_surface(path) && is_named_mesh(path) && !is_used(path))?;
    let volumes = others.iter().filter(|path| is_named_volume(path)).count();
    if meshes.is_empty() {
        return Err(CohortError::NoMeshes { path: folder.to_owned(), volumes });
    }
    Ok(FolderMeshes { meshes, others: others.len(), volumes })
}

/// Returns the files in a folder for which `wanted` returns true, in natural order, and the other files, except hidden
/// ones.
fn files_of(folder: &Path, wanted: impl Fn(&Path) -> bool) -> Result<(Vec<PathBuf>, Vec<PathBuf>), CohortError> {
    let failed = |source| CohortError::Io { path: folder.to_owned(), action: "read the folder", source };
    let (mut paths, mut others) = (Vec::new(), Vec::new());
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        let (path, hidden) = (entry.path(), entry.file_name().to_string_lossy().starts_with('.'));
        if !path.is_file() {
            continue;
        }
        if wanted(&path) {
            paths.push(path);
        } else if !hidden {
            others.push(path);
        }
    }
    alphanumeric_sort::sort_path_slice(&mut paths);
    Ok((paths, others))
}

/// Returns whether a file's name implies a mesh or a label volume, rather than a sphere, a signal or something else.
fn is_named_surface(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let given = !name.starts_with('.') && !is_named_sphere(&name) && !is_named_signal(path) && !is_output(path);
    given && (is_named_mesh(path) || is_named_volume(path))
}

/// Returns whether a file has the extension of a volume's format, other than that of NumPy arrays.
fn is_named_volume(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    is_volume(path) && !name.ends_with(".npy") && !name.ends_with(".npy.gz")
}

/// Returns whether a file is a surface that a run wrote: the sphere of its model is beside it, and the surface was
/// repaired, cut, or extracted from a label.
fn is_output(path: &Path) -> bool {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let sphere = |model: &str| path.with_file_name(format!("{model}.sphere.surf.gii"));
    let changed = [".fixed.surf.gii", ".cut.surf.gii"].iter().find_map(|ending| name.strip_suffix(*ending));
    let of_label = |model| Origin::of_file(&sphere(model)).is_some_and(|origin| origin.is_of_label());
    changed.is_some_and(|model| sphere(model).exists()) || name.strip_suffix(".surf.gii").is_some_and(of_label)
}

/// Returns whether a file's name, in lower case, has `sphere` as one of the words between dots, hyphens and
/// underscores.
#[must_use]
pub fn is_named_sphere(name: &str) -> bool {
    name.split(['.', '-', '_']).any(|word| word == "sphere")
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
    // Both `.surf.gii` and `.gii` are extensions; the longest match is removed.
    let length = endings.map(|ending| unpacked.len() - ending.len()).min().unwrap_or(name.len());
    // Each call of `Path::file_stem` removes the last dot and the text after it, so an extension with n dots needs n
    // calls.
    let dots = name.get(length..).unwrap_or_default().matches('.').count();
    let mut exact = PathBuf::from(path.file_name().unwrap_or_default());
    (0..dots).for_each(|_| exact = PathBuf::from(exact.file_stem().unwrap_or_default()));
    exact.into_os_string()
}

#[cfg(test)]
mod tests {
    use spharm::FileRecord;
    use spharm::io::{WriteOptions, write_mesh};
    use spharm::parametrize::CaldParams;
    use spharm_surface::generate::icosphere;

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
            "c.fixed.surf.gii",
            "c.cut.surf.gii",
            "left_hemisphere.stl",
            "thickness.shape.gii",
            "lh.thickness.mgz",
            "lh.pial",
            "array.npy",
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
        assert_eq!(ids, ["b", "c", "cell.2", "cell.10", "d", "left_hemisphere", "x"]);
        assert_eq!(rows[2].surface, folder.path().join("cell.2.ply"));
        let found = meshes_of_folder(folder.path(), &[]).unwrap();
        let stems: Vec<OsString> = found.meshes.iter().map(|path| file_stem(path)).collect();
        assert_eq!(stems, ["b", "c", "cell.2", "cell.10", "left_hemisphere", "x"]);
        // The other files are all files except the meshes and the hidden file.
        assert_eq!(found.others, names.len() - found.meshes.len() - 1);
        let used = [folder.path().join("./b.surf.gii"), folder.path().join("missing.ply")];
        let without = meshes_of_folder(folder.path(), &[&used[0], &used[1]]).unwrap();
        assert_eq!((without.meshes.as_slice(), without.others), (&found.meshes[1..], found.others + 1));
        std::fs::write(folder.path().join("B.ply"), "").unwrap();
        let error = rows_of_folder(folder.path()).unwrap_err().to_string();
        assert!(error.contains("b.surf.gii") && error.contains("B.ply"), "{error}");
    }

    #[test]
    fn surfaces_of_labels_are_outputs() {
        let folder = tempfile::tempdir().unwrap();
        for (name, label) in [("label", Some(17)), ("mesh", None)] {
            let input = FileRecord { blake3: "ab".repeat(32), label, ..FileRecord::default() };
            let mut mesh = icosphere(0);
            Origin::new(&input, &CaldParams::for_degree(8), false).write_to(&mut mesh.meta);
            for ending in ["surf.gii", "sphere.surf.gii"] {
                write_mesh(folder.path().join(format!("{name}.{ending}")), &mesh, &WriteOptions::default()).unwrap();
            }
        }
        let found = meshes_of_folder(folder.path(), &[]).unwrap();
        assert_eq!((found.meshes, found.others), (vec![folder.path().join("mesh.surf.gii")], 3));
    }

    #[test]
    fn folders_without_surfaces_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("ages.csv"), "").unwrap();
        assert!(matches!(rows_of_folder(folder.path()), Err(CohortError::NoSurfaces { .. })));
        let error = meshes_of_folder(folder.path(), &[]).unwrap_err().to_string();
        assert!(error.contains("the folder has no meshes") && !error.contains("spharm volumes"), "{error}");
        for name in ["a.nii.gz", "b.mgz", "c.npy"] {
            std::fs::write(folder.path().join(name), "").unwrap();
        }
        let error = meshes_of_folder(folder.path(), &[]).unwrap_err().to_string();
        let expected = format!("; `spharm volumes {}` fits the 2 volumes in it", folder.path().display());
        assert!(error.ends_with(&expected), "{error}");
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
