//! Checks which path arguments of a verb are inputs and which are outputs, and refuses conflicts before any work is
//! done.
//!
//! With `--force`, a result written to the path of an input would destroy the input, and a report written to the path
//! of a result would destroy the result. This module checks the paths that are given as arguments. A verb checks the
//! paths that it derives from arguments with [`check_files`](crate::output::check_files).

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use anyhow::{Result, bail};
use clap::{ArgMatches, Command};
use spharm_files::{FileId, file_id};

use crate::inputs::expand_lists;
use crate::output::{is_stdout, is_stream, place};

/// The way in which a verb uses the path in an argument.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Role {
    /// The path is read; `@LIST` names a file of paths.
    Input,
    /// Results are written to the path of a file or folder.
    Output,
    /// A report or a table is written to the path, in addition to the results.
    Report,
    /// Any other use, such as the path of a store or of a data folder, which isn't a single file that is only read or
    /// only written.
    Other,
}

/// A path given as an argument.
#[derive(Debug, Clone)]
pub struct Given {
    path: PathBuf,
    flag: String,
    role: Role,
}

/// Returns the paths in a command's arguments. Given a verb (such as `shape align`) and an argument's name, `role`
/// returns the argument's role, or `None` if the argument isn't a path.
pub fn given(command: &Command, matches: &ArgMatches, role: &dyn Fn(&str, &str) -> Option<Role>) -> Vec<Given> {
    let (mut command, mut matches, mut verb) = (command, matches, String::new());
    let mut found = Vec::new();
    loop {
        for argument in command.get_arguments() {
            let name = argument.get_id().as_str();
            let (Some(role), Ok(Some(values))) = (role(&verb, name), matches.try_get_raw(name)) else { continue };
            let flag = argument.get_long().map_or_else(|| name.to_owned(), |long| format!("--{long}"));
            found.extend(values.map(|path| Given { path: path.into(), flag: flag.clone(), role }));
        }
        let Some((name, inner)) = matches.subcommand() else { return found };
        let Some(subcommand) = command.find_subcommand(name) else { return found };
        verb = format!("{verb} {name}").trim_start().to_owned();
        (command, matches) = (subcommand, inner);
    }
}

/// Refuses reports with the path of another output, and outputs that are the same file as an input (equal device and
/// inode), even with `--force`.
///
/// # Errors
///
/// Returns the first conflict as an error; the message names the flags.
pub fn check(given: &[Given]) -> Result<()> {
    let written = given.iter().filter(|given| matches!(given.role, Role::Output | Role::Report));
    let written: Vec<&Given> = written.filter(|given| !is_stdout(&given.path) && !is_stream(&given.path)).collect();
    let places: Vec<PathBuf> = written.iter().map(|given| place(&given.path)).collect();
    for (at, one) in written.iter().enumerate().filter(|(_, given)| given.role == Role::Report) {
        let same = |&other: &usize| other != at && places[other] == places[at];
        if let Some(other) = (0..written.len()).find(same) {
            let (flag, other) = (&one.flag, &written[other].flag);
            bail!("{}: this path is given for both {other} and {flag}; choose another {flag}", one.path.display());
        }
    }
    let there: HashMap<FileId, &Given> =
        written.into_iter().filter_map(|given| Some((file_id(&given.path)?, given))).collect();
    if there.is_empty() {
        return Ok(());
    }
    for input in given.iter().filter(|given| given.role == Role::Input) {
        let itself = input.path.to_str().and_then(|path| path.strip_prefix('@')).map(PathBuf::from);
        // Skip a list that can't be read, because the verb refuses it later.
        let named = expand_lists(std::slice::from_ref(&input.path)).unwrap_or_default();
        for path in itself.iter().chain(&named) {
            if let Some(output) = file_id(path).and_then(|id| there.get(&id)) {
                return Err(is_input(&output.path, &output.flag));
            }
        }
    }
    Ok(())
}

fn is_input(path: &Path, flag: &str) -> anyhow::Error {
    anyhow::anyhow!("{}: this file is an input; choose another {flag}", path.display())
}

#[cfg(test)]
mod tests {
    use clap::{Arg, ArgAction, value_parser};

    use super::*;

    fn checked(arguments: &[&str]) -> Result<()> {
        let path = |name: &'static str| Arg::new(name).long(name).value_parser(value_parser!(PathBuf));
        let verb = Command::new("verb").args(["output", "report", "sphere"].map(path));
        let verb = verb.arg(Arg::new("surface").action(ArgAction::Append).value_parser(value_parser!(PathBuf)));
        let command = Command::new("x").subcommand(verb);
        let role = |verb: &str, name: &str| match (verb, name) {
            ("verb", "output") => Some(Role::Output),
            ("verb", "report") => Some(Role::Report),
            ("verb", "sphere" | "surface") => Some(Role::Input),
            _ => None,
        };
        let matches = command.clone().get_matches_from(["x", "verb"].iter().chain(arguments));
        check(&given(&command, &matches, &role))
    }

    #[test]
    fn no_output_is_an_input_and_no_report_an_output() {
        let site = tempfile::tempdir().unwrap();
        let at = |name: &str| site.path().join(name).display().to_string();
        for name in ["in.ply", "other.ply"] {
            std::fs::write(at(name), name).unwrap();
        }
        std::fs::hard_link(at("in.ply"), at("hard.ply")).unwrap();
        std::fs::create_dir(at("a")).unwrap();
        std::fs::write(at("list.txt"), "other.ply\nin.ply\n").unwrap();
        let (list, up) = (format!("@{}", at("list.txt")), at("a/../in.ply"));
        for (arguments, fits) in [
            (vec![at("in.ply"), "--output".into(), at("out.ply")], true),
            (vec![at("in.ply"), "--output".into(), at("in.ply")], false),
            (vec![at("in.ply"), "--output".into(), up.clone()], false),
            (vec![at("in.ply"), "--output".into(), at("hard.ply")], false),
            (vec![at("other.ply"), "--output".into(), at("hard.ply")], true),
            (vec![list.clone(), "--output".into(), at("hard.ply")], false),
            (vec![list, "--report".into(), at("list.txt")], false),
            (vec![at("other.ply"), "--sphere".into(), at("in.ply"), "--report".into(), up], false),
            (vec!["--output".into(), at("o.npz"), "--report".into(), at("a/../o.npz")], false),
            (vec!["--output".into(), at("a"), "--report".into(), at("a/o.npz")], true),
            (vec!["--output".into(), at("a"), "--report".into(), "/dev/null".into()], true),
            (vec![at("none.ply"), "--output".into(), at("in.ply"), "--report".into(), "-".into()], true),
        ] {
            let arguments: Vec<&str> = arguments.iter().map(String::as_str).collect();
            let found = checked(&arguments);
            assert_eq!(found.is_ok(), fits, "{arguments:?}: {found:?}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(at("in.ply"), at("soft.ply")).unwrap();
            assert!(checked(&[&at("in.ply"), "--output", &at("soft.ply")]).is_err());
        }
    }
}
