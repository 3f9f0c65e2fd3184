//! `export`: writes models in the formats of other packages.

mod args;

use std::path::PathBuf;

use anyhow::{Context, Result};
use serde_json::json;
use spharm_cli::Usage;
use spharm_cli::output::{OutputFile, check_outputs, prepare, print_json, print_line};
use spharm_cli::paths::{all_shown, expand, model_file_name, shown, with_ending};
use spharm_exchange::{ExportOptions, Exported, Format, Normalization, check, export, files};
use spharm_model::Model;
use spharm_surface::io::{Output, bytes_to_read, check_output};

pub(crate) use self::args::{Cli, FORMATS, normalization};

/// Memory, in bytes, for the text or the arrays of one file while it is written.
const WRITING: u64 = 1 << 20;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    if cli.normalization != Normalization::default() && cli.to != Format::Pyshtools {
        return Err(Usage::conflict("--normalization can only be used with --to pyshtools").into());
    }
    let console = cli.common.console();
    let models = expand(&cli.models, ".npz")?;
    let single = models.len() == 1 && models == cli.models && !cli.output.is_dir();
    let target = |model: &PathBuf| match single {
        true => cli.output.clone(),
        false => with_ending(&cli.output.join(model_file_name(model)), cli.to.ending()),
    };
    let targets: Vec<PathBuf> = models.iter().map(target).collect();
    for target in targets.iter().filter(|target| target.extension().is_some()) {
        check_output(target, Output::Ending(cli.to.endings())).context("--output")?;
    }
    // Check all models before writing the first one.
    let budget = cli.memory.budget(1);
    let mut outputs = Vec::new();
    for (path, target) in models.iter().zip(&targets) {
        budget.check(format_args!("export: {}", path.display()), bytes_to_read(path).saturating_add(WRITING))?;
        let model = Model::read(path)?;
        check(&model, cli.to).with_context(|| path.display().to_string())?;
        outputs.extend(files(cli.to, model.coefficients.channels(), target));
    }
    check_outputs(outputs.iter().map(|path| OutputFile::new(path, "--output")), cli.force)?;
    let options = ExportOptions { overwrite: cli.force, normalization: cli.normalization };
    let mut made = Vec::new();
    for (path, target) in models.iter().zip(&targets) {
        let model = Model::read(path)?;
        prepare(target)?;
        let Exported { files, warnings } =
            export(&model, cli.to, target, &options).with_context(|| path.display().to_string())?;
        warnings.iter().for_each(|warning| console.warn(format!("{}: {warning}", path.display())));
        let degree = model.coefficients.max_degree();
        for file in files.iter().filter(|_| !cli.json) {
            print_line(&format!("{}: {}, degree {degree}", file.display(), cli.to))?;
        }
        let warnings: Vec<String> = warnings.iter().map(ToString::to_string).collect();
        made.push(json!({
            "model": shown(path),
            "files": all_shown(&files),
            "degree": degree,
            "warnings": warnings,
        }));
    }
    if cli.json {
        let (format, versions) = (cli.to.to_string(), spharm::versions());
        print_json(&json!({ "tool": "export", "versions": versions, "format": format, "outputs": made }))?;
    }
    Ok(())
}
