//! The verb `shape` of the program, which analyses models. Each subcommand has a file with its arguments, its calls of
//! the library and its output. `args` holds the shared arguments; `outputs` names and writes the results.
//!
//! A new subcommand needs a file in this folder, a variant of `Command` and a line in [`run`].

mod again;
mod align;
mod align_meshes;
mod args;
mod carry;
mod check;
mod cluster;
mod compress;
mod correspond;
mod describe;
pub mod design;
mod expand;
mod frames;
mod groups;
mod landmarks;
mod maps;
pub mod masks;
mod matching;
mod mean;
mod measure;
mod mirrored;
mod morph;
mod outputs;
mod pca;
mod plan;
mod quality;
mod register;
mod remesh;
mod rotate;
mod sample;
mod smooth;
pub mod table;
mod test;

pub use self::correspond::Poses;
pub use self::correspond::surfaces::{MIRRORED, With};
pub use self::test::SUBDIVISIONS;

use anyhow::Result;
use clap::{Args, Subcommand};
use spharm_cli::Common;
use spharm_cli::help;
use spharm_cli::monitor::ConsoleMonitor;

/// Analyse models: align, average, test, measure, smooth, match, compress
///
/// All results are computed from the coefficients. Models are given as files, as folders (all their .npz files), or as
/// @LIST with one path per line.
#[derive(Debug, Args)]
#[command(after_long_help = help::examples(
    &[
        "spharm shape correspond @subjects.txt --max-degree 15 -o group",
        "spharm shape align models --group -o aligned --mean mean.spharm.npz",
        "spharm shape pca aligned -o group.shape-model.npz",
        "spharm shape test --a @patients.txt --b @controls.txt -o test",
        "spharm shape measure models --maps maps --icosphere 6",
        "spharm shape match bunny.spharm.npz --among @group.txt --top 5",
        "spharm shape remesh bunny.spharm.npz --tolerance 0.1 --icosphere 5 --even -o bunny.ply",
        "spharm shape compress models --tolerance 1e-3 -o compressed",
    ],
    &[],
))]
pub struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    common: Common,
}

#[derive(Debug, Subcommand)]
enum Command {
    Measure(measure::Cli),
    Smooth(smooth::Cli),
    Describe(describe::Cli),
    Match(matching::Cli),
    Cluster(cluster::Cli),
    Remesh(remesh::Cli),
    Rotate(rotate::Cli),
    Correspond(Box<correspond::Cli>),
    Register(register::Cli),
    Carry(carry::Cli),
    Align(align::Cli),
    Mean(mean::Cli),
    Pca(pca::Cli),
    Check(check::Cli),
    Quality(quality::Cli),
    Sample(sample::Cli),
    Morph(morph::Cli),
    Test(Box<test::Cli>),
    Compress(compress::Cli),
    Expand(expand::Cli),
}

/// Runs the verb.
///
/// # Errors
///
/// The errors of the subcommand.
pub fn run(cli: &Cli) -> Result<()> {
    let monitor = ConsoleMonitor::new(cli.common.console());
    match &cli.command {
        Command::Measure(cli) => measure::run(cli, &monitor),
        Command::Smooth(cli) => smooth::run(cli, &monitor),
        Command::Describe(cli) => describe::run(cli, &monitor),
        Command::Match(cli) => matching::run(cli, &monitor),
        Command::Cluster(cli) => cluster::run(cli, &monitor),
        Command::Remesh(cli) => remesh::run(cli, &monitor),
        Command::Rotate(cli) => rotate::run(cli, &monitor),
        Command::Correspond(cli) => correspond::run(cli, &monitor),
        Command::Register(cli) => register::run(cli, &monitor),
        Command::Carry(cli) => carry::run(cli, &monitor),
        Command::Align(cli) => align::run(cli, &monitor),
        Command::Mean(cli) => mean::run(cli, &monitor),
        Command::Pca(cli) => pca::run(cli, &monitor),
        Command::Check(cli) => check::run(cli, &monitor),
        Command::Quality(cli) => quality::run(cli, &monitor),
        Command::Sample(cli) => sample::run(cli, &monitor),
        Command::Morph(cli) => morph::run(cli, &monitor),
        Command::Test(cli) => test::run(cli, &monitor),
        Command::Compress(cli) => compress::run(cli, &monitor),
        Command::Expand(cli) => expand::run(cli, &monitor),
    }
}
