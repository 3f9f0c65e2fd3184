//! Which models are evaluated and where each result is written, settled before any work.

use std::path::{Path, PathBuf};

use anyhow::Result;
use spharm_cli::output::{OutputFile, check_outputs};
use spharm_cli::paths::{expand, model_file_name, with_ending};
use spharm_surface::io::Output;

use super::args::Cli;

/// Endings of outputs in a folder, where no format is asked for.
const SURFACE: &str = "surf.gii";
const SIGNAL: &str = "func.gii";

/// A model and where its values go.
pub(super) struct Item {
    pub(super) model: PathBuf,
    target: Target,
}

enum Target {
    File(PathBuf),
    /// A path without an ending: the format depends on the model.
    Stem(PathBuf),
}

impl Item {
    /// The file to write.
    pub(super) fn output(&self, surface: bool) -> PathBuf {
        match &self.target {
            Target::File(path) => path.clone(),
            Target::Stem(path) => with_ending(path, if surface { SURFACE } else { SIGNAL }),
        }
    }
}

/// Returns the models, each with its output: the file that was named for a single one, else a file in that folder.
pub(super) fn items(cli: &Cli) -> Result<Vec<Item>> {
    let models = expand(&cli.model, ".npz")?;
    let single = models.len() == 1 && models == cli.model;
    let items: Vec<Item> = if single && !cli.output.is_dir() && cli.format.is_none() {
        let target = || Target::File(cli.output.clone());
        models.into_iter().map(|model| Item { model, target: target() }).collect()
    } else {
        let target = |model: &Path| {
            let path = cli.output.join(model_file_name(model));
            match &cli.format {
                Some(format) => Target::File(with_ending(&path, format)),
                None => Target::Stem(path),
            }
        };
        models.into_iter().map(|model| Item { target: target(&model), model }).collect()
    };
    let paths: Vec<[PathBuf; 2]> = items.iter().map(|item| [item.output(true), item.output(false)]).collect();
    for of_kind in [0, 1] {
        check_outputs(
            paths.iter().map(|pair| OutputFile::holding(&pair[of_kind], "--output", Output::Either)),
            cli.force,
        )?;
    }
    Ok(items)
}
