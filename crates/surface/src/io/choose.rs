//! Determines a file's format from its name or, failing that, from its first bytes.

use std::path::Path;

use super::flaw::shown;
use super::formats::FORMATS;
use super::load::{head, is_gzip};
use super::numpy;
use super::spec::FormatSpec;
use crate::error::SurfaceError;

/// The intended contents of an output file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output<'a> {
    /// A surface.
    Mesh,
    /// A surface whose vertices must keep their order: a sphere, or a surface that corresponds to a sphere.
    OrderedMesh,
    /// Values on vertices.
    Signal,
    /// A surface or values on vertices, if it isn't known yet which of the two will be written.
    Either,
    /// An output of one fixed format; its name must end in one of these lower-case extensions.
    Ending(&'a [&'a str]),
}

/// Checks, before any work, that the format implied by an output's name can hold the output.
///
/// Functions that write files make this check, too. Programs call this function for all outputs before they start their
/// work, so that an unsuitable name is reported at once.
///
/// # Errors
///
/// [`UnknownFormat`](SurfaceError::UnknownFormat) if the name implies no suitable format,
/// [`LosesOrder`](SurfaceError::LosesOrder) for an [`Output::OrderedMesh`] in a format such as STL.
pub fn check_output(path: impl AsRef<Path>, output: Output<'_>) -> Result<(), SurfaceError> {
    let path = path.as_ref();
    match output {
        Output::Mesh => to_write_mesh(path).map(drop),
        Output::OrderedMesh => match to_write_mesh(path)? {
            format if format.keeps_order => Ok(()),
            format => Err(SurfaceError::LosesOrder { path: path.to_owned(), format: format.name }),
        },
        Output::Signal => to_write_signal(path).map(drop),
        Output::Either => {
            to_write(path, |format| format.write_mesh.is_some() || format.write_signal.is_some()).map(drop)
        }
        Output::Ending(endings) if endings.iter().any(|ending| lower_name(path).ends_with(ending)) => Ok(()),
        Output::Ending(endings) => Err(no_format(path, format!("a name that ends in {}", endings.join(" or ")))),
    }
}

/// Returns the surface format implied by an output file's name.
///
/// # Errors
///
/// [`UnknownFormat`](SurfaceError::UnknownFormat) if the name implies no format for surfaces.
pub fn to_write_mesh(path: &Path) -> Result<&'static FormatSpec, SurfaceError> {
    to_write(path, |format| format.write_mesh.is_some())
}

/// Returns the signal format implied by an output file's name.
///
/// # Errors
///
/// [`UnknownFormat`](SurfaceError::UnknownFormat) if the name implies no format for signals.
pub fn to_write_signal(path: &Path) -> Result<&'static FormatSpec, SurfaceError> {
    to_write(path, |format| format.write_signal.is_some())
}

/// Returns the surface format whose extension a file's name has, or `None` if the name has no such extension. This
/// crate may support the format for reading only. The extension `.gii` is accepted, although such a file may hold
/// values instead. The prefixes `lh.` and `rh.` are ignored.
fn mesh_format(path: &Path) -> Option<&'static FormatSpec> {
    let name = name_without_gz(path);
    if [".func.gii", ".shape.gii"].iter().any(|ending| name.ends_with(ending)) {
        return None;
    }
    // Formats for values only can write signals but not meshes. All other formats are for surfaces.
    let for_meshes = |format: &&FormatSpec| format.write_mesh.is_some() || format.write_signal.is_none();
    FORMATS.iter().filter(for_meshes).find(|format| has_ending(format, &name))
}

/// Returns whether a file's name has the extension of a format for surfaces. FreeSurfer's extensions, such as `.orig`,
/// are ignored, because they are also common words.
#[must_use]
pub fn is_named_mesh(path: &Path) -> bool {
    mesh_format(path).is_some_and(|format| !format.hemisphere_prefix)
}

