//! One surface to fit, its outputs, and the decision about existing ones.

use std::path::PathBuf;

use spharm::{FileRecord, FitParams, Silent, Sphere};

use super::error::RunError;
use super::event::{Event, Observer};
use super::params::RunParams;
use crate::Row;
use crate::files::{ModelFiles, Replace};
use crate::reader::SurfaceReader;
use crate::rerun::{Decision, Request};

/// One surface to fit and the location of its model.
pub(super) struct Item {
    pub(super) files: ModelFiles,
    /// Record of the input's file, for the model's provenance.
    pub(super) record: FileRecord,
    /// The file of the region whose vertices are read, if not all are.
    pub(super) region: Option<FileRecord>,
    /// Which existing outputs are replaced.
    pub(super) replace: Replace,
}

impl Item {
    /// Decides what to do about a row; `None` if its model exists. `record` is that of its file, `sphere` is the sphere
    /// of the fit, unless it is mapped to one of its own.
    pub(super) fn decide(
        row: &Row,
        model: PathBuf,
        record: FileRecord,
        sphere: Option<&Sphere>,
        params: &FitParams,
        options: &RunParams,
        observer: &dyn Observer,
    ) -> Result<Option<Self>, RunError> {
        let files = ModelFiles { model };
        let beside = [
            options.coefficients_csv.then(|| files.csv()),
            params.standard_errors.then(|| files.standard_errors()),
            sphere.is_none().then(|| files.sphere()),
            record.label.map(|_| files.surface()),
            options.evaluate.as_ref().map(|evaluate| evaluate.file(&files)),
            // A surface without handles has no such file, even if it is finished.
            (options.preparation.cut_handles && !options.if_exists.keeps()).then(|| files.cut_surface()),
            // Nor does a mesh without anything to repair.
            (options.preparation.fix && record.label.is_none() && !options.if_exists.keeps())
                .then(|| files.fixed_surface()),
        ];
        let beside: Vec<PathBuf> = beside.into_iter().flatten().collect();
        // Its inputs are never replaced.
        let inputs =
            [Some(&row.surface), row.sphere.as_ref(), row.weights.as_ref(), row.region.as_ref(), options.mask.as_ref()];
        let inputs = inputs.into_iter().flatten().map(PathBuf::as_path);
        let outputs = std::iter::once(&files.model).chain(&beside).map(PathBuf::as_path);
        if let Some(path) = spharm_files::first_input(inputs, outputs) {
            return Err(RunError::OutputIsInput { path: path.to_owned() });
        }
        let region = row.region.as_deref().map(FileRecord::of).transpose()?;
        let request = Request {
            id: id(row),
            input: &record,
            region: region.as_ref(),
            sphere,
            params,
            preparation: options.preparation.of(sphere.is_some(), record.label),
            output: &files.model,
            beside: &beside,
            if_exists: options.if_exists,
        };
        // Only called if the model was made without repairs or cuts that are now requested.
        let read = || SurfaceReader::new(options.preparation).read(&row.surface, record.label, &Silent);
        let is_sound = || read().is_ok_and(|input| input.changes(options.preparation.cut_handles).is_empty());
        match request.decide_by(&is_sound)? {
            Decision::Skip => Ok(None),
            Decision::Fit { replace, replaces } => {
                if let Some(other) = replaces {
                    let text = format!("{}: replaces the model of {other}", files.model.display());
                    observer.event(&Event::Warning(&text));
                }
                Ok(Some(Self { files, record, region, replace }))
            }
        }
    }
}

/// Returns the id for a model's provenance, if the row is from a table.
pub(super) fn id(row: &Row) -> Option<&str> {
    (row.line > 0).then_some(row.id.as_str())
}
