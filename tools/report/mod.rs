//! `report`: makes a page of models, modes and tests for the browser.

mod args;
mod checked;
mod measured;
mod read;
mod tested;

use std::path::PathBuf;

use anyhow::{Result, anyhow};
use spharm_cli::Usage;
use spharm_cli::inputs::{expand_lists, read_warnings};
use spharm_cli::memory::Budget;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print_line};
use spharm_cli::paths::expand;
use spharm_cli::size::Size;
use spharm_report::{Contents, Params, ReportError, page};
use spharm_surface::io::write_new;

pub(crate) use self::args::Cli;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let given = [&cli.models, &cli.modes, &cli.test, &cli.status, &cli.quality];
    if given.iter().all(|given| given.is_empty()) && cli.correspondence.is_none() && cli.check.is_none() {
        let what = "nothing to show: give models, --modes, --test, --quality, --correspondence, --check or --status";
        return Err(Usage::missing(what).into());
    }
    check_outputs([OutputFile::with_ending(&cli.output, "--output", &[".html"])], cli.force)?;
    let monitor = ConsoleMonitor::new(cli.common.console());
    let budget = cli.memory.budget(cli.threads.count());
    check_inputs(cli, budget)?;
    let models = read::models(cli, monitor.console())?;
    let correspondence = cli.correspondence.as_deref().map(measured::correspondence).transpose()?;
    let (mut quality, mut tables) = (measured::quality(&cli.quality)?, Vec::new());
    if let Some(found) = correspondence {
        if let Some(first) = quality.first_mut() {
            first.landmarks = first.landmarks.or(found.landmarks);
        }
        tables.extend(found.tables);
    }
    tables.extend(tested::tables(&cli.test, &cli.output)?);
    tables.extend(read::tables(&cli.status)?);
    let mut contents = Contents {
        warnings: cli.warnings.iter().map(|path| read_warnings(path)).collect::<Result<Vec<_>>>()?.concat(),
        check: cli.check.as_deref().map(|path| checked::read(path, cli.thumbnails.as_deref())).transpose()?,
        models,
        modes: read::modes(&cli.modes)?,
        tests: read::tests(&cli.test)?,
        quality,
        tables,
        methods: cli.methods.as_deref().map(read::methods).transpose()?.unwrap_or_default(),
        provenance: cli.provenance.as_deref().map(read::provenance).transpose()?.unwrap_or_default(),
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..Contents::default()
    };
    contents.title = cli.title.clone().unwrap_or_else(|| title(&contents));
    check_page(cli, &contents, budget)?;
    let params = Params { max_vertices: cli.max_vertices as usize };
    let html = cli.threads.pool()?.install(|| page(&contents, params, &monitor)).map_err(advise)?;
    prepare(&cli.output)?;
    write_new(&cli.output, cli.force, |out| out.write_all(html.as_bytes()))?;
    print_line(&format!("{}: {}", cli.output.display(), Size(html.len())))
}

/// Refuses input files that together don't fit into memory.
fn check_inputs(cli: &Cli, budget: Budget) -> Result<()> {
    let (models, surfaces) = (expand(&cli.models, ".npz")?, expand_lists(&cli.surface)?);
    let maps: Vec<PathBuf> = cli.test.iter().flat_map(|folder| read::files(folder)).collect();
    let files = models.iter().chain(&surfaces).chain(&maps);
    let files = files.chain(&cli.modes).chain(&cli.status).chain(&cli.fit_report).chain(&cli.warnings);
    let files = files.chain(&cli.quality).chain(&cli.correspondence).chain(&cli.check);
    let files = files.chain(&cli.methods).chain(&cli.provenance);
    budget.check_inputs("report", files.map(PathBuf::as_path))
}

/// Refuses a page that, together with its contents, doesn't fit into memory.
fn check_page(cli: &Cli, contents: &Contents, budget: Budget) -> Result<()> {
    let fewer = [100_000, 50_000, 20_000, 10_000, 5000, 2000, 1000, 500, 100].into_iter();
    let fewer = fewer.filter(|n| *n < cli.max_vertices as usize);
    let needed = |max_vertices| contents.bytes(Params { max_vertices });
    let fewer = fewer.map(|n| (format!("--max-vertices {n}"), needed(n)));
    let what = format!("report of {}", counted(contents.models.len(), "model"));
    budget.check_or(what, needed(cli.max_vertices as usize), fewer)
}

/// Appends to an error's text the option that avoids the error, if such an option exists.
fn advise(error: ReportError) -> anyhow::Error {
    match error {
        ReportError::TooLarge { .. } => anyhow!("{error}; raise --max-vertices"),
        error => error.into(),
    }
}

/// Returns the default title: the name of the only item, or else the kind of contents.
fn title(contents: &Contents) -> String {
    let Contents { models, modes, tests, .. } = contents;
    let names = models.iter().map(|shown| &shown.name).chain(modes.iter().map(|(name, _)| name));
    let names: Vec<&String> = names.chain(tests.iter().map(|test| &test.name)).collect();
    match names[..] {
        [name] => name.clone(),
        _ if !models.is_empty() => "Models".to_owned(),
        [] => "Status".to_owned(),
        _ => "Group".to_owned(),
    }
}
