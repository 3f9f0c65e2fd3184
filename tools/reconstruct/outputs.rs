//! Determines the models to evaluate, and the output of each, before any work.

use std::path::{Path, PathBuf};

use anyhow::Result;
use spharm_cli::Usage;
use spharm_cli::names::is_named_file;
use spharm_cli::output::{OutputFile, check_outputs};
use spharm_cli::paths::{expand, model_file_name, with_ending};
use spharm_surface::io::Output;

use super::args::Cli;

/// Default extension of the files of surfaces in an output folder.
const SURFACE: &str = "surf.gii";
/// Default extension of the files of signals in an output folder.
const SIGNAL: &str = "func.gii";

/// A model to evaluate, and the file to which its values are written.
pub(super) struct Item {
    pub(super) model: PathBuf,
    target: Target,
}

enum Target {
    File(PathBuf),
    /// A path without an extension; the extension depends on whether the model is a surface or a signal.
    Stem(PathBuf),
}

impl Item {
    /// Returns the path of the output file for a surface or a signal.
    pub(super) fn output(&self, surface: bool) -> PathBuf {
        match &self.target {
            Target::File(path) => path.clone(),
            Target::Stem(path) => with_ending(path, if surface { SURFACE } else { SIGNAL }),
        }
    }
}

/// Returns the models to evaluate, each with its output: the file that `--output` names for a single model, otherwise a
/// file in the output folder.
pub(super) fn items(cli: &Cli) -> Result<Vec<Item>> {
    let paths = [&cli.models[..], &cli.model].concat();
    let models = expand(&paths, ".npz")?;
    let single = models.len() == 1 && models == paths;
    let items: Vec<Item> = if single && !cli.output.is_dir() && cli.format.is_none() {
        let target = || Target::File(cli.output.clone());
        models.into_iter().map(|model| Item { model, target: target() }).collect()
    } else {
        if is_named_file(&cli.output) {
            let given = "several models, a folder of models or --format";
            return Err(Usage::conflict(format!("--output must name a folder if {given} are given")).into());
        }
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
