//! Several inputs in one argument, lists and folders; names of what is made of them.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::inputs::{expand_lists, stem};

/// Replaces each `@LIST` by the paths that the file names and each folder by the files in it whose names end in `ending`,
/// sorted by name.
///
/// # Errors
///
/// When a list or a folder can't be read, or has no such file.
pub fn expand(paths: &[PathBuf], ending: &str) -> Result<Vec<PathBuf>> {
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
        let mut files: Vec<PathBuf> = entries.iter().map(std::fs::DirEntry::path).filter(named).collect();
        if files.is_empty() {
            bail!("{}: a folder without a file that ends in {ending}", path.display());
        }
        files.sort_unstable();
        expanded.extend(files);
    }
    Ok(expanded)
}

/// Returns the name of a model without folder and endings: `models/lh.pial.spharm.npz` is `lh.pial`.
pub fn model_name(model: &Path) -> String {
    let name = stem(model);
    let name = name.strip_suffix(".npz").unwrap_or(&name);
    name.strip_suffix(".spharm").unwrap_or(name).to_owned()
}

/// Adds an ending, with or without its dot, to a name that may have dots of its own.
pub fn with_ending(path: &Path, ending: &str) -> PathBuf {
    let mut path = path.as_os_str().to_owned();
    path.push(".");
    path.push(ending.trim_start_matches('.'));
    PathBuf::from(path)
}
