//! `import`: makes models from files of other packages.

mod args;

use std::path::PathBuf;

use anyhow::{Result, anyhow};
use serde_json::Value;
use spharm_cli::inputs::read_sphere;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print_line};
use spharm_exchange::{ExchangeError, Format, ImportOptions, Imported, import};
use spharm_model::{FileRecord, Model};
use spharm_surface::Kind;

pub(crate) use self::args::Cli;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let console = cli.common.console();
    check_outputs([OutputFile::with_ending(&cli.output, "--output", &[".npz"])], cli.force)?;
    let (normalization, condon_shortley) = (cli.normalization, cli.csphase == -1);
    let options = ImportOptions { format: cli.from, normalization, condon_shortley };
    let budget = cli.memory.budget(1);
    budget.check_inputs("import", cli.files.iter().chain(&cli.sphere).map(PathBuf::as_path))?;
    let found = import(&cli.files, &options).map_err(|error| match error {
        ExchangeError::Unknown { .. } => anyhow!("{error}; give the format with --from"),
        error => error.into(),
    });
    let Imported { coefficients, sphere, format, errors_left_out } = found?;
    if format == Format::Pyshtools {
        console.note(format!(
            "pyshtools' files don't state their normalisation and phase: assumed --normalization {} and --csphase {}",
            normalization.name(),
            cli.csphase
        ));
    }
    if errors_left_out {
        console.note("the columns after C and S, which hold the errors of the coefficients, aren't imported");
    }
    let sphere = match &cli.sphere {
        Some(path) => Some(read_sphere(path, false, &console)?),
        None => sphere,
    };
    let (degree, channels) = (coefficients.max_degree(), coefficients.channels());
    if cli.files.len() > 1 && ![1, 3].contains(&channels) {
        console
            .note(format!("{channels} channels: imported as a signal, because a surface has 3 channels, x, y and z"));
    }
    let kind = if channels == 3 && !cli.signal { Kind::Surface } else { Kind::Signal };
    let mut model = match sphere {
        Some(sphere) => Model::new(sphere, coefficients, kind),
        None => Model::without_sphere(coefficients, kind),
    };
    model.provenance.tool = Some("spharm import".to_owned());
    model.provenance.versions = Some(spharm::versions());
    model.provenance.input = cli.files.first().map(|path| FileRecord::of(path)).transpose()?;
    model.provenance.other.insert("imported_from".to_owned(), Value::from(format.name()));
    prepare(&cli.output)?;
    model.write_with(&cli.output, cli.force)?;
    let sphere = model
        .sphere
        .as_ref()
        .map_or("no sphere".to_owned(), |sphere| format!("a sphere of {} vertices", sphere.directions.len()));
    print_line(&format!(
        "{}: {format}, degree {degree}, {}, {sphere}",
        cli.output.display(),
        counted(channels, "channel")
    ))
}
