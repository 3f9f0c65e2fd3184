//! Inputs and the outputs that belong to them; what would clash or overwrite is refused before any work.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use spharm::files::ModelFiles;
use spharm::rerun::{Decision, IfExists, Request};
use spharm::{FileRecord, Sphere};
use spharm_cli::surfaces::surfaces;

use super::Cli;
use super::output::Call;

/// One surface to fit and where its model goes.
pub(super) struct Item {
    pub(super) input: PathBuf,
    /// Of a volume.
    pub(super) label: Option<i64>,
    pub(super) files: ModelFiles,
    /// What the input is, for the model to record.
    pub(super) record: FileRecord,
    /// Whether outputs that exist are replaced.
    pub(super) replace: bool,
}

/// Inputs and outputs; refuses before any work what would clash or overwrite. `sphere` is the one that the surfaces
/// share, if they do.
pub(super) fn items(call: &Call<'_>, sphere: Option<&Sphere>) -> Result<Vec<Item>> {
    let (cli, params) = (call.cli, call.params);
    let inputs = surfaces(&cli.input.surface, cli.input.label, sphere.is_none(), call.monitor)?;
    let outputs = outputs(cli, &inputs)?;
    let if_exists = match (cli.output.force, cli.output.skip_existing) {
        (true, _) => IfExists::Replace,
        (_, true) => IfExists::Skip,
        _ => IfExists::Refuse,
    };
    let mut items = Vec::new();
    for ((input, label), model) in inputs.into_iter().zip(outputs) {
        let record = FileRecord { label, ..FileRecord::of(&input)? };
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
                call.console.warn(format!("{}: replaces the model of {}", files.model.display(), other));
            }
            items.push(Item { input, label, files, record, replace });
        }
    }
    Ok(items)
}

/// The model's file for each input.
fn outputs(cli: &Cli, inputs: &[(PathBuf, Option<i64>)]) -> Result<Vec<PathBuf>> {
    const FILES: [&str; 12] = ["csv", "tsv", "npy", "json", "gii", "gz", "ply", "obj", "off", "stl", "vtk", "png"];
    let folder = cli.output.output.as_deref().unwrap_or(Path::new(""));
    let ending = folder.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    match inputs {
        _ if folder.is_dir() => {}
        [_] if ending == "npz" => return Ok(vec![folder.to_owned()]),
        several if ending == "npz" => {
            bail!("{}: a file for {} surfaces; --output must name a folder", folder.display(), several.len());
        }
        _ if FILES.contains(&ending.as_str()) => {
            bail!("{}: --output is a folder, or a file that ends in .npz", folder.display());
        }
        _ => {}
    }
    cli.output.name_template.outputs(inputs, folder, ".spharm.npz")
}
