//! Inputs and the outputs that belong to them; what would clash or overwrite is refused before any work.

use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use spharm_cli::console::Console;
use spharm_cli::inputs::{expand_lists, unique_stems};
use spharm_cli::output::refuse_existing;

use super::Cli;

/// One surface to fit and where its model goes.
pub(crate) struct Item {
    pub(crate) input: PathBuf,
    pub(crate) output: PathBuf,
}

/// Whether `--output` means one file rather than a folder: it ends in `.npz` and isn't a folder.
fn names_file(output: &Path) -> bool {
    output.extension().is_some_and(|extension| extension == "npz") && !output.is_dir()
}

/// `NAME.spharm.csv` beside `NAME.spharm.npz`.
pub(crate) fn csv_of(output: &Path) -> PathBuf {
    let text = output.to_string_lossy();
    PathBuf::from(format!("{}.csv", text.strip_suffix(".npz").unwrap_or(&text)))
}

/// `NAME.spharm.stderr.npy` beside `NAME.spharm.npz`.
pub(crate) fn errors_of(output: &Path) -> PathBuf {
    let text = output.to_string_lossy();
    PathBuf::from(format!("{}.stderr.npy", text.strip_suffix(".npz").unwrap_or(&text)))
}

/// Inputs and outputs; refuses before any work what would clash or overwrite.
pub(crate) fn items(cli: &Cli, console: &Console) -> Result<Vec<Item>> {
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
            refuse_existing(&csv_of(&item.output), cli.force, "output", "--output")?;
        }
        if cli.stderr {
            refuse_existing(&errors_of(&item.output), cli.force, "output", "--output")?;
        }
        if !item.input.is_file() {
            let what = if item.input.exists() { "not a regular file" } else { "no such file" };
            bail!("{}: {what}", item.input.display());
        }
    }
    Ok(items)
}