/// Returns whether a file's name implies values on vertices rather than a surface.
#[must_use]
pub fn is_named_signal(path: &Path) -> bool {
    let name = name_without_gz(path);
    let is_of =
        |holds: fn(&FormatSpec) -> bool| FORMATS.iter().any(|format| holds(format) && has_ending(format, &name));
    // The extension `.gii` alone is used for both surfaces and values. It is taken to mean values on vertices.
    is_of(|format| format.write_signal.is_some())
        && (name.ends_with(".gii") || !is_of(|format| format.write_mesh.is_some()))
        && !name.ends_with(".surf.gii")
}

/// Returns whether an existing file may hold values on vertices rather than a surface. The names of FreeSurfer's files
/// don't distinguish surfaces from values, so the first bytes of such a file are checked. Returns `false` for files
/// that can't be read.
#[must_use]
pub fn may_hold_signal(path: &Path) -> bool {
    if by_proper_ending(&name_without_gz(path)).is_some() {
        return is_named_signal(path);
    }
    let Ok(head) = head(path) else { return false };
    let format = FORMATS.iter().find(|format| (format.magic)(&head));
    // GIfTI files begin with the same bytes whether they hold a surface or values, so the result is `true` for both. It
    // is also `true` for gzipped files, which aren't unpacked here.
    let holds = |format: &FormatSpec| FORMATS.iter().any(|of| of.name == format.name && of.write_signal.is_some());
    is_gzip(&head) || numpy::is_array(&head) || format.is_some_and(holds)
}

fn to_write(path: &Path, holds: impl Fn(&FormatSpec) -> bool) -> Result<&'static FormatSpec, SurfaceError> {
    let name = name_without_gz(path);
    let holding = || FORMATS.iter().filter(|format| holds(format));
    let by_ending = || holding().find(|format| has_ending(format, &name));
    // The prefix matters only if no extension determines the format: `lh.pial.csv` is a table, which can't hold a
    // surface.
    let prefixed = ["lh.", "rh."].iter().any(|prefix| name.starts_with(prefix)) && by_proper_ending(&name).is_none();
    let by_prefix = || holding().find(|format| prefixed && format.hemisphere_prefix);
    by_ending().or_else(by_prefix).ok_or_else(|| {
        let mut endings: Vec<&str> = holding().flat_map(|format| format.endings).copied().collect();
        endings.sort_unstable();
        endings.dedup();
        no_format(path, format!("a name that ends in {}, or starts with lh. or rh. (FreeSurfer)", endings.join(", ")))
    })
}

/// Returns the format of an existing file. The extension determines the format. If the file has no known extension, or
/// one of FreeSurfer's extensions, which aren't unique, its first bytes determine the format.
pub(super) fn of_file(path: &Path, bytes: &[u8]) -> Result<&'static FormatSpec, SurfaceError> {
    let by_magic = || FORMATS.iter().find(|format| (format.magic)(bytes));
    let format = by_proper_ending(&name_without_gz(path)).or_else(by_magic);
    if bytes.is_empty() && format.is_none() {
        return Err(SurfaceError::EmptyFile { path: path.to_owned() });
    }
    format.ok_or_else(|| {
        let mut endings: Vec<&str> = proper().flat_map(|format| format.endings).copied().collect();
        endings.sort_unstable();
        endings.dedup();
        SurfaceError::UnknownFormat {
            path: path.to_owned(),
            expected: format!("a name that ends in {}, or a FreeSurfer surface or curv file", endings.join(", ")),
            found: format!("the file starts with {}", shown(bytes)),
        }
    })
}

/// Returns the formats that are identified by file extensions: all except FreeSurfer's surface and curv files.
fn proper() -> impl Iterator<Item = &'static FormatSpec> {
    FORMATS.iter().filter(|format| !format.hemisphere_prefix)
}

fn by_proper_ending(name: &str) -> Option<&'static FormatSpec> {
    proper().find(|format| has_ending(format, name))
}

fn has_ending(format: &FormatSpec, name: &str) -> bool {
    format.endings.iter().any(|ending| name.ends_with(ending))
}

fn no_format(path: &Path, expected: String) -> SurfaceError {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let found = format!("the name is {}", shown(name.as_bytes()));
    SurfaceError::UnknownFormat { path: path.to_owned(), expected, found }
}

