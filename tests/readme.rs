//! Runs the documentation's commands as printed, and checks its statements about the repository.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::common::{root, succeed, tool};

/// A fenced block of a Markdown file.
struct Block {
    language: String,
    text: String,
}

fn blocks(markdown: &str) -> Vec<Block> {
    let mut blocks: Vec<Block> = Vec::new();
    let mut inside = false;
    for line in markdown.lines() {
        match (line.strip_prefix("```"), inside) {
            (Some(language), false) => {
                blocks.push(Block { language: language.to_owned(), text: String::new() });
                inside = true;
            }
            (Some(_), true) => inside = false,
            (None, true) => {
                if let Some(block) = blocks.last_mut() {
                    block.text += line;
                    block.text.push('\n');
                }
            }
            (None, false) => {}
        }
    }
    blocks
}

fn readme() -> String {
    fs::read_to_string(root().join("README.md")).unwrap()
}

/// Returns all pages of the documentation.
fn pages() -> Vec<PathBuf> {
    let named = |name: &str| root().join(name);
    let mut pages: Vec<_> = ["README.md", "CONTRIBUTING.md", "CHANGELOG.md", "store-format.md"].map(named).into();
    for folder in ["docs", "docs/contributing"] {
        let docs = fs::read_dir(root().join(folder)).unwrap().map(|entry| entry.unwrap().path());
        pages.extend(docs.filter(|path| path.extension().is_some_and(|extension| extension == "md")));
    }
    pages
}

/// Normalises output that differs from run to run: every number becomes `#`, and column widths are ignored.
fn shape(text: &str) -> String {
    let mut shape = String::new();
    let mut number = false;
    for character in text.chars() {
        let of_number = character.is_ascii_digit() || (number && matches!(character, '.' | ',' | 'e' | '-' | '+'));
        match character {
            _ if of_number && !number => shape.push('#'),
            _ if of_number => {}
            ' ' if shape.ends_with([' ', '\n']) || shape.is_empty() => {}
            // A run of rule characters is treated as one, because its length depends on the widths of columns.
            '-' | '─' if shape.ends_with(character) => {}
            _ => shape.push(character),
        }
        number = of_number;
    }
    shape.lines().map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join("\n")
}

/// Runs the blocks marked `sh` one after the other in an empty folder. A block marked `text` after one of them must be
/// its output, except for numbers.
#[test]
fn the_readmes_commands_run_and_print_what_it_says() {
    let folder = tempfile::tempdir().unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_spharm")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let blocks = blocks(&readme());
    let mut printed: Option<String> = None;
    let mut commands = 0;
    for block in &blocks {
        match (block.language.as_str(), printed.take()) {
            ("sh", _) => {
                let mut shell = Command::new("bash");
                shell.args(["-euo", "pipefail", "-c", &block.text]).current_dir(folder.path()).env("PATH", &path);
                shell.env_remove("SPHARM_STORE");
                printed = Some(succeed(&mut shell));
                commands += block.text.lines().filter(|line| line.starts_with("spharm ")).count();
            }
            ("text", Some(output)) => assert_eq!(shape(&output), shape(&block.text), "of {output}"),
            _ => {}
        }
    }
    assert!(commands >= 3, "the README shows {commands} commands");
}

#[test]
fn numbers_and_widths_do_not_count_in_output() {
    assert_eq!(shape("a  1.2e-3   x\n----  --\n\nb 40,962 µm\n"), shape("a 7 x\n-- -\nb 1 µm"));
    assert_ne!(shape("a 1"), shape("b 1"));
}

/// Checks that every option in a command of the documentation exists.
#[test]
fn the_options_in_the_documentation_exist() {
    let mut checked = 0;
    for page in pages() {
        for block in blocks(&fs::read_to_string(&page).unwrap()) {
            let commands = block.text.lines().filter_map(|line| line.strip_prefix("spharm "));
            for command in commands.filter(|_| block.language == "sh") {
                let verb = command.split_whitespace().next().unwrap();
                let help = succeed(tool(verb).arg("--help"));
                for option in command.split_whitespace().filter(|word| word.starts_with("--")) {
                    let known = help.split([' ', ',', '\n', '=', '[']).any(|word| word == option);
                    assert!(known, "{}: spharm {command}: no {option}", page.display());
                    checked += 1;
                }
            }
        }
    }
    assert!(checked > 20, "{checked} options");
}

/// Returns the anchor of a heading, as made by GitHub.
fn anchor(heading: &str) -> String {
    let kept = heading.trim().to_lowercase();
    let kept = kept.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

/// Checks that every link to a file of the repository, or to a heading in one, has a target.
#[test]
fn links_within_the_documentation_lead_somewhere() {
    let mut checked = 0;
    for page in pages() {
        let text = fs::read_to_string(&page).unwrap();
        for link in text.split("](").skip(1).filter_map(|rest| rest.split(')').next()) {
            if link.contains("://") {
                continue;
            }
            let (file, heading) = link.split_once('#').unwrap_or((link, ""));
            let target = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            assert!(target.exists(), "{}: no {link}", page.display());
            if !heading.is_empty() {
                let text = fs::read_to_string(&target).unwrap();
                let mut headings = text.lines().filter(|line| line.starts_with('#'));
                let found = headings.any(|line| anchor(line.trim_start_matches('#')) == heading);
                assert!(found, "{}: no heading for {link}", page.display());
            }
            checked += 1;
        }
    }
    assert!(checked > 10, "{checked} links");
}

/// Checks that every path of the repository in a code span exists.
#[test]
fn paths_in_code_spans_exist() {
    let mut checked = 0;
    for page in pages() {
        let text = fs::read_to_string(&page).unwrap();
        let prose = text.split("```").step_by(2);
        for span in prose.flat_map(|part| part.split('`').skip(1).step_by(2)) {
            let inside = ["crates/", "tools/", "tests/", "docs/", "benches/", "examples/"];
            if inside.iter().any(|folder| span.starts_with(folder)) && !span.contains(char::is_whitespace) {
                assert!(root().join(span).exists(), "{}: no {span}", page.display());
                checked += 1;
            }
        }
    }
    assert!(checked > 10, "{checked} paths");
}

/// The README is a short first page; the rest is in docs/.
#[test]
fn the_readme_is_short() {
    assert!(readme().lines().count() <= 120);
}
