//! `report`: models, modes and tests as a page for the browser.

mod args;
mod read;

use std::path::PathBuf;

use anyhow::{Result, anyhow};
use spharm_cli::Usage;
use spharm_cli::inputs::expand_lists;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted, prepare, print};
use spharm_cli::paths::expand;
use spharm_cli::size::Size;
use spharm_report::{Contents, Params, ReportError, mesh_bytes, page};
use spharm_surface::io::{bytes_to_read, write_new};

pub(crate) use self::args::Cli;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    if [&cli.models, &cli.modes, &cli.test, &cli.status].iter().all(|given| given.is_empty()) {
        return Err(Usage::missing("models, --modes, --test or --status say what the page is of").into());
    }
    check_outputs([OutputFile::with_ending(&cli.output, "--output", &[".html"])], cli.force)?;
    let monitor = ConsoleMonitor::new(cli.common.console());
    check_memory(cli)?;
    let models = read::models(cli, monitor.console())?;
    let mut contents = Contents {
        models,
        modes: read::modes(&cli.modes)?,
        tests: read::tests(&cli.test)?,
        tables: read::tables(&cli.status)?,
        version: env!("CARGO_PKG_VERSION").to_owned(),
        ..Contents::default()
    };
    contents.title = cli.title.clone().unwrap_or_else(|| title(&contents));
    let params = Params { max_vertices: cli.max_vertices as usize };
    let html = cli.threads.pool()?.install(|| page(&contents, params, &monitor)).map_err(advise)?;
    prepare(&cli.output)?;
    write_new(&cli.output, cli.force, |out| out.write_all(html.as_bytes()))?;
    print(&format!("{}: {}", cli.output.display(), Size(html.len())))
}

/// Vertices of the icosphere for a model that has no sphere.
const WITHOUT_SPHERE: u64 = 40_962;

/// Refuses what there is no memory for: all inputs are held together, and the page as text.
fn check_memory(cli: &Cli) -> Result<()> {
    let budget = cli.memory.budget(cli.threads.count());
    let models = expand(&cli.models, ".npz")?;
    let surfaces = expand_lists(&cli.surface)?;
    let files = models.iter().chain(&surfaces).chain(&cli.modes).chain(&cli.status).chain(&cli.fit_report);
    let maps: Vec<PathBuf> = cli.test.iter().flat_map(|folder| read::files(folder)).collect();
    let inputs = files.chain(&maps).map(|path| bytes_to_read(path)).fold(0_u64, u64::saturating_add);
    // Of a model a mesh, its surface and their distance, of modes and of a test a mesh.
    let meshes = (2 * models.len() + cli.modes.len() + cli.test.len()) as u64;
    // No mesh has more vertices than its file has room for, or than a model without a sphere gets.
    let largest = models.iter().chain(&surfaces).chain(&maps).map(|path| bytes_to_read(path)).max().unwrap_or(0);
    let room = (largest / 24).max(WITHOUT_SPHERE);
    let needed = |vertices: u64| inputs.saturating_add(meshes.saturating_mul(mesh_bytes(vertices.min(room))));
    let fewer = [100_000, 50_000, 20_000, 10_000, 5000, 2000, 1000, 500, 100].into_iter();
    let fewer = fewer.filter(|n| *n < cli.max_vertices).map(|n| (format!("--max-vertices {n}"), needed(n.into())));
    let what = format!("report of {}", counted(models.len(), "model"));
    budget.check_or(what, needed(cli.max_vertices.into()), fewer)
}

/// Says which option helps.
fn advise(error: ReportError) -> anyhow::Error {
    match error {
        ReportError::TooLarge { .. } => anyhow!("{error}; raise --max-vertices"),
        error => error.into(),
    }
}

/// The name of the only item, or what there is.
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
