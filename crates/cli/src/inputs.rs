//! Reads spheres, surfaces and signals from files, and checks them before any work starts.

use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm_cohort::file_stem;
use spharm_surface::{Sphere, Target};

use crate::console::Console;

/// Reads a sphere with [`spharm_surface::read_sphere`], and prints its warnings.
///
/// # Errors
///
/// The errors of [`spharm_surface::read_sphere`]; if `strict` is set, also an error if the sphere's centre isn't the
/// origin.
pub fn read_sphere(path: &Path, strict: bool, console: &Console) -> Result<Sphere> {
    Ok(spharm_cohort::run::read_sphere(path, strict, &|text| console.warn(text))?)
}

/// Reads a surface or a signal that belongs to a sphere with [`spharm_surface::read_target`], and prints its warnings.
///
/// # Errors
///
/// The errors of [`spharm_surface::read_target`]; if `strict` is set, also the first warning, as an error.
pub fn read_target(path: &Path, sphere: &Sphere, strict: bool, console: &Console) -> Result<Target> {
    let target = spharm_surface::read_target(path, sphere)?;
    for warning in &target.warnings {
        let text = format!("{}: {warning}", path.display());
        if strict {
            bail!("{text}");
        }
        console.warn(text);
    }
    Ok(target)
}

/// Maximum size in bytes of a file that lists paths; enough for a million long paths.
const LONGEST_LIST: u64 = 1 << 28;

/// Returns the paths with each `@list.txt` replaced by the paths that the file lists, one per line. Blank lines and
/// lines that begin with `#` are skipped; relative paths are relative to the list's folder.
///
/// # Errors
///
/// If a list can't be read or is empty.
pub fn expand_lists(paths: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let mut expanded = Vec::new();
    for path in paths {
        let Some(list) = path.to_str().and_then(|text| text.strip_prefix('@')) else {
            expanded.push(path.clone());
            continue;
        };
        let list = Path::new(list);
        if !list.is_file() {
            bail!("{}: this list of paths does not exist", list.display());
        }
        let text = read_text(list, "list", LONGEST_LIST)?;
        let base = list.parent().unwrap_or(Path::new(""));
        let lines = text.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with('#'));
        let before = expanded.len();
        expanded.extend(lines.map(|line| tidied(&base.join(line))));
        if expanded.len() == before {
            bail!("{}: the list contains no paths", list.display());
        }
    }
    Ok(expanded)
}

/// Removes each path whose absolute form equals that of an earlier path, such as `./a.npy` after `a.npy`. Links aren't
/// resolved.
pub fn keep_each_once(paths: &mut Vec<PathBuf>) {
    let mut seen = HashSet::new();
    paths.retain(|path| seen.insert(std::path::absolute(path).unwrap_or_else(|_| path.clone())));
}

/// Removes each `FOLDER/..` from a path, for display and records. If the shorter path can't be resolved or leads
/// elsewhere, because FOLDER is a link, the path is returned unchanged.
#[must_use]
pub fn tidied(path: &Path) -> PathBuf {
    let mut tidy = PathBuf::new();
    for component in path.components() {
        match component {
            Component::ParentDir if matches!(tidy.components().next_back(), Some(Component::Normal(_))) => {
                tidy.pop();
            }
            component => tidy.push(component),
        }
    }
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    if real(&tidy).is_some_and(|found| Some(found) == real(path)) { tidy } else { path.to_owned() }
}

/// Maximum size in bytes of a record, a report or a table that the program itself has written.
pub const MOST_OWN: u64 = 64 << 20;

/// Reads a text file of at most `most` bytes with [`spharm_files::read_text`]; `what` describes the file in messages.
///
/// # Errors
///
/// The errors of [`spharm_files::read_text`], with the path.
pub fn read_text(path: &Path, what: &str, most: u64) -> Result<String> {
    spharm_files::read_text(path, most).with_context(|| format!("{}: cannot read the {what}", path.display()))
}

/// Reads a list of warnings from a JSON file that another verb has written.
///
/// # Errors
///
/// If the file can't be read, or isn't a list of strings.
pub fn read_warnings(path: &Path) -> Result<Vec<String>> {
    let text = read_text(path, "list of warnings", MOST_OWN)?;
    serde_json::from_str(&text).with_context(|| format!("{}: expected a JSON list of strings", path.display()))
}

/// Returns the name of an input without its folder and the extension of its format, for display: `lh.pial.surf.gii`
/// becomes `lh.pial`.
#[must_use]
pub fn stem(path: &Path) -> String {
    file_stem(path).to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_may_begin_with_a_byte_order_mark() {
        let list = std::env::temp_dir().join(format!("spharm-list-{}.txt", std::process::id()));
        std::fs::write(&list, "\u{feff}a.ply\r\n# no\n\nb.ply\n").unwrap();
        let found = expand_lists(&[PathBuf::from(format!("@{}", list.display()))]);
        std::fs::remove_file(&list).unwrap();
        let names: Vec<_> = found.unwrap().iter().map(|path| path.file_name().unwrap().to_owned()).collect();
        assert_eq!(names, ["a.ply", "b.ply"]);
    }
}
