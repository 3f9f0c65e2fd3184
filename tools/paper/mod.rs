//! `paper`: repeats the paper's experiments.

mod args;

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, bail};
use spharm_cli::machine::memory;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::print;
use spharm_paper::{Circumstances, Experiments, Settings};
use spharm_surface::io::write_new;

pub(crate) use self::args::Cli;

/// Runs the verb.
pub(crate) fn run(cli: &Cli) -> Result<()> {
    let started = Instant::now();
    let console = cli.common.console();
    let monitor = ConsoleMonitor::new(console);
    let settings = Settings { quick: cli.quick, memory: cli.memory.0, threads: cli.threads.count() };
    let experiments = Experiments::new(settings, cli.data.as_deref(), &monitor)?;
    make_folder(&cli.output)?;
    if !cli.force {
        refuse_to_replace(&cli.output, &experiments)?;
    }
    let measured = cli.threads.pool()?.install(|| experiments.run(cli.store.as_deref(), &cli.output, &monitor))?;
    measured.warnings.iter().for_each(|warning| console.warn(warning));
    let circumstances = Circumstances { peak: memory().peak_resident, seconds: started.elapsed().as_secs_f64() };
    let documents = experiments.documents(&measured, &circumstances);
    for document in &documents {
        write_new(cli.output.join(&document.name), cli.force, |out| out.write_all(document.text.as_bytes()))?;
    }
    documents.last().map_or(Ok(()), |summary| print(summary.text.trim_end()))
}

fn make_folder(folder: &Path) -> Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create the folder", folder.display()))
}

/// Refuses to replace existing results. Called before the experiments, which take minutes.
fn refuse_to_replace(output: &Path, experiments: &Experiments) -> Result<()> {
    let paths = experiments.document_names().into_iter().map(|name| output.join(name));
    if let Some(path) = paths.into_iter().find(|path| path.exists()) {
        bail!("{}: the result exists; choose another --output or give --force", path.display());
    }
    Ok(())
}
