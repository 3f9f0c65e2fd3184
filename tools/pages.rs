//! `completions` and `man`: shell completions and manual pages, generated from the program's arguments.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::{Args, Command};
use clap_complete::Shell;
use spharm_cli::output::print;

/// Print completions for a shell
#[derive(Debug, Args)]
pub(crate) struct Completions {
    /// Shell to generate completions for
    shell: Shell,
}

/// Write the manual pages, one for each verb
#[derive(Debug, Args)]
pub(crate) struct Man {
    /// Folder to write to; created if it doesn't exist
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

/// Prints a shell's completions.
pub(crate) fn completions(cli: &Completions, mut command: Command) -> Result<()> {
    let name = command.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(cli.shell, &mut command, name, &mut script);
    print(String::from_utf8_lossy(&script).trim_end())
}

/// Writes the manual pages.
pub(crate) fn man(cli: &Man, command: Command) -> Result<()> {
    let folder = &cli.folder;
    std::fs::create_dir_all(folder).with_context(|| format!("{}: cannot create the folder", folder.display()))?;
    let written = clap_mangen::generate_to(command, folder);
    written.with_context(|| format!("{}: cannot write the manual pages", folder.display()))
}
