//! `paper`: the paper's experiments as a command.
//!
//! | module | what |
//! |---|---|
//! | `surfaces` | what the experiments run on |
//! | `published` | the paper's own numbers, and the reference beside the data |
//! | `bench` | building bases and fitting surfaces, with the time taken |
//! | `experiments` | figures 3, 5, 6 and 7 and table 1: what is measured |
//! | `tables`, `figures`, `plots`, `summary` | what is written about it |

mod args;
mod bench;
mod experiments;
mod families;
mod figures;
mod plots;
mod published;
mod summary;
mod surfaces;
mod tables;

use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm_cli::machine::{Versions, memory};
use spharm_cli::output::print;
use spharm_solver::DiskOperator;
use spharm_store::Scheme;
use spharm_surface::io::write_new;

pub(crate) use self::args::Cli;
use self::bench::Bench;
use self::experiments::{Extent, FULL, QUICK, Results};
use self::published::Reference;
use self::summary::Circumstances;
use self::surfaces::Surface;

const SUMMARY: &str = "paper.md";

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    /// The program, its stacks and allocator, as in `fit`.
    const BASE: usize = 12 << 20;
    let started = Instant::now();
    let console = cli.common.console();
    let cancel = spharm_cli::exit::cancel();
    let extent = if cli.quick { QUICK } else { FULL };
    let mut surfaces = vec![surfaces::generated(extent.subdivisions)?];
    let mut reference = Reference::default();
    if let Some(data) = &cli.data {
        surfaces.extend(surfaces::among(data, &console)?);
        reference = Reference::beside(data)?;
    }
    make_folder(&cli.output)?;
    if !cli.force {
        refuse_to_replace(&cli.output, &surfaces)?;
    }
    let store = Store::of(cli)?;
    let held = BASE + surfaces.iter().map(Surface::bytes).sum::<usize>();
    let threads = cli.threads.count();
    let bench = Bench { console: &console, cancel, memory: cli.memory.0, threads, held };
    let results = cli.threads.pool()?.install(|| experiments(&bench, &extent, &store, &surfaces, &reference))?;
    let circumstances = Circumstances {
        quick: cli.quick,
        version: Versions::current().spharm,
        threads,
        memory: cli.memory.0,
        peak: memory().peak_resident,
        seconds: started.elapsed().as_secs_f64(),
    };
    let summary = summary::summary(&results, &extent, &surfaces, &circumstances);
    let names: Vec<String> = surfaces.into_iter().map(|surface| surface.name).collect();
    for (name, text) in tables::all_csv(&results) {
        write(cli, name, &text)?;
    }
    for (name, text) in figures::all(&results, &extent, &names) {
        write(cli, &name, &text)?;
    }
    write(cli, SUMMARY, &summary)?;
    print(summary.trim_end())
}

fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create", folder.display()))
}

/// Says at once, not after minutes, that results would be replaced.
fn refuse_to_replace(output: &Path, surfaces: &[Surface]) -> Result<()> {
    let names: Vec<String> = surfaces.iter().map(|surface| surface.name.clone()).collect();
    let empty = Results::default();
    let tables = tables::all_csv(&empty).into_iter().map(|(name, _)| name.to_owned());
    let figures = figures::names(&names);
    let mut paths = tables.chain(figures).chain([SUMMARY.to_owned()]).map(|name| output.join(name));
    if let Some(path) = paths.find(|path| path.exists()) {
        bail!("{}: the result exists; choose another --output or give --force", path.display());
    }
    Ok(())
}

fn write(cli: &Cli, name: &str, text: &str) -> Result<()> {
    write_new(cli.output.join(name), cli.force, |out| out.write_all(text.as_bytes()))?;
    Ok(())
}

/// Where the bases are.
struct Store {
    folder: PathBuf,
    /// Removes the folder when it is dropped.
    temporary: Option<tempfile::TempDir>,
}

impl Store {
    fn of(cli: &Cli) -> Result<Self> {
        if let Some(folder) = &cli.store {
            make_folder(folder)?;
            return Ok(Self { folder: folder.clone(), temporary: None });
        }
        let temporary = tempfile::Builder::new().prefix(".store.").tempdir_in(&cli.output);
        let temporary =
            temporary.with_context(|| format!("{}: cannot create a folder for the store", cli.output.display()))?;
        Ok(Self { folder: temporary.path().to_path_buf(), temporary: Some(temporary) })
    }

    /// A basis that won't be used any more: a temporary store never holds more than one, lest the disk and the system's
    /// cache of it have to hold all.
    fn done_with(&self, basis: &Path) -> Result<()> {
        if self.temporary.is_some() {
            std::fs::remove_dir_all(basis).with_context(|| format!("{}: cannot remove", basis.display()))?;
        }
        Ok(())
    }
}

fn experiments(
    bench: &Bench<'_>,
    extent: &Extent,
    store: &Store,
    surfaces: &[Surface],
    reference: &Reference,
) -> Result<Results> {
    let mut results = Results::default();
    for (index, surface) in surfaces.iter().enumerate() {
        let n = surface.directions.len();
        bench.console.note(format!("{}: the basis of {n} vertices to degree {}", surface.name, extent.max_degree));
        let (built, _) = bench.build(&store.folder, &surface.directions, extent.max_degree)?;
        let operator = DiskOperator::new(Scheme::open(&store.folder, built.key, n, extent.max_degree)?);
        results.sirf.extend(experiments::sirf(bench, extent, &operator, surface, reference)?);
        let (grid, between) = experiments::grid(bench, extent, &operator, surface, reference)?;
        results.grid.extend(grid);
        results.between.extend(between);
        if index == 0 {
            results.nlsf = experiments::nlsf(bench, extent, &operator, surface)?;
        }
        drop(operator);
        store.done_with(&built.folder)?;
        results.families.extend(families::families(bench, extent, surface)?);
    }
    results.basis = experiments::basis(bench, extent, &store.folder)?;
    Ok(results)
}
