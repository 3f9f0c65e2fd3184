//! One surface to fit, the outputs that belong to it, and what becomes of those that exist.

use std::path::PathBuf;

use anyhow::Result;
use spharm::cohort::Row;
use spharm::files::{ModelFiles, Replace};
use spharm::rerun::{Decision, Request};
use spharm::{FileRecord, FitParams, Silent, Sphere};
use spharm_cli::console::Console;
use spharm_cli::output::check_not_inputs;

use super::options::Options;

/// One surface to fit and where its model goes.
pub(crate) struct Item {
    pub(super) files: ModelFiles,
    /// What the input is, for the model to record.
    pub(super) record: FileRecord,
    /// The file of the vertices whose values are read, if not all are.
    pub(super) region: Option<FileRecord>,
    /// Which outputs that exist are replaced.
    pub(super) replace: Replace,
}

impl Item {
    /// Decides what to do about a row; `None` where its model is there. `record` is its file's, `sphere` the one that
    /// it is fitted over, if not one of its own.
    pub(super) fn decide(
        row: &Row,
        model: PathBuf,
        record: FileRecord,
        sphere: Option<&Sphere>,
        params: &FitParams,
        options: &Options,
        console: &Console,
    ) -> Result<Option<Self>> {
        let files = ModelFiles { model };
        let beside = [
            options.coefficients_csv.then(|| files.csv()),
            params.standard_errors.then(|| files.standard_errors()),
            sphere.is_none().then(|| files.sphere()),
            record.label.map(|_| files.surface()),
            options.evaluate.as_ref().map(|evaluate| evaluate.file(&files)),
            // A surface without handles has none, and is finished all the same.
            (options.cut_handles && !options.if_exists.keeps()).then(|| files.cut_surface()),
            // Nor does a mesh in which there was nothing to mend.
            (options.fix && record.label.is_none() && !options.if_exists.keeps()).then(|| files.fixed_surface()),
        ];
        let beside: Vec<PathBuf> = beside.into_iter().flatten().collect();
        // Its inputs stay, whatever is replaced.
        let inputs =
            [Some(&row.surface), row.sphere.as_ref(), row.weights.as_ref(), row.region.as_ref(), options.mask.as_ref()];
        let outputs = std::iter::once(&files.model).chain(&beside).map(PathBuf::as_path);
        check_not_inputs(inputs.into_iter().flatten().map(PathBuf::as_path), outputs)?;
        let region = row.region.as_deref().map(FileRecord::of).transpose()?;
        let request = Request {
            id: id(row),
            input: &record,
            region: region.as_ref(),
            sphere,
            params,
            preparation: options.preparation(sphere.is_some(), record.label),
            output: &files.model,
            beside: &beside,
            if_exists: options.if_exists,
        };
        // Read only where its model was made without what is asked for now.
        let read = || options.reader().read(&row.surface, record.label, &Silent);
        let is_sound = || read().is_ok_and(|input| input.changes(options.cut_handles).is_empty());
        match request.decide_by(&is_sound)? {
            Decision::Skip => Ok(None),
            Decision::Fit { replace, replaces } => {
                if let Some(other) = replaces {
                    console.warn(format!("{}: replaces the model of {other}", files.model.display()));
                }
                Ok(Some(Self { files, record, region, replace }))
            }
        }
    }
}

/// The id that a model records: that of a row of a table.
pub(super) fn id(row: &Row) -> Option<&str> {
    (row.line > 0).then_some(row.id.as_str())
}
