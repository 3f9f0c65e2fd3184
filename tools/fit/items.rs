//! Inputs and the outputs that belong to them; what would clash or overwrite is refused before any work.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::PathBuf;

use anyhow::Result;
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

/// Inputs and outputs; refuses before any work what would clash or overwrite. `sphere` is the one that the surfaces
/// share, if they do.
pub(super) fn items(
    cli: &Cli,
    params: &FitParams,
    sphere: Option<&Sphere>,
    reader: &mut SurfaceReader,
    monitor: &ConsoleMonitor,
) -> Result<Vec<Item>> {
    let inputs = reader.surfaces(&cli.input.surface, cli.input.label, sphere.is_none(), monitor)?;
    let outputs = model_files(cli.output.output.as_deref(), &cli.output.name_template, &inputs)?;
    let if_exists = match (cli.output.force, cli.output.skip_existing) {
        (true, _) => IfExists::Replace,
        (_, true) => IfExists::Skip,
        _ => IfExists::Refuse,
    };
    let (mut items, mut records) = (Vec::new(), HashMap::new());
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
        ];
        let beside: Vec<PathBuf> = beside.into_iter().flatten().collect();
        let request = Request { input: &record, sphere, params, output: &files.model, beside: &beside, if_exists };
        if let Decision::Fit { replace, replaces } = request.decide()? {
            if let Some(other) = replaces {
                monitor.console().warn(format!("{}: replaces the model of {other}", files.model.display()));
            }
            items.push(Item { input, files, record, replace });
        }
    }
    Ok(items)
}
