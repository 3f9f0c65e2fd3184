//! `spharm`: one program with a verb (subcommand) for each step from a surface to its model and back.
//!
//! Each verb is a module with its arguments, its calls of the library, and its output. These modules form a library so
//! that the Python package can include the program; the computations are in the crate `spharm`.

#[cfg(all(target_os = "linux", target_env = "gnu"))]
pub mod allocator;
mod basis_build;
mod bids;
mod compare;
mod export;
mod fit;
mod freesurfer;
mod generate;
mod import;
mod moments;
mod pages;
#[cfg(feature = "paper")]
mod paper;
mod parametrize;
mod picture;
mod reconstruct;
mod report;
mod roles;
mod rows;
mod status;
mod store;
mod surfaces;
mod verbs;
mod volumes;

use std::borrow::Cow;
use std::ffi::OsString;
use std::path::Path;

use clap::{ArgMatches, Args, Command, CommandFactory, FromArgMatches, Parser, Subcommand};
use spharm_cli::Common;
use spharm_cli::exit;
use spharm_cli::machine::available_memory;
use spharm_cli::printable::one_line;
use spharm_cohort::Manifest;
use spharm_surface::io::ask_for_free_memory;

/// Spherical-harmonic (SPHARM) models of surfaces, from meshes to coefficients and back
#[derive(Debug, Parser)]
#[command(name = "spharm", version, propagate_version = true)]
struct Spharm {
    #[command(subcommand)]
    verb: Verb,
}

#[derive(Debug, Subcommand)]
enum Verb {
    Fit(Box<fit::Cli>),
    Parametrize(parametrize::Cli),
    Reconstruct(reconstruct::Cli),
    Compare(compare::Cli),
    Shape(spharm_analysis::Cli),
    Freesurfer(freesurfer::Cli),
    Moments(moments::Cli),
    Volumes(volumes::Cli),
    Export(export::Cli),
    Import(import::Cli),
    Status(status::Cli),
    Picture(picture::Cli),
    Study(spharm_study::Cli),
    Bids(bids::Cli),
    Report(report::Cli),
    BasisBuild(basis_build::Cli),
    Store(store::Cli),
    Generate(generate::Cli),
    #[cfg(feature = "paper")]
    Paper(paper::Cli),
    Completions(pages::Completions),
    Man(pages::Man),
}

impl Verb {
    fn run(&self) -> anyhow::Result<()> {
        match self {
            Self::Fit(cli) => fit::run(cli),
            Self::Parametrize(cli) => parametrize::run(cli),
            Self::Reconstruct(cli) => reconstruct::run(cli),
            Self::Compare(cli) => compare::run(cli),
            Self::Shape(cli) => spharm_analysis::run(cli),
            Self::Freesurfer(cli) => freesurfer::run(cli),
            Self::Moments(cli) => moments::run(cli),
            Self::Volumes(cli) => volumes::run(cli),
            Self::Export(cli) => export::run(cli),
            Self::Import(cli) => import::run(cli),
            Self::Status(cli) => status::run(cli),
            Self::Picture(cli) => picture::run(cli),
            Self::Study(cli) => spharm_study::run(cli, &run_command, &parse_command, &preview_fit),
            Self::Bids(cli) => bids::run(cli, &run_command),
            Self::Report(cli) => report::run(cli),
            Self::BasisBuild(cli) => basis_build::run(cli),
            Self::Store(cli) => store::run(cli),
            Self::Generate(cli) => generate::run(cli),
            #[cfg(feature = "paper")]
            Self::Paper(cli) => paper::run(cli),
            Self::Completions(cli) => pages::completions(cli, command()),
            Self::Man(cli) => pages::man(cli, command()),
        }
    }
}

/// Runs a command that is a step of another verb. The command's first word is `spharm`.
fn run_command(arguments: &[String]) -> anyhow::Result<()> {
    Parsed::of(arguments).map_err(told)?.run()
}

/// Checks the arguments of a command that is a step of another verb, without running it.
fn parse_command(arguments: &[String]) -> anyhow::Result<()> {
    Parsed::of(arguments).map(drop).map_err(told)
}

/// Previews a `fit` command, with the rows of `manifest` in place of the rows of a file.
fn preview_fit(arguments: &[String], manifest: Manifest) -> anyhow::Result<spharm_study::Preview> {
    match Parsed::of(arguments).map_err(told)?.spharm.verb {
        Verb::Fit(cli) => {
            let rows::Previewed { text, error, .. } = fit::preview(&cli, manifest)?;
            Ok(spharm_study::Preview { text, error })
        }
        _ => anyhow::bail!("expected the verb fit"),
    }
}

