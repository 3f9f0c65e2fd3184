//! Inputs and the outputs that belong to them; what would clash or overwrite is refused before any work.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, anyhow, bail};
use ndarray_npy::WriteNpyExt;
use spharm::rerun::{Decision, IfExists, Refusal, Request};
use spharm::{FileRecord, Fit, FitParams, Sphere, model_of};
use spharm_cli::console::Console;
use spharm_cli::inputs::expand_lists;
use spharm_cli::names::NameTemplate;
use spharm_surface::io::write_new;
use spharm_surface::model::write_complex_csv;

use super::{Cli, make_folder_of};

/// One surface to fit and where its model goes.
pub(super) struct Item {
    pub(super) input: PathBuf,
    pub(super) output: PathBuf,
    /// What the input is, for the model to record.
    record: FileRecord,
    /// Whether outputs that exist are replaced.
    pub(super) replace: bool,
}

impl Item {
    /// The model's name: `NAME` of `NAME.spharm.npz`.
    pub(super) fn name(&self) -> String {
        let name = self.output.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = name.strip_suffix(".npz").unwrap_or(&name);
        stem.strip_suffix(".spharm").unwrap_or(stem).to_owned()
    }

    /// `NAME.spharm.csv` beside `NAME.spharm.npz`.
    fn csv(&self) -> PathBuf {
        self.output.with_extension("csv")
    }

    /// `NAME.spharm.stderr.npy` beside `NAME.spharm.npz`.
    fn errors(&self) -> PathBuf {
        self.output.with_extension("stderr.npy")
    }

    /// `NAME.sphere.surf.gii` beside `NAME.spharm.npz`.
    pub(super) fn sphere(&self) -> PathBuf {
        self.output.with_file_name(format!("{}.sphere.surf.gii", self.name()))
    }

    /// Writes the model, and beside it what else was asked for.
    pub(super) fn write(&self, cli: &Cli, sphere: &Sphere, fit: &Fit) -> Result<()> {
        make_folder_of(&self.output)?;
        if cli.coefficients_csv {
            write_new(self.csv(), self.replace, |out| write_complex_csv(&fit.coefficients, out))?;
        }
        if let Some(errors) = &fit.standard_errors {
            write_new(self.errors(), self.replace, |out| errors.write_npy(out).map_err(std::io::Error::other))?;
        }
        let model = model_of(sphere, fit, Some(&self.record));
        write_new(&self.output, self.replace, |out| model.write(out))?;
        Ok(())
    }

    /// Whether the item is to be fitted.
    fn is_wanted(&mut self, cli: &Cli, console: &Console, sphere: Option<&Sphere>, params: &FitParams) -> Result<bool> {
        let if_exists = match (cli.force, cli.skip_existing) {
            (true, _) => IfExists::Replace,
            (_, true) => IfExists::Skip,
            _ => IfExists::Refuse,
        };
        let beside = [
            cli.coefficients_csv.then(|| self.csv()),
            cli.stderr.then(|| self.errors()),
            sphere.is_none().then(|| self.sphere()),
        ];
        let beside: Vec<PathBuf> = beside.into_iter().flatten().collect();
        let (input, output) = (&self.record, &self.output);
        let request = Request { input, sphere, params, output, beside: &beside, if_exists };
        match request.decide().map_err(advise)? {
            Decision::Skip => Ok(false),
            Decision::Fit { replace, replaces } => {
                if let Some(other) = replaces {
                    console.warn(format!("{}: replaces the model of {}", self.output.display(), other.path));
                }
                self.replace = replace;
                Ok(true)
            }
        }
    }
}

/// What to do about an output that is in the way.
fn advise(refusal: Refusal) -> anyhow::Error {
    let advice = match &refusal {
        Refusal::OtherInput { recorded, input, .. } => {
            let inputs = [recorded, input].map(PathBuf::from);
            let template = NameTemplate::distinguishing(&inputs);
            let template = template.map_or(String::new(), |template| format!("--name-template '{template}', "));
            format!("give {template}another --output, or --force to replace it")
        }
        Refusal::Exists { .. } => "choose another --output, or give --force or --skip-existing".to_owned(),
        _ => "choose another --output, or give --force to replace it".to_owned(),
    };
    anyhow!("{refusal}; {advice}")
}

/// Inputs and outputs; refuses before any work what would clash or overwrite. `sphere` is the one that the surfaces
/// share, if they do.
pub(super) fn items(cli: &Cli, console: &Console, sphere: Option<&Sphere>, params: &FitParams) -> Result<Vec<Item>> {
    let inputs = expand_lists(&cli.surface)?;
    let outputs = outputs(cli, &inputs)?;
    let mut items = Vec::new();
    for (input, output) in inputs.into_iter().zip(outputs) {
        if !input.is_file() {
            let what = if input.exists() { "not a regular file" } else { "no such file" };
            bail!("{}: {what}", input.display());
        }
        let record = FileRecord::of(&input).with_context(|| format!("{}: cannot read", input.display()))?;
        let mut item = Item { input, output, record, replace: false };
        if item.is_wanted(cli, console, sphere, params)? {
            items.push(item);
        }
    }
    Ok(items)
}

/// Whether a path that isn't a folder looks like a file that `fit` doesn't write under that name.
fn has_file_ending(output: &Path) -> bool {
    const ENDINGS: [&str; 12] = ["csv", "tsv", "npy", "json", "gii", "gz", "ply", "obj", "off", "stl", "vtk", "png"];
    let ending = output.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    !output.is_dir() && ENDINGS.contains(&ending.as_str())
}

/// The model's file for each input.
fn outputs(cli: &Cli, inputs: &[PathBuf]) -> Result<Vec<PathBuf>> {
    let names_file = |output: &Path| output.extension().is_some_and(|ending| ending == "npz") && !output.is_dir();
    match (&cli.output, inputs) {
        (Some(output), [_]) if names_file(output) => return Ok(vec![output.clone()]),
        (Some(output), _) if names_file(output) => {
            bail!("{}: a file for {} surfaces; --output must name a folder", output.display(), inputs.len());
        }
        (Some(output), _) if has_file_ending(output) => {
            bail!("{}: --output is a folder, or a file that ends in .npz", output.display());
        }
        _ => {}
    }
    let folder = cli.output.clone().unwrap_or_default();
    let output = |input: &PathBuf| folder.join(format!("{}.spharm.npz", cli.name_template.name(input)));
    let outputs: Vec<PathBuf> = inputs.iter().map(output).collect();
    let mut order: Vec<usize> = (0..inputs.len()).collect();
    order.sort_by(|&a, &b| outputs[a].cmp(&outputs[b]));
    if let Some(pair) = order.windows(2).find(|pair| outputs[pair[0]] == outputs[pair[1]]) {
        let [first, second] = [pair[0], pair[1]].map(|number| inputs[number].display());
        let remedy = match NameTemplate::distinguishing(inputs) {
            Some(template) => format!("give --name-template '{template}'"),
            None => "rename one or fit them apart".to_owned(),
        };
        bail!("{first} and {second} would both be written to {}; {remedy}", outputs[pair[0]].display());
    }
    Ok(outputs)
}
