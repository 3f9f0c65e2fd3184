//! Finds the file of the surface to which a model was fitted, and whether the surface's handles were cut.

use std::path::{Path, PathBuf};

use spharm::parametrize::volume::is_volume;
use spharm::{FileRecord, Model};
use spharm_cohort::files::ModelFiles;

use crate::paths::shown;

/// Returns the file of the surface to which a model was fitted, or the reason why it can't be used: it is missing, or
/// has changed since the fit.
///
/// # Errors
///
/// The reason, for a message.
pub fn surface_file(model: &Model, path: &Path) -> Result<PathBuf, String> {
    let file = surface_path(model, path)?;
    let record = model.provenance.input.as_ref().filter(|record| Path::new(&record.path) == file);
    match record.map(|record| (record, FileRecord::of(&file))) {
        Some((record, Ok(found))) if !found.same_contents(record) => Err("the file has changed".to_owned()),
        Some((_, Err(error))) => Err(error.to_string()),
        _ => Ok(file),
    }
}

/// Returns the path of the file of the surface to which a model was fitted, or the reason why there is no such file.
/// The file may have changed since the fit.
///
/// # Errors
///
/// The reason, for a message.
pub fn surface_path(model: &Model, path: &Path) -> Result<PathBuf, String> {
    let record = model.provenance.input.as_ref().ok_or("the model doesn't record its input")?;
    let input = Path::new(&record.path);
    if record.label.is_some() || is_volume(input) {
        // The surface around a label of a volume is stored in a file next to the model.
        let beside = ModelFiles { model: path.to_owned() }.surface();
        let missing =
            || format!("the file is a volume, and its surface {} doesn't exist next to the model", shown(&beside));
        return if beside.exists() { Ok(beside) } else { Err(missing()) };
    }
    if input.is_file() { Ok(input.to_owned()) } else { Err("no such file".to_owned()) }
}

/// Returns a warning if the handles of a model's surface were cut.
#[must_use]
pub fn cut_handles(model: &Model) -> Option<&'static str> {
    let text = "handles were cut: the surface includes the caps that close the cuts";
    let seam = model.sphere.as_ref().is_some_and(|sphere| sphere.seam.is_some());
    (seam || model.provenance.handles.is_some()).then_some(text)
}
