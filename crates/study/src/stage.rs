//! A stage of a study: a command with known inputs and outputs, which runs again only if these have changed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use spharm_cli::inputs::MOST_OWN;
use spharm_surface::io::write_new;

/// A command of a study.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Stage {
    /// Folder of the study file. Recorded paths are relative to it, so that they don't depend on the current folder.
    pub(super) folder: PathBuf,
    /// Name of the stage and of its record.
    pub(super) name: String,
    /// Arguments of spharm, the verb first.
    pub(super) arguments: Vec<String>,
    /// Files that the command reads.
    pub(super) inputs: Vec<PathBuf>,
    /// Files that the command writes, and folders in which it writes all files.
    pub(super) outputs: Vec<PathBuf>,
}

/// Record of a stage that has been run. The stage is run again only if its key or its outputs have changed.
#[derive(Debug, PartialEq, Eq, Serialize, Deserialize)]
struct Record {
    /// BLAKE3 hash of the version, the arguments, and the names and contents of the inputs.
    key: String,
    /// BLAKE3 hash of each output file, by its path relative to the study's folder.
    outputs: BTreeMap<PathBuf, String>,
}

impl Stage {
    /// Returns the command as typed in a shell, with quotes if needed.
    pub(super) fn command(&self) -> String {
        typed(self.arguments.iter())
    }

    /// Returns the command as typed in the study's folder, independent of the folder from which the study was called.
    pub(super) fn command_in_folder(&self) -> String {
        typed(self.arguments_in_folder().collect::<Vec<_>>().iter())
    }

    /// Returns whether the current outputs were made from the current inputs.
    pub(super) fn is_done(&self, records: &Path) -> Result<bool> {
        let Some(record) = self.record(records) else { return Ok(false) };
        // If an output is missing or can't be read, the stage runs again.
        Ok(record.key == self.key()? && self.hashes().is_ok_and(|found| found == record.outputs))
    }

    /// Removes the outputs that an earlier run of the stage wrote, so that no files of subjects that have since been
    /// removed remain.
    pub(super) fn clear(&self, records: &Path) -> Result<()> {
        for (path, _) in self.recorded(records).filter(|(path, _)| path.exists()) {
            std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
        Ok(())
    }

    /// Records that the stage has been run.
    pub(super) fn finish(&self, records: &Path) -> Result<()> {
        let record = Record { key: self.key()?, outputs: self.hashes()? };
        let text = serde_json::to_string_pretty(&record)?;
        write_new(self.file(records), true, |out| writeln!(out, "{text}"))?;
        Ok(())
    }

    /// Returns the outputs of the last run with their BLAKE3 hashes.
    pub(super) fn recorded(&self, records: &Path) -> impl Iterator<Item = (PathBuf, String)> {
        let outputs = self.record(records).map_or(BTreeMap::new(), |record| record.outputs);
        outputs.into_iter().map(|(path, hash)| (self.folder.join(path), hash))
    }

    fn file(&self, records: &Path) -> PathBuf {
        records.join(format!("{}.json", self.name))
    }

    fn record(&self, records: &Path) -> Option<Record> {
        let text = spharm_files::read_text(self.file(records), MOST_OWN).ok()?;
        serde_json::from_str(&text).ok()
    }

    fn key(&self) -> Result<String> {
        let mut hasher = blake3::Hasher::new();
        let mut add = |text: &str| {
            hasher.update(&(text.len() as u64).to_le_bytes());
            hasher.update(text.as_bytes());
        };
        add(env!("CARGO_PKG_VERSION"));
        self.arguments_in_folder().for_each(|argument| add(&argument));
        for path in &self.inputs {
            add(&self.relative(path).to_string_lossy());
            add(&hash(path)?);
        }
        Ok(hasher.finalize().to_hex().to_string())
    }

    fn hashes(&self) -> Result<BTreeMap<PathBuf, String>> {
        let mut files = Vec::new();
        for output in &self.outputs {
            list(output, &mut files)?;
        }
        files.into_iter().map(|path| hash(&path).map(|hash| (self.relative(&path).to_owned(), hash))).collect()
    }

    /// Returns the arguments with paths relative to the study's folder.
    fn arguments_in_folder(&self) -> impl Iterator<Item = String> {
        self.arguments.iter().map(|argument| match argument.strip_prefix('@') {
            Some(list) => format!("@{}", self.relative(Path::new(list)).display()),
            None => self.relative(Path::new(argument)).display().to_string(),
        })
    }

    /// Returns a path relative to the study's folder if the path is in this folder. Returns any other text unchanged.
    fn relative<'a>(&self, path: &'a Path) -> &'a Path {
        path.strip_prefix(&self.folder).ok().filter(|path| !path.as_os_str().is_empty()).unwrap_or(path)
    }
}

/// Returns a command as typed in a shell, with quotes if needed.
fn typed<'a>(arguments: impl Iterator<Item = &'a String>) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./@=,:+".contains(c);
    let quote = |argument: &String| match argument {
        text if !text.is_empty() && text.chars().all(plain) => text.clone(),
        text => format!("'{}'", text.replace('\'', "'\\''")),
    };
    format!("spharm {}", arguments.map(quote).collect::<Vec<_>>().join(" "))
}

