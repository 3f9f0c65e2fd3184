//! The record of a study, provenance.json: all information needed to repeat the study and to check whether its results
//! are the same.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use spharm::Model;
use spharm_cli::inputs::{MOST_OWN, read_text};
use spharm_cli::output::counted;
use spharm_model::FileRecord;

use super::paths::{absolute, ascend};
use super::plan::Plan;
use super::stage::Stage;

/// Name of the record in the study's output.
pub(super) const FILE: &str = "provenance.json";

/// Record of a study. Paths of inputs within the study's folder are relative to this folder.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Provenance {
    tool: String,
    versions: Value,
    /// Name of the study's file.
    file: String,
    /// Text of the study's file.
    study: String,
    /// Relative path from the output folder to the study's folder.
    folder: PathBuf,
    /// Relative path from the study's folder to the output folder.
    output: PathBuf,
    threads: usize,
    /// Arguments of the study that are passed to its commands, such as the memory.
    arguments: Vec<String>,
    table: FileRecord,
    inputs: Vec<Input>,
    excluded: BTreeMap<String, String>,
    accepted: BTreeMap<String, String>,
    commands: Vec<String>,
    /// BLAKE3 hash of each result by its path in the output folder; for a model, the hash of its coefficients.
    outputs: BTreeMap<PathBuf, String>,
}

/// Record of a file that belongs to a subject or a test.
#[derive(Debug, Serialize, Deserialize)]
struct Input {
    id: String,
    #[serde(flatten)]
    file: FileRecord,
}

/// File name extensions of the results that are the same in every run with the same inputs, threads and memory. Reports
/// aren't compared, because they contain times.
const COMPARED: [&str; 5] = ["npz", "csv", "tsv", "gii", "png"];

impl Provenance {
    /// Returns the record of a study. All its fits, and all its stages except the page, must have been run before.
    pub(super) fn of(plan: &Plan, threads: usize, stages: &[&Stage]) -> Result<Self> {
        let (folder, output) = (absolute(&plan.folder)?, absolute(&plan.output)?);
        let relative = |path: &Path| {
            let inner = path.strip_prefix(&folder).or_else(|_| path.strip_prefix(&plan.folder));
            inner.unwrap_or(path).to_string_lossy().into_owned()
        };
        let record =
            |path: &Path| -> Result<FileRecord> { Ok(FileRecord { path: relative(path), ..FileRecord::of(path)? }) };
        let inner = |path: &Path| path.strip_prefix(&plan.output).unwrap_or(path).to_owned();
        let (mut inputs, mut outputs) = (Vec::new(), BTreeMap::new());
        for fits in plan.fits() {
            for row in &fits.manifest.rows {
                // Models record the hashes of the files from which they were made.
                let path = fits.model(&row.id);
                let model = Model::read(&path).ok();
                outputs.extend(model.as_ref().map(|model| (inner(&path), hash(model))));
                let of_model = |file: Option<FileRecord>, path: &Path| match file {
                    Some(file) => Some(FileRecord { path: relative(path), ..file }),
                    None => record(path).ok(),
                };
                let (input, region) =
                    model.map_or((None, None), |model| (model.provenance.input, model.provenance.region));
                let mut files = vec![of_model(input, &row.surface)];
                files.extend(row.region.as_ref().map(|path| of_model(region, path)));
                if fits.is_of_surfaces() {
                    files.extend(row.sphere.as_ref().map(|path| record(path).ok()));
                }
                inputs.extend(files.into_iter().flatten().map(|file| Input { id: row.id.clone(), file }));
            }
        }
        for subject in plan.subjects_planned() {
            for path in subject.landmarks.iter().chain(subject.guides) {
                inputs.push(Input { id: subject.id.to_owned(), file: record(path)? });
            }
        }
        for test in &plan.study.test {
            for path in [&test.mask, &test.sphere, &test.annotation].into_iter().flatten() {
                inputs.push(Input { id: format!("test {}", test.name), file: record(&plan.folder.join(path))? });
            }
        }
        let fits: Vec<Stage> = plan.fits().iter().map(|fits| plan.fit(fits, None, false)).collect();
        let commands = fits.iter().chain(stages.iter().copied()).map(Stage::command_in_folder).collect();
        let records = plan.records();
        let made = stages.iter().flat_map(|stage| stage.recorded(&records));
        for (path, of_file) in made.filter(|(path, _)| is_compared(path)) {
            let is_model = path.to_string_lossy().ends_with(".spharm.npz");
            let hash = if is_model { hash(&Model::read(&path)?) } else { of_file };
            outputs.insert(inner(&path), hash);
        }
        let reasons = |named: &[super::exclusion::Named]| {
            named.iter().map(|of| (of.id.clone(), of.reason.clone())).collect::<BTreeMap<_, _>>()
        };
        let (folder, output) = match output.strip_prefix(&folder) {
            Ok(inner) => (inner.components().map(|_| "..").collect(), inner.to_owned()),
            Err(_) => (folder.clone(), output),
        };
        Ok(Self {
            tool: "study".to_owned(),
            versions: serde_json::to_value(spharm::versions())?,
            file: plan.file.file_name().unwrap_or_default().to_string_lossy().into_owned(),
            study: plan.text.clone(),
            folder,
            output,
            threads,
            arguments: plan.common.clone(),
            table: record(&plan.table)?,
            inputs,
            excluded: reasons(&plan.study.subjects.exclude),
            accepted: reasons(&plan.study.subjects.accept),
            commands,
            outputs,
        })
    }

