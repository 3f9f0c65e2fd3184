//! Removes files that don't belong to a study any more: files of removed subjects and tests, models of subjects whose
//! fits fail, damaged models, and temporary files of killed processes. Only files made by the study itself are removed.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use spharm::Model;
use spharm_cli::inputs::MOST_OWN;
use spharm_cohort::files::ModelFiles;
use spharm_cohort::{Merged, Row, check_id};
use spharm_surface::io::{remove_leftovers, write_new};

use super::fits::{Fits, SIGNALS, SIGNALS_FOLDER};
use super::plan::{PLAIN, Plan};
use super::stage::{Stage, retire};

/// Removes the temporary files of processes that were killed.
pub(super) fn leftovers(plan: &Plan) {
    let mut folders = vec![plan.output.clone(), plan.records()];
    folders.extend(["warnings", "reports"].map(|name| plan.records().join(name)));
    folders.extend(plan.fits().into_iter().flat_map(|fits| [fits.models, fits.status]));
    folders.push(plan.mirrored_signals());
    folders.extend(["aligned", "figures", "quality", PLAIN].map(|name| plan.output.join(name)));
    folders.extend(["", "places", "members"].map(|name| plan.output.join("group").join(name)));
    folders.extend(plan.study.test.iter().map(|test| plan.test_folder(test)));
    // Ignore errors: leftovers that can't be listed or removed do no harm.
    folders.iter().for_each(|folder| drop(remove_leftovers(folder)));
}

/// Removes damaged models of these rows: models that the study made but that can't be read. The study then makes them
/// again. Returns the ids of the removed models.
pub(super) fn damaged<'a>(
    fits: &Fits<'_>,
    rows: impl Iterator<Item = &'a Row>,
    merged: &Merged,
) -> Result<Vec<&'a str>> {
    let mut removed = Vec::new();
    for row in rows.filter(|row| merged.entry(&row.id).is_some()) {
        let model = fits.model(&row.id);
        if model.is_file() && Model::read(&model).is_err() {
            std::fs::remove_file(&model).with_context(|| model.display().to_string())?;
            removed.push(row.id.as_str());
        }
    }
    Ok(removed)
}

/// Removes the models of subjects that were removed from the table, and of subjects whose files exist but can't be
/// fitted. Returns the number of models removed. If a subject's file doesn't exist, the subject's model isn't part of
/// the group but is kept, because the file's disk may merely be unmounted.
pub(super) fn models(fits: &Fits<'_>) -> Result<usize> {
    let merged = fits.merged()?;
    let listed: HashSet<&str> = fits.manifest.rows.iter().map(|row| row.id.as_str()).collect();
    let gone: HashSet<&str> =
        merged.entries().iter().map(|entry| entry.id.as_str()).filter(|id| !listed.contains(id)).collect();
    let mut count = 0;
    let failed: HashSet<String> = fits.failed(&merged).into_iter().map(|(id, _)| id).collect();
    let there = |row: &&Row| {
        [Some(&row.surface), row.sphere.as_ref(), row.region.as_ref()].into_iter().flatten().all(|file| file.is_file())
    };
    let broken = fits.manifest.rows.iter().filter(|row| failed.contains(&row.id)).filter(there);
    for id in gone.iter().copied().chain(broken.map(|row| row.id.as_str())) {
        count += usize::from(model(&fits.models, id)?);
    }
    if !gone.is_empty() {
        for path in fits.status_files()? {
            forget(&path, &gone).with_context(|| path.display().to_string())?;
        }
    }
    Ok(count)
}

/// Removes the models of signals, and their outcomes, if signals were removed from the study. Returns the number of
/// models removed.
pub(super) fn signals(plan: &Plan) -> Result<usize> {
    let folder = plan.output.join(SIGNALS_FOLDER);
    let status = folder.join("status");
    if plan.signal_fits().is_some() || !status.is_dir() {
        return Ok(0);
    }
    let fits = Fits { name: SIGNALS, manifest: &plan.manifest, models: folder.clone(), status };
    let mut count = 0;
    for entry in fits.merged()?.entries() {
        count += usize::from(model(&folder, &entry.id)?);
    }
    for path in fits.status_files()? {
        std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
    }
    // `remove_dir` keeps folders that contain other files.
    [&fits.status, &folder].into_iter().for_each(|folder| drop(std::fs::remove_dir(folder)));
    Ok(count)
}

/// Removes a subject's model and the files next to the model, if the model records the subject's id.
fn model(folder: &Path, id: &str) -> Result<bool> {
    let files = ModelFiles { model: folder.join(format!("{id}.spharm.npz")) };
    let own = |model: Model| model.provenance.id.as_deref() == Some(id);
    if check_id(id).is_err() || !Model::read(&files.model).is_ok_and(own) {
        return Ok(false);
    }
    // Remove the model last: as long as it exists, an interrupted removal can be repeated.
    let beside = [files.csv(), files.standard_errors(), files.sphere(), files.surface(), files.cut_surface()];
    for path in beside.into_iter().chain([files.fixed_surface(), files.model]).filter(|path| path.is_file()) {
        std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
    }
    Ok(true)
}

/// Removes a file that an earlier run wrote, if the file exists.
pub(super) fn file(path: &Path) -> Result<()> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(error).with_context(|| path.display().to_string())
        }
        _ => Ok(()),
    }
}

/// Removes the rows with these ids from a status file, unless another process is writing to the file.
fn forget(path: &Path, gone: &HashSet<&str>) -> Result<()> {
    let text = spharm_files::read(path, MOST_OWN)?;
    let file = spharm_files::open(path)?;
    if file.try_lock().is_err() {
        return Ok(());
    }
    let mut reader =
        csv::ReaderBuilder::new().delimiter(b'\t').has_headers(false).flexible(true).from_reader(text.as_slice());
    let mut writer = csv::WriterBuilder::new().delimiter(b'\t').flexible(true).from_writer(Vec::new());
    let mut left_out = 0;
    for record in reader.byte_records() {
        let record = record?;
        match record.get(0).and_then(|id| std::str::from_utf8(id).ok()) {
            Some(id) if gone.contains(id) => left_out += 1,
            _ => writer.write_byte_record(&record)?,
        }
    }
    if left_out > 0 {
        let text = writer.into_inner()?;
        write_new(path, true, |out| out.write_all(&text))?;
    }
    Ok(())
}

/// Removes the outputs of stages that aren't part of the study any more, such as removed tests.
pub(super) fn stages(plan: &Plan, stages: &[Stage]) -> Result<()> {
    let records = plan.records();
    let read = || records.display().to_string();
    for entry in std::fs::read_dir(&records).with_context(read)? {
        let path: PathBuf = entry.with_context(read)?.path();
        let name = path.file_stem().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let is_record = path.extension().is_some_and(|ending| ending == "json");
        if is_record && !stages.iter().any(|stage| stage.name == name) {
            retire(&path, &plan.folder, &plan.output)?;
        }
    }
    Ok(())
}
