//! Inputs and the outputs that belong to them; what would clash or overwrite is refused before any work.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::PathBuf;

use anyhow::Result;
use serde::Serialize;
use spharm::files::{ModelFiles, Replace};
use spharm::rerun::{Decision, IfExists, Request};
use spharm::{FileRecord, FitParams, Sphere};
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::names::model_files;
use spharm_cli::surfaces::SurfaceReader;

use super::args::Cli;

/// One surface to fit and where its model goes.
pub(super) struct Item {
    pub(super) input: PathBuf,
    pub(super) files: ModelFiles,
    /// What the input is, for the model to record.
    pub(super) record: FileRecord,
    /// Which outputs that exist are replaced.
    pub(super) replace: Replace,
}

/// A surface whose model is there already.
#[derive(Debug, Serialize)]
pub(super) struct Skipped {
    input: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    label: Option<i64>,
    output: PathBuf,
}

/// What is to be fitted, and what is left out because it is there; refuses before any work what would clash or overwrite.
/// `sphere` is the one that the surfaces share, if they do.
pub(super) fn items(
    cli: &Cli,
    params: &FitParams,
    sphere: Option<&Sphere>,
    reader: &mut SurfaceReader,
    monitor: &ConsoleMonitor,
) -> Result<(Vec<Item>, Vec<Skipped>)> {
    let inputs = reader.surfaces(&cli.input.surface, cli.input.label, sphere.is_none(), monitor)?;
    let outputs = model_files(cli.output.output.as_deref(), &cli.output.name_template, &inputs)?;
    let if_exists = match (cli.output.force, cli.output.skip_existing) {
        (true, _) => IfExists::Replace,
        (_, true) => IfExists::Skip,
        _ => IfExists::Refuse,
    };
    let (mut items, mut skipped, mut records) = (Vec::new(), Vec::new(), HashMap::new());
    for ((input, label), model) in inputs.into_iter().zip(outputs) {
        // A volume has many labels, and is hashed once.
        let file = match records.entry(input.clone()) {
            Entry::Occupied(known) => known.into_mut(),
            Entry::Vacant(new) => new.insert(FileRecord::of(&input)?),
        };
        let record = FileRecord { label, ..file.clone() };
        let files = ModelFiles { model };
        let beside = [
            cli.output.coefficients_csv.then(|| files.csv()),
            cli.output.stderr.then(|| files.standard_errors()),
            sphere.is_none().then(|| files.sphere()),
            label.map(|_| files.surface()),
            // A mesh without handles has none, and is finished all the same.
            (cli.input.cut_handles && !cli.output.skip_existing).then(|| files.cut_surface()),
            // Nor does a mesh in which there was nothing to mend.
            (cli.input.fix && label.is_none() && !cli.output.skip_existing).then(|| files.fixed_surface()),
        ];
        let beside: Vec<PathBuf> = beside.into_iter().flatten().collect();
        let request = Request { input: &record, sphere, params, output: &files.model, beside: &beside, if_exists };
        match request.decide()? {
            Decision::Skip => skipped.push(Skipped { input, label, output: files.model }),
            Decision::Fit { replace, replaces } => {
                if let Some(other) = replaces {
                    monitor.console().warn(format!("{}: replaces the model of {other}", files.model.display()));
                }
                items.push(Item { input, files, record, replace });
            }
        }
    }
    Ok((items, skipped))
}
