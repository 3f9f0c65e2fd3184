//! Expands lists and folders of inputs, and derives names from models' paths.

use std::collections::HashMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm_cohort::file_stem;
use spharm_cohort::files::ModelFiles;
pub use spharm_cohort::files::serialize_shown;

use crate::inputs::expand_lists;

/// Replaces each `@LIST` by the paths in the file LIST, and each folder by those of its files whose names end in
/// `ending`, sorted by name.
///
/// # Errors
///
/// If a list or a folder can't be read, or a folder has no file with this ending.
pub fn expand(paths: &[PathBuf], ending: &str) -> Result<Vec<PathBuf>> {
    expand_to(paths, ending, |_| true)
}

/// Expands paths as [`expand`] does, but of the files in a folder takes only those for which `take` returns true.
///
/// # Errors
///
/// The errors of [`expand`].
pub fn expand_to(paths: &[PathBuf], ending: &str, take: impl Fn(&Path) -> bool) -> Result<Vec<PathBuf>> {
    let mut expanded = Vec::new();
    for path in expand_lists(paths)? {
        if !path.is_dir() {
            expanded.push(path);
            continue;
        }
        let read = || format!("{}: cannot read the folder", path.display());
        let entries: Vec<_> =
            std::fs::read_dir(&path).with_context(read)?.collect::<Result<_, _>>().with_context(read)?;
        let named = |file: &PathBuf| file.to_string_lossy().to_ascii_lowercase().ends_with(ending) && file.is_file();
        let mut files: Vec<PathBuf> =
            entries.iter().map(std::fs::DirEntry::path).filter(named).filter(|file| take(file)).collect();
        if files.is_empty() {
            bail!("{}: the folder has no file ending in {ending}", path.display());
        }
        natural_order(&mut files);
        expanded.extend(files);
    }
    Ok(expanded)
}

/// Sorts paths in natural order: `seg.2` comes before `seg.10`.
pub fn natural_order(paths: &mut [PathBuf]) {
    alphanumeric_sort::sort_path_slice(paths);
}

/// Returns the name of a model without folder and extensions, for display: `models/lh.pial.spharm.npz` is `lh.pial`.
#[must_use]
pub fn model_name(model: &Path) -> String {
    model_file_name(model).to_string_lossy().into_owned()
}

/// Returns the name of each model as [`model_name`] does, for a table in which models are identified by their names.
/// `flag` is the option that requests the table.
///
/// # Errors
///
/// If two models have the same name.
pub fn distinct_names(models: &[PathBuf], flag: &str) -> Result<Vec<String>> {
    let names: Vec<String> = models.iter().map(|path| model_name(path)).collect();
    let mut paths = HashMap::new();
    for (name, path) in names.iter().zip(models) {
        if let Some(other) = paths.insert(name, path).filter(|other| *other != path) {
            bail!(
                "{flag}: expected models with different file names, found {name} for {} and {}; rename one of the files",
                other.display(),
                path.display()
            );
        }
    }
    Ok(names)
}

/// Returns the name of a model without folder and extensions, with the exact bytes, for use in file names.
#[must_use]
pub fn model_file_name(model: &Path) -> OsString {
    ModelFiles { model: file_stem(model).into() }.file_name()
}

/// Returns a path as text for reports. Bytes that aren't UTF-8 become U+FFFD, because JSON can't contain them.
#[must_use]
pub fn shown(path: impl AsRef<Path>) -> String {
    path.as_ref().display().to_string()
}

/// Returns several paths as text for reports, as [`shown`] does.
pub fn all_shown<P: AsRef<Path>>(paths: impl IntoIterator<Item = P>) -> Vec<String> {
    paths.into_iter().map(shown).collect()
}

/// Returns a path as text, for uses that require text, such as the arguments of another verb.
///
/// # Errors
///
/// If the path isn't UTF-8.
pub fn utf8(path: &Path) -> Result<&str> {
    path.to_str().with_context(|| format!("{}: expected a path in UTF-8", path.display()))
}

/// Appends an extension, given with or without its dot, to a name that may contain dots.
pub fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(".");
    path.push(ending.trim_start_matches('.'));
    PathBuf::from(path)
}
