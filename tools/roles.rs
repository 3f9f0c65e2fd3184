//! Defines the role of each argument that names a file: an input, an output, or an additional report.

use clap::{ArgMatches, Command};
use spharm_cli::roles::{Role, check, given};

/// Refuses arguments in which the same file is both an output and an input, or both a report and another output.
pub(crate) fn check_arguments(command: &Command, matches: &ArgMatches) -> anyhow::Result<()> {
    check(&given(command, matches, &role))
}

/// Returns the role of an argument from its verb and its name.
fn role(verb: &str, name: &str) -> Option<Role> {
    Some(match (verb, name) {
        ("generate", "surface" | "sphere" | "study" | "volumes") => Role::Output,
        ("report", "status" | "warnings" | "quality" | "correspondence") => Role::Input,
        ("report", "check") | ("shape quality" | "shape check", "frames") => Role::Input,
        ("shape check", "aligned" | "mean" | "scores" | "warnings" | "status") => Role::Input,
        ("shape align" | "shape correspond", "mirrored") => Role::Input,
        ("shape check", "thumbnails") => Role::Output,
        ("report", "thumbnails") => Role::Other,
        ("shape test" | "shape correspond", "table") => Role::Input,
        ("shape carry", "group") | (_, "template") => Role::Input,
        ("man", "folder") => Role::Other,
        (_, "report" | "json_file" | "status" | "failed" | "table" | "transforms" | "warnings") => Role::Report,
        (_, "output" | "output_dir" | "surface_output" | "mean" | "scores" | "maps" | "animation" | "curves") => {
            Role::Output
        }
        // The value of `weights` may be a keyword instead of a file, and the value of `minus` may be a folder or a
        // column. Both values are treated as input files, so that no output can overwrite a file with that name.
        (
            _,
            "surface" | "surfaces" | "sphere" | "manifest" | "moments" | "mask" | "annotation" | "weights" | "original",
        )
        | (
            _,
            "again" | "methods" | "provenance" | "reconstruction" | "model" | "models" | "files" | "file" | "samples"
            | "parts" | "map" | "contour" | "fit_report",
        )
        | (_, "modes" | "test" | "a" | "b" | "minus" | "to" | "from" | "among" | "study" | "volumes" | "landmarks") => {
            Role::Input
        }
        (_, "store" | "dir" | "dataset" | "data" | "subjects_dir" | "freesurfer" | "resume") => Role::Other,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use std::any::TypeId;
    use std::path::PathBuf;

    use clap::CommandFactory;

    use super::*;

    fn unknown(verb: &str, command: &Command, found: &mut Vec<String>) {
        for argument in command.get_arguments() {
            let name = argument.get_id().as_str();
            if argument.get_value_parser().type_id() == TypeId::of::<PathBuf>() && role(verb, name).is_none() {
                found.push(format!("{verb} {name}"));
            }
        }
        for subcommand in command.get_subcommands() {
            unknown(format!("{verb} {}", subcommand.get_name()).trim_start(), subcommand, found);
        }
    }

    #[test]
    fn every_path_has_a_role() {
        let mut found = Vec::new();
        unknown("", &crate::Spharm::command(), &mut found);
        assert_eq!(found, Vec::<String>::new(), "say in `role` what these are");
        assert_eq!(role("generate", "sphere"), Some(Role::Output));
        assert_eq!(role("fit", "sphere"), Some(Role::Input));
    }
}
