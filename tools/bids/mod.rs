//! `bids`: a BIDS app. `discover` finds surfaces, `participant` fits them and writes the derivatives of each model,
//! `group` gathers the models, `dataset` writes the files that describe the output as a dataset.

mod args;
mod dataset;
mod discover;
mod group;
mod names;
mod participant;

use anyhow::Result;
use spharm_cli::paths::utf8;

pub(crate) use self::args::Cli;
use self::args::Level;

/// Runs the verb `bids`. Calls `spharm` to run other verbs.
pub(crate) fn run(cli: &Cli, spharm: &dyn Fn(&[String]) -> Result<()>) -> Result<()> {
    // The paths must be UTF-8, because the other verbs get their arguments as text.
    [&cli.dataset, &cli.output].into_iter().try_for_each(|path| utf8(path).map(drop))?;
    match cli.level {
        Level::Participant => participant::run(cli, spharm),
        Level::Group => group::run(cli, spharm),
    }
}

/// Returns the command line of another verb: the given arguments, then the arguments common to all verbs.
fn command(cli: &Cli, arguments: Vec<String>) -> Vec<String> {
    let mut command = vec!["spharm".to_owned()];
    command.extend(arguments);
    command.extend(cli.threads.threads.iter().flat_map(|count| ["--threads".to_owned(), count.to_string()]));
    command.extend(cli.memory.arguments());
    command.extend(cli.common.quiet.then(|| "--quiet".to_owned()));
    command.extend(cli.common.verbose.then(|| "--verbose".to_owned()));
    command
}
