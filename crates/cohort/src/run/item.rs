//! Describes one surface to fit and its outputs, and decides about existing outputs.

use std::path::PathBuf;

use spharm::{FileRecord, FitParams, Silent, Sphere};

use super::error::RunError;
use super::params::RunParams;
use crate::Row;
use crate::files::{ModelFiles, Replace};
use crate::reader::SurfaceReader;
use crate::rerun::{Decision, Request};

/// One surface to fit, and the paths of its outputs.
pub(super) struct Item {
    pub(super) files: ModelFiles,
    /// Record of the input's file, for the provenance of the model.
    pub(super) record: FileRecord,
    /// Record of the region's file, if a signal is read only within a region.
    pub(super) region: Option<FileRecord>,
    /// Existing outputs that the fit may replace.
    pub(super) replace: Replace,
    /// Input from which the model to be replaced was made, if it differs from the input of this fit.
    pub(super) replaces: Option<FileRecord>,
}

impl Item {
    /// Decides whether to fit a row. Returns `None` if the row's model exists and is kept. `record` is the record of
    /// the row's file. `sphere` is `None` if the surface is to be mapped to a sphere.
    pub(super) fn decide(
        row: &Row,
        model: PathBuf,
        record: FileRecord,
        sphere: Option<&Sphere>,
        params: &FitParams,
        options: &RunParams,
    ) -> Result<Option<Self>, RunError> {
        let files = ModelFiles { model };
        let repaired = options.preparation.fix || options.preparation.wrap.is_some();
        let beside = [
            ("the table of coefficients (--coefficients-csv)", options.coefficients_csv.then(|| files.csv())),
            ("the standard errors (--stderr)", params.standard_errors.then(|| files.standard_errors())),
            ("the sphere", sphere.is_none().then(|| files.sphere())),
            ("the surface of the label", record.label.map(|_| files.surface())),
            (
                "the values of the model on the sphere (--evaluate-on)",
                options.evaluate.as_ref().map(|evaluate| evaluate.file(&files)),
            ),
            // If existing models are kept, the cut surface need not exist, because a surface without handles has no
            // such file.
            (
                "the surface with its handles cut",
                (options.preparation.cut_handles && !options.if_exists.keeps()).then(|| files.cut_surface()),
            ),
            // If existing models are kept, the repaired mesh need not exist, because a mesh without defects has no such
            // file.
            (
                "the repaired surface",
                (repaired && record.label.is_none() && !options.if_exists.keeps()).then(|| files.fixed_surface()),
            ),
        ];
        let named = beside.into_iter().filter_map(|(what, file)| Some((what, file?)));
        let (names, beside): (Vec<&str>, Vec<PathBuf>) = named.unzip();
        // Outputs must never replace the inputs of the row.
        let inputs =
            [Some(&row.surface), row.sphere.as_ref(), row.weights.as_ref(), row.region.as_ref(), options.mask.as_ref()];
        let inputs = inputs.into_iter().flatten().map(PathBuf::as_path);
        let outputs = std::iter::once(&files.model).chain(&beside).map(PathBuf::as_path);
        if let Some(path) = spharm_files::first_input(inputs, outputs) {
            let what = beside.iter().position(|file| file == path).map_or("the model", |at| names[at]);
            return Err(RunError::OutputIsInput { path: path.to_owned(), what });
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
        // Read the surface to find out whether repairs and cuts would change it. The surface is read only if the
        // request has repairs or cuts that the existing model was made without.
        let read = || SurfaceReader::new(options.preparation).read(&row.surface, record.label, &Silent);
        let is_sound = || read().is_ok_and(|input| input.changes(options.preparation.cut_handles).is_empty());
        match request.decide_by(&is_sound)? {
            Decision::Skip => Ok(None),
            Decision::Fit { replace, replaces } => Ok(Some(Self { files, record, region, replace, replaces })),
        }
    }
}

/// Returns the row's id for the provenance of its model, or `None` if the row isn't from a table.
pub(super) fn id(row: &Row) -> Option<&str> {
    (row.line > 0).then_some(row.id.as_str())
}
