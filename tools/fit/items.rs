//! Inputs and the outputs that belong to them; what would clash or overwrite is refused before any work.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use ndarray_npy::WriteNpyExt;
use spharm::{Fit, Sphere, model_of};
use spharm_cli::console::Console;
use spharm_cli::inputs::{expand_lists, unique_stems};
use spharm_cli::output::refuse_existing;
use spharm_surface::io::write_new;
use spharm_surface::model::write_complex_csv;

use super::{Cli, make_folder_of};

/// One surface to fit and where its model goes.
pub(super) struct Item {
    pub(super) input: PathBuf,
    pub(super) output: PathBuf,
}

impl Item {
    /// `NAME.spharm.csv` beside `NAME.spharm.npz`.
    fn csv(&self) -> PathBuf {
        self.beside(".csv")
    }

    /// `NAME.spharm.stderr.npy` beside `NAME.spharm.npz`.
    fn errors(&self) -> PathBuf {
        self.beside(".stderr.npy")
    }

    fn beside(&self, ending: &str) -> PathBuf {
        let text = self.output.to_string_lossy();
        PathBuf::from(format!("{}{ending}", text.strip_suffix(".npz").unwrap_or(&text)))
    }

    /// `NAME.sphere.surf.gii` beside `NAME.spharm.npz`.
    pub(super) fn sphere(&self) -> PathBuf {
        let name = self.output.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
        let stem = name.strip_suffix(".npz").unwrap_or(&name);
        self.output.with_file_name(format!("{}.sphere.surf.gii", stem.strip_suffix(".spharm").unwrap_or(stem)))
    }

    /// Writes the model, and beside it what else was asked for.
    pub(super) fn write(&self, cli: &Cli, sphere: &Sphere, fit: &Fit) -> Result<()> {
        make_folder_of(&self.output)?;
        if cli.coefficients_csv {
            write_new(self.csv(), cli.force, |out| write_complex_csv(&fit.coefficients, out))?;
        }
        if let Some(errors) = &fit.standard_errors {
            write_new(self.errors(), cli.force, |out| errors.write_npy(out).map_err(std::io::Error::other))?;
        }
        let input = self.input.file_name().map(|name| name.to_string_lossy());
        let model = model_of(sphere, fit, input.as_deref());
        write_new(&self.output, cli.force, |out| model.write(out))?;
        Ok(())
    }
}

/// Whether `--output` means one file rather than a folder: it ends in `.npz` and isn't a folder.
fn names_file(output: &Path) -> bool {
    output.extension().is_some_and(|extension| extension == "npz") && !output.is_dir()
}

/// Inputs and outputs; refuses before any work what would clash or overwrite.
pub(super) fn items(cli: &Cli, console: &Console) -> Result<Vec<Item>> {
    let inputs = expand_lists(&cli.surface)?;
    let mut items: Vec<Item> = match (&inputs[..], &cli.output) {
        ([input], Some(output)) if names_file(output) => {
            vec![Item { input: input.clone(), output: output.clone() }]
        }
        (several, Some(output)) if names_file(output) => {
            bail!("{}: a file for {} surfaces; --output must name a folder", output.display(), several.len());
        }
        (_, folder) => {
            let folder = folder.clone().unwrap_or_default();
            let named = inputs.iter().zip(unique_stems(&inputs));
            named
                .map(|(input, name)| Item { output: folder.join(format!("{name}.spharm.npz")), input: input.clone() })
                .collect()
        }
    };
    let mut outputs: Vec<&Path> = items.iter().map(|item| item.output.as_path()).collect();
    outputs.sort_unstable();
    if let Some(pair) = outputs.windows(2).find(|pair| pair[0] == pair[1]) {
        bail!("two surfaces would be written to {}; rename one or fit them apart", pair[0].display());
    }
    let before = items.len();
    if cli.skip_existing {
        items.retain(|item| !item.output.exists());
        if items.len() < before {
            console.note(format!("{} outputs exist and are left alone", before - items.len()));
        }
    } else if !cli.force
        && let Some(item) = items.iter().find(|item| item.output.exists())
    {
        bail!(
            "{}: the output exists; choose another --output, or give --force or --skip-existing",
            item.output.display()
        );
    }
    for item in &items {
        if cli.coefficients_csv {
            refuse_existing(&item.csv(), cli.force, "output", "--output")?;
        }
        if cli.stderr {
            refuse_existing(&item.errors(), cli.force, "output", "--output")?;
        }
        if !item.input.is_file() {
            let what = if item.input.exists() { "not a regular file" } else { "no such file" };
            bail!("{}: {what}", item.input.display());
        }
    }
    Ok(items)
}