/// Removes the outputs of a stage that isn't part of the study any more, the folders that become empty, and the
/// stage's record. A file is removed only if it lies within the study's output and hasn't changed since it was
/// recorded. Recorded paths are relative to `folder`.
pub(super) fn retire(record: &Path, folder: &Path, output: &Path) -> Result<()> {
    let named = || record.display().to_string();
    let text = spharm_files::read_text(record, MOST_OWN).with_context(named)?;
    // A file that isn't the record of a stage belongs to another program and is kept.
    let Ok(found) = serde_json::from_str::<Record>(&text) else { return Ok(()) };
    let outputs = found.outputs.iter().map(|(path, made)| (folder.join(path), made));
    for (path, made) in outputs.filter(|(path, _)| path.starts_with(output)) {
        if path.is_file() && hash(&path).is_ok_and(|found| found == *made) {
            std::fs::remove_file(&path).with_context(|| path.display().to_string())?;
        }
        for folder in path.ancestors().skip(1).take_while(|folder| *folder != output) {
            // `remove_dir` fails if the folder isn't empty.
            if std::fs::remove_dir(folder).is_err() {
                break;
            }
        }
    }
    std::fs::remove_file(record).with_context(named)
}

/// Appends a file, or all files in a folder, to `files`.
fn list(path: &Path, files: &mut Vec<PathBuf>) -> Result<()> {
    if !path.is_dir() {
        files.push(path.to_owned());
        return Ok(());
    }
    for entry in std::fs::read_dir(path).with_context(|| path.display().to_string())? {
        list(&entry.with_context(|| path.display().to_string())?.path(), files)?;
    }
    Ok(())
}

fn hash(path: &Path) -> Result<String> {
    let mut hasher = blake3::Hasher::new();
    let file = spharm_files::open(path).with_context(|| path.display().to_string())?;
    hasher.update_reader(file).with_context(|| path.display().to_string())?;
    Ok(hasher.finalize().to_hex().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_is_done_until_its_inputs_outputs_or_arguments_change() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("made")).unwrap();
        std::fs::write(at("input"), "1").unwrap();
        let mut stage = Stage {
            folder: folder.path().to_owned(),
            name: "align".to_owned(),
            arguments: vec!["shape".to_owned(), "align".to_owned()],
            inputs: vec![at("input")],
            outputs: vec![at("made"), at("mean")],
        };
        assert!(!stage.is_done(folder.path()).unwrap());
        std::fs::write(at("made/a"), "a").unwrap();
        std::fs::write(at("mean"), "m").unwrap();
        stage.finish(folder.path()).unwrap();
        assert!(stage.is_done(folder.path()).unwrap());
        for (name, old) in [("input", "1"), ("made/a", "a"), ("mean", "m")] {
            std::fs::write(at(name), "other").unwrap();
            assert!(!stage.is_done(folder.path()).unwrap(), "{name}");
            std::fs::write(at(name), old).unwrap();
            assert!(stage.is_done(folder.path()).unwrap());
        }
        std::fs::write(at("made/b"), "of somebody else").unwrap();
        assert!(!stage.is_done(folder.path()).unwrap());
        stage.clear(folder.path()).unwrap();
        assert!(!at("made/a").exists() && !at("mean").exists() && at("made/b").exists() && at("input").exists());
        stage.arguments.push("--scale".to_owned());
        assert!(!stage.is_done(folder.path()).unwrap());
        std::fs::write(at("mean"), "m").unwrap();
        stage.finish(folder.path()).unwrap();
        std::fs::write(at("made/b"), "changed since").unwrap();
        retire(&at("align.json"), folder.path(), folder.path()).unwrap();
        assert!(!at("mean").exists() && at("made/b").exists() && !at("align.json").exists());
    }

    #[test]
    fn a_stage_is_the_same_from_wherever_it_is_called() {
        let key = |folder: &str, list: &str| {
            let arguments = ["shape", &format!("@{list}"), list, "--force"].map(str::to_owned).to_vec();
            let (folder, name) = (PathBuf::from(folder), "mean".to_owned());
            Stage { folder, name, arguments, inputs: Vec::new(), outputs: Vec::new() }.key().unwrap()
        };
        let here = key("", "out/models.txt");
        // The stage's key must not depend on the study's folder, even if the folder is called `shape`, like the verb.
        for (folder, list) in
            [("a/b", "a/b/out/models.txt"), (".", "./out/models.txt"), ("/shape", "/shape/out/models.txt")]
        {
            assert_eq!(key(folder, list), here, "{folder}");
        }
        assert_eq!(key("shape", "shape/out/models.txt"), here);
        assert_ne!(key("", "other/models.txt"), here);
    }

    #[test]
    fn commands_can_be_typed() {
        let arguments = ["shape", "mean", "a b", "it's", "", "x=1"].map(str::to_owned).to_vec();
        let (name, folder) = (String::new(), PathBuf::new());
        let stage = Stage { folder, name, arguments, inputs: Vec::new(), outputs: Vec::new() };
        assert_eq!(stage.command(), r"spharm shape mean 'a b' 'it'\''s' '' x=1");
    }
}
