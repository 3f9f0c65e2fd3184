//! Suggests commands if a word that was given as a verb is an option, or a subcommand of another verb.

use clap::Command;
use clap::error::{ContextKind, ContextValue};

/// Options that users look for as verbs.
const OPTIONS: [(&str, &[&str]); 3] = [
    ("repair", &["spharm fit --fix", "spharm fit --wrap"]),
    ("fix", &["spharm fit --fix"]),
    ("wrap", &["spharm fit --wrap"]),
];

/// Replaces clap's suggestion of similar verbs if an unknown verb is an option, or a subcommand of another verb.
pub(super) fn suggested(mut error: clap::Error, program: &Command) -> clap::Error {
    let others = match error.get(ContextKind::InvalidSubcommand) {
        Some(ContextValue::String(word)) => elsewhere(word, program),
        _ => Vec::new(),
    };
    if !others.is_empty() {
        error.insert(ContextKind::SuggestedSubcommand, ContextValue::Strings(others));
    }
    error
}

/// Returns the commands that a user may mean by a word.
fn elsewhere(word: &str, program: &Command) -> Vec<String> {
    let options = OPTIONS.iter().filter(|(option, _)| *option == word).flat_map(|(_, commands)| *commands);
    let verbs = program.get_subcommands().filter(|verb| verb.find_subcommand(word).is_some());
    let verbs = verbs.map(|verb| format!("spharm {} {word}", verb.get_name()));
    options.map(|&command| command.to_owned()).chain(verbs).collect()
}

#[cfg(test)]
mod tests {
    use crate::Parsed;

    #[test]
    fn verbs_found_elsewhere_are_named() {
        let said = |word: &str| Parsed::of(["spharm", word, "x.ply"]).err().map(|error| error.to_string());
        for (word, command) in [
            ("repair", "'spharm fit --fix', 'spharm fit --wrap'"),
            ("wrap", "a similar subcommand exists: 'spharm fit --wrap'"),
            ("compress", "a similar subcommand exists: 'spharm shape compress'"),
            ("verify", "'spharm store verify'"),
        ] {
            let text = said(word).unwrap_or_default();
            assert!(text.contains(command) && !text.contains("'report'"), "{text}");
        }
    }
}