    /// Reads the record of a study from provenance.json.
    pub(super) fn read(path: &Path) -> Result<Self> {
        let text = read_text(path, "provenance of a study", MOST_OWN)?;
        serde_json::from_str(&text)
            .with_context(|| format!("{}: expected a provenance.json written by `spharm study`", path.display()))
    }

    pub(super) fn text(&self) -> Result<String> {
        Ok(serde_json::to_string_pretty(self)? + "\n")
    }

    /// Returns the plan of the same study with another output folder. `path` is the path of the record itself, from
    /// which the paths of the inputs are resolved.
    ///
    /// # Errors
    ///
    /// If the table or an input is missing or has changed.
    pub(super) fn plan(&self, path: &Path, output: Option<&Path>, common: Vec<String>) -> Result<Plan> {
        let folder = ascend(path.parent().unwrap_or(Path::new("")), &self.folder);
        let output = match output {
            Some(output) => output.to_owned(),
            None => folder.join(format!("{}-again", self.output.display())),
        };
        let inputs = self.inputs.iter().map(|input| &input.file);
        let mut known: HashMap<&str, Result<FileRecord, String>> = HashMap::new();
        let mut changed = Vec::new();
        for file in inputs.chain([&self.table]) {
            let found = known.entry(file.path.as_str());
            let found =
                found.or_insert_with(|| FileRecord::of(&folder.join(&file.path)).map_err(|error| error.to_string()));
            match found {
                Ok(found) if found.blake3 == file.blake3 => {}
                Ok(_) => changed.push(format!("{}: the file has changed", file.path)),
                Err(error) => changed.push(error.clone()),
            }
        }
        if let Some(first) = changed.first() {
            bail!(
                "{}: the results can't be reproduced, because recorded inputs are missing or have changed ({} of {}); \
                 the first: {first}",
                path.display(),
                changed.len(),
                counted(self.inputs.len() + 1, "input"),
            );
        }
        Plan::of_text(&folder.join(&self.file), self.study.clone(), Some(output), common)
    }

    /// Returns the arguments with which the study was run, including the number of threads.
    pub(super) fn arguments(&self) -> Vec<String> {
        let threads = ["--threads".to_owned(), self.threads.to_string()];
        if self.arguments.contains(&threads[0]) {
            self.arguments.clone()
        } else {
            [&threads[..], &self.arguments].concat()
        }
    }

    /// Compares the results of this record with the results of a later run. Returns the number of results, and the
    /// paths of the results that differ or are missing.
    pub(super) fn compare<'a>(&'a self, later: &Self) -> (usize, Vec<&'a Path>) {
        let differ =
            |(path, hash): (&'a PathBuf, &String)| (later.outputs.get(path) != Some(hash)).then_some(path.as_path());
        (self.outputs.len(), self.outputs.iter().filter_map(differ).collect())
    }
}

/// Returns whether the result at this path must be the same in every run, so that it is compared.
fn is_compared(path: &Path) -> bool {
    path.extension().and_then(|ending| ending.to_str()).is_some_and(|ending| COMPARED.contains(&ending))
}

/// Returns the hash of a model's coefficients. The model's provenance isn't hashed, because it contains paths.
fn hash(model: &Model) -> String {
    let mut hasher = blake3::Hasher::new();
    for value in model.coefficients.values() {
        hasher.update(&value.to_le_bytes());
    }
    hasher.finalize().to_hex().to_string()
}