/// Converts clap's error about a command's arguments to an error whose text is a single line.
fn told(error: clap::Error) -> anyhow::Error {
    let text = error.to_string().replace("\n\n  tip: ", "; ");
    let end = ["\n\nUsage:", "\n\nFor more information"].iter().filter_map(|hint| text.find(hint)).min();
    let said = text[..end.unwrap_or(text.len())].split_whitespace().collect::<Vec<_>>().join(" ");
    anyhow::anyhow!("{}", said.strip_prefix("error: ").unwrap_or(&said))
}

/// Returns the program's command. The flags common to all verbs may also precede the verb.
fn command() -> Command {
    // Add only the arguments of `Common`, because its description must not replace the program's description.
    let common = Common::augment_args(Command::new("common"));
    Spharm::command().args(common.get_arguments().cloned())
}

/// A parsed command line, with the command that parsed it.
struct Parsed {
    command: Command,
    matches: ArgMatches,
    spharm: Spharm,
}

impl Parsed {
    fn of<T: Into<OsString> + Clone>(arguments: impl IntoIterator<Item = T>) -> Result<Self, clap::Error> {
        let mut command = command();
        let matches = command.try_get_matches_from_mut(arguments);
        let matches = matches.map_err(|error| verbs::suggested(error, &command))?;
        // clap detects conflicts among the arguments before the verb, and among the arguments after the verb, but not
        // between an argument before the verb and an argument after it.
        let mut verb = &matches;
        while let Some((_, next)) = verb.subcommand() {
            verb = next;
        }
        let given = |flag: &str| verb.try_get_one::<bool>(flag).ok().flatten() == Some(&true);
        if given("quiet") && given("verbose") {
            let conflict = "the argument '--quiet' cannot be used with '--verbose'";
            return Err(command.error(clap::error::ErrorKind::ArgumentConflict, conflict));
        }
        Ok(Self { spharm: Spharm::from_arg_matches(&matches)?, command, matches })
    }

    /// Checks that no file is used in conflicting roles in the arguments, then runs the verb.
    fn run(&self) -> anyhow::Result<()> {
        roles::check_arguments(&self.command, &self.matches)?;
        self.spharm.verb.run()
    }
}

/// Runs the program with the given arguments, of which the first is the program's name. Returns the program's exit
/// code, even if the arguments are wrong or request help.
pub fn main(given: impl IntoIterator<Item = OsString>) -> u8 {
    ask_for_free_memory(available_memory);
    let given = arguments(given);
    let tame = given.iter().any(|argument| matches!(one_line(&argument.to_string_lossy()), Cow::Owned(_)));
    let parsed = match Parsed::of(given) {
        Ok(parsed) => parsed,
        Err(error) => return exit::wrong_usage(&error, tame),
    };
    let verb = parsed.matches.subcommand_name().unwrap_or_default();
    exit::run(|| parsed.run(), || exit::command_of(command(), verb))
}

/// Returns the arguments. If the program was called through a link with the name of a verb, inserts this verb after the
/// program's name.
fn arguments(given: impl IntoIterator<Item = OsString>) -> Vec<OsString> {
    let mut arguments: Vec<OsString> = given.into_iter().collect();
    let name = arguments.first().and_then(|name| Path::new(name).file_stem()).unwrap_or_default().to_owned();
    if ["basis-build", "fit"].iter().any(|verb| name == *verb) {
        arguments.splice(..1, ["spharm".into(), name]);
    }
    arguments
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_arguments_are_consistent() {
        command().debug_assert();
    }

    #[test]
    fn the_degree_has_the_same_short_option_everywhere() {
        fn check(command: &Command, found: &mut usize) {
            for argument in command.get_arguments().filter(|argument| argument.get_long() == Some("max-degree")) {
                assert_eq!(argument.get_short(), Some('L'), "{}", command.get_name());
                *found += 1;
            }
            command.get_subcommands().for_each(|verb| check(verb, found));
        }
        let mut found = 0;
        check(&command(), &mut found);
        assert!(found > 15, "{found}");
    }

    #[test]
    fn flags_of_every_verb_may_stand_before_it() {
        let quiet = |line: &[&str]| {
            let parsed = Parsed::of(line).unwrap();
            let (_, verb) = parsed.matches.subcommand().unwrap();
            verb.get_flag("quiet")
        };
        assert!(quiet(&["spharm", "-q", "store", "verify", "x"]) && quiet(&["spharm", "store", "verify", "x", "-q"]));
        assert!(!quiet(&["spharm", "store", "verify", "x"]));
        assert!(Parsed::of(["spharm", "-q", "store", "verify", "x", "-v"]).is_err());
    }

    #[test]
    fn a_link_named_after_a_verb_runs_that_verb() {
        let run = |given: &[&str]| arguments(given.iter().map(OsString::from));
        assert_eq!(run(&["/bin/fit", "-q"]), ["spharm", "fit", "-q"]);
        assert_eq!(run(&["basis-build"]), ["spharm", "basis-build"]);
        assert_eq!(run(&["spharm", "fit"]), ["spharm", "fit"]);
    }
}