fn lower_name(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// Returns a file's name in lower case, without the extension `.gz`.
pub(crate) fn name_without_gz(path: &Path) -> String {
    let name = lower_name(path);
    name.strip_suffix(".gz").unwrap_or(&name).to_owned()
}

/// Removes an extension, in upper or lower case, from a name. Returns `None` if the name doesn't have this extension.
pub(super) fn without_ending<'a>(name: &'a str, ending: &str) -> Option<&'a str> {
    let (stem, found) = name.split_at_checked(name.len().checked_sub(ending.len())?)?;
    found.eq_ignore_ascii_case(ending).then_some(stem)
}

/// Returns whether a file's name implies that the complete file is gzipped.
pub(super) fn is_gzipped(path: &Path) -> bool {
    let name = lower_name(path);
    [".gz", ".mgz"].iter().any(|ending| name.ends_with(ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_ask_for_formats() {
        let mesh = |name: &str| to_write_mesh(Path::new(name)).ok().map(|format| format.name);
        let signal = |name: &str| to_write_signal(Path::new(name)).ok().map(|format| format.name);
        assert_eq!(mesh("a.SURF.gii.gz"), Some("a GIfTI file"));
        assert_eq!(mesh("lh.smooth"), Some("a FreeSurfer surface"));
        assert_eq!(mesh("sub.pial"), Some("a FreeSurfer surface"));
        assert_eq!(mesh("lh.pial.csv"), None);
        assert_eq!((mesh("a.obj.gz"), mesh("a.npz"), mesh("a")), (Some("an OBJ file"), None, None));
        assert_eq!(signal("lh.anything"), Some("a FreeSurfer curv file"));
        assert_eq!(signal("lh.thickness.mgz"), Some("a FreeSurfer map"));
        assert_eq!((signal("a.ply"), signal("lh.ply"), signal("a.tsv")), (None, None, Some("a TSV table")));
    }

    #[test]
    fn surfaces_are_told_by_any_of_their_endings() {
        let is_mesh = |name: &str| mesh_format(Path::new(name)).is_some();
        for name in ["a.ply", "a.OBJ.gz", "a.surf.gii", "a.gii", "lh.pial", "a.vtu", "a.glb", "a.meta", "a.vrml"] {
            assert!(is_mesh(name), "{name}");
        }
        assert!(
            ["a.csv", "lh.curv", "a.mgz", "a.npz", "a.shape.gii", "a.func.gii.gz", "pial"]
                .iter()
                .all(|name| !is_mesh(name))
        );
    }

    #[test]
    fn names_tell_values_from_surfaces() {
        let signal = |name: &str| is_named_signal(Path::new(name));
        assert!(
            ["lh.thickness", "a.mgz", "a.csv", "a.func.gii", "a.shape.gii.gz", "a.gii"].iter().all(|name| signal(name))
        );
        assert!(["lh.pial", "a.surf.gii", "a.ply", "lh.other", "a.obj.gz"].iter().all(|name| !signal(name)));
    }

    #[test]
    fn first_bytes_tell_values_from_surfaces() {
        let folder = tempfile::tempdir().unwrap();
        for (name, bytes, signal) in [
            ("lh.thickness.fwhm10", &b"\xff\xff\xff\0"[..], true),
            ("lh.pial.curv", b"\xff\xff\xfe\n", false),
            ("lh.myelin.gz", b"\x1f\x8b", true),
            ("values", b"<?xml?><GIFTI>", true),
            ("a.npy", b"\x93NUMPY\x01\0", true),
            ("other", b"text", false),
            ("a.csv", b"", true),
            ("a.ply", b"ply", false),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, bytes).unwrap();
            assert_eq!(may_hold_signal(&path), signal, "{name}");
        }
        assert!(!may_hold_signal(&folder.path().join("lh.none")));
    }

    #[test]
    fn outputs_are_checked_before_any_work() {
        let error = check_output("a.stl", Output::OrderedMesh).unwrap_err();
        assert!(matches!(error, SurfaceError::LosesOrder { .. }), "{error}");
        check_output("a.stl", Output::Mesh).unwrap();
        check_output("a.PNG", Output::Ending(&[".png"])).unwrap();
        let error = check_output("a.jpg", Output::Ending(&[".png"])).unwrap_err();
        assert!(error.to_string().contains("a name that ends in .png"), "{error}");
    }
}
