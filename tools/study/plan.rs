//! The stages of a study, each a command of spharm.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm::cohort::{Manifest, Merged, Row, Shard, State};
use spharm_surface::io::write_new;

use super::config::{Method, Study, Test};
use super::stage::Stage;
use super::subjects;

/// The folder in the output of what makes a study resumable.
const RECORDS: &str = ".study";

/// A study in its place.
pub(super) struct Plan {
    /// The study's file.
    pub(super) file: PathBuf,
    pub(super) study: Study,
    /// The folder of that file.
    pub(super) folder: PathBuf,
    /// The folder of all that is made.
    pub(super) output: PathBuf,
    pub(super) table: PathBuf,
    pub(super) manifest: Manifest,
    /// The manifest's text, where it isn't the table itself.
    made_text: Option<Vec<u8>>,
    /// Arguments that all stages share, such as the number of threads.
    pub(super) common: Vec<String>,
}

/// A subject with its model.
pub(super) struct Subject<'a> {
    pub(super) id: &'a str,
    cells: &'a [String],
    pub(super) model: PathBuf,
}

impl Plan {
    /// Reads a study's file and its table.
    pub(super) fn read(path: &Path, common: Vec<String>) -> Result<Self> {
        let study = Study::read(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let table = folder.join(&study.subjects.table);
        let output = folder.join(&study.output);
        let made = output.join(RECORDS).join("manifest.tsv");
        let (manifest, made_text) = subjects::manifest(&study.subjects, folder, &table, &made)?;
        if let Some(row) = manifest.rows.iter().find(|row| row.output.is_some()) {
            bail!(
                "{}: line {}: a study names its models by the ids; leave the column `output` out",
                table.display(),
                row.line
            );
        }
        for test in &study.test {
            for column in std::iter::once(&test.effect).chain(&test.covariates) {
                if !manifest.columns.contains(column) {
                    bail!(
                        "{}: test {:?}: {} has no column {column:?}; it has {}",
                        path.display(),
                        test.name,
                        table.display(),
                        if manifest.columns.is_empty() { "none".to_owned() } else { manifest.columns.join(", ") }
                    );
                }
            }
        }
        let (file, folder) = (path.to_owned(), folder.to_owned());
        Ok(Self { file, folder, output, study, table, manifest, made_text, common })
    }

    /// The folder of what makes a study resumable: lists, tables for the tests, records of the stages.
    pub(super) fn records(&self) -> PathBuf {
        self.output.join(RECORDS)
    }

    pub(super) fn status(&self) -> PathBuf {
        self.output.join("status")
    }

    /// The warnings that the page begins with.
    pub(super) fn warnings(&self) -> PathBuf {
        self.records().join("warnings").join("all.json")
    }

    /// The warnings of the alignment.
    pub(super) fn alignment_warnings(&self) -> PathBuf {
        self.records().join("warnings").join("align.json")
    }

    pub(super) fn page(&self) -> PathBuf {
        self.output.join("report.html")
    }

    /// The tables of what became of each subject, one for each shard.
    pub(super) fn status_files(&self) -> Result<Vec<PathBuf>> {
        let folder = self.status();
        let read = || format!("{}: cannot read the folder", folder.display());
        let mut files = Vec::new();
        for entry in std::fs::read_dir(&folder).with_context(read)? {
            let path = entry.with_context(read)?.path();
            files.extend(path.extension().is_some_and(|ending| ending == "tsv").then_some(path));
        }
        files.sort_unstable();
        Ok(files)
    }

    pub(super) fn models(&self) -> PathBuf {
        self.output.join("models")
    }

    /// All subjects with the models that they will have, in the table's order.
    pub(super) fn subjects_planned(&self) -> Vec<Subject<'_>> {
        let folder = self.models();
        let of = |row: &'_ Row| row.model(&folder);
        self.manifest.rows.iter().map(|row| Subject { id: &row.id, cells: &row.extra, model: of(row) }).collect()
    }

    /// The subjects that were fitted: not those whose model is left from a run before their surface was broken.
    pub(super) fn subjects(&self, merged: &Merged) -> Vec<Subject<'_>> {
        let done = |id: &str| merged.entry(id).is_some_and(|entry| matches!(entry.state, State::Done | State::Skipped));
        self.subjects_planned().into_iter().filter(|subject| done(subject.id) && subject.model.exists()).collect()
    }

    /// Writes what became of each subject, for the page, without times: the same bytes for the same results.
    pub(super) fn write_status(&self, merged: &Merged) -> Result<()> {
        let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
        writer.write_record(["id", "state", "msd", "error"].into_iter().chain(self.columns()))?;
        for row in &self.manifest.rows {
            let entry = merged.entry(&row.id);
            let state = match entry.map(|entry| entry.state) {
                Some(State::Done | State::Skipped) => "done",
                Some(State::Failed) => "failed",
                _ => "missing",
            };
            let msd = entry.and_then(|entry| entry.msd).map_or(String::new(), |msd| format!("{msd:.4e}"));
            let error = entry.map_or("", |entry| entry.error.as_str());
            let cells = row.extra.iter().map(String::as_str);
            writer.write_record([&row.id, state, &msd, error].into_iter().chain(cells))?;
        }
        self.write("subjects.tsv", &String::from_utf8(writer.into_inner()?)?)
    }

    /// Writes the warnings that the page begins with.
    pub(super) fn write_warnings(&self, warnings: &[String]) -> Result<()> {
        self.write("warnings/all.json", &(serde_json::to_string_pretty(warnings)? + "\n"))
    }

    fn columns(&self) -> impl Iterator<Item = &str> {
        self.manifest.columns.iter().map(String::as_str)
    }

    /// Writes the manifest, where it isn't the table itself.
    pub(super) fn write_manifest(&self) -> Result<()> {
        self.made_text.as_deref().map_or(Ok(()), |text| self.write("manifest.tsv", std::str::from_utf8(text)?))
    }

    /// The fits, of which `fit` itself knows what is done.
    pub(super) fn fit(&self, shard: Option<Shard>, force: bool) -> Stage {
        let mut arguments =
            words(&["fit", "--manifest", &text(&self.manifest.path), "--output", &text(&self.models())]);
        arguments.extend(words(&["--max-degree", &self.study.fit.max_degree.to_string(), "--keep-going"]));
        arguments.extend(words(&["--status", &text(&self.status().join(status_name(shard)))]));
        arguments.extend(words(&[if force { "--force" } else { "--update" }]));
        arguments.extend(shard.iter().flat_map(|shard| words(&["--shard", &shard.to_string()])));
        arguments.extend(self.study.fit.arguments.iter().cloned());
        Stage {
            folder: self.folder.clone(),
            name: "fit".to_owned(),
            arguments,
            inputs: Vec::new(),
            outputs: Vec::new(),
        }
    }

    /// The stages after the fits, of the subjects whose models are there.
    pub(super) fn stages(&self, subjects: &[Subject<'_>]) -> Vec<Stage> {
        let (study, at) = (&self.study, |name: &str| self.output.join(name));
        let models: Vec<PathBuf> = subjects.iter().map(|subject| subject.model.clone()).collect();
        let list = |name: &str| format!("@{}", text(&self.records().join(name)));
        let (mean, modes) = (at("mean.spharm.npz"), at("group.shape-model.npz"));
        let mut stages = vec![
            self.stage(
                "measure",
                &["shape", "measure", &list("models.txt"), "--names", "-o", &text(&at("measures.csv"))],
                &models,
                [at("measures.csv")],
            ),
            self.stage(
                "describe",
                &["shape", "describe", &list("models.txt"), "--names", "-o", &text(&at("descriptors.csv"))],
                &models,
                [at("descriptors.csv")],
            ),
        ];
        let aligned = self.aligned(subjects);
        if study.align.method == Method::None {
            let arguments = ["shape", "mean", &list("aligned.txt"), "-o", &text(&mean)];
            stages.push(self.stage("mean", &arguments, &aligned, [mean.clone()]));
        } else {
            let method = if study.align.method == Method::Fixed { "fixed" } else { "joint" };
            let (models_list, folder, mean_text) = (list("models.txt"), text(&at("aligned")), text(&mean));
            let transforms = at("transforms.json");
            let (transforms_text, warnings) = (text(&transforms), self.alignment_warnings());
            let warnings_text = text(&warnings);
            let mut arguments = vec!["shape", "align", &models_list, "--group", "--method", method, "-o", &folder];
            arguments.extend(["--mean", &mean_text, "--transforms", &transforms_text]);
            arguments.extend(["--warnings", &warnings_text]);
            arguments.extend(study.align.scale.then_some("--scale"));
            arguments.extend(study.align.mirror.then_some("--mirror"));
            stages.push(self.stage("align", &arguments, &models, [at("aligned"), mean.clone(), transforms, warnings]));
        }
        let count = study.modes.count.to_string();
        let scores = at("scores.csv");
        let arguments =
            ["shape", "pca", &list("aligned.txt"), "--modes", &count, "--scores", &text(&scores), "-o", &text(&modes)];
        stages.push(self.stage("modes", &arguments, &aligned, [modes, scores]));
        for test in &study.test {
            stages.extend(self.test(test, &aligned));
        }
        stages.push(self.report(subjects));
        stages
    }

    /// A test and its picture.
    fn test(&self, test: &Test, aligned: &[PathBuf]) -> [Stage; 2] {
        let (name, folder) = (format!("test.{}", test.name), self.output.join("tests").join(&test.name));
        let table = self.records().join("aligned.csv");
        let (table_text, folder_text) = (text(&table), text(&folder));
        let (levels, covariates) = (test.levels.join(","), test.covariates.join(","));
        let categorical = test.categorical.join(",");
        let permutations = test.permutations.map(|count| count.to_string());
        let mut arguments = vec!["shape", "test", "--table", &table_text, "--effect", &test.effect, "-o", &folder_text];
        for (flag, value) in [("--levels", &levels), ("--covariates", &covariates), ("--categorical", &categorical)] {
            if !value.is_empty() {
                arguments.extend([flag, value.as_str()]);
            }
        }
        arguments.extend(test.welch.then_some("--welch"));
        arguments.extend(test.signal.iter().flat_map(|signal| ["--signal", signal.as_str()]));
        arguments.extend(permutations.iter().flat_map(|count| ["--permutations", count.as_str()]));
        let inputs: Vec<PathBuf> = std::iter::once(table.clone()).chain(aligned.iter().cloned()).collect();
        let tested = self.stage(&name, &arguments, &inputs, [folder.clone()]);
        let map = if test.permutations == Some(0) { "q" } else { "p-fwe" };
        let (mean, map) = (folder.join("mean.surf.gii"), folder.join(format!("{map}.shape.gii")));
        let picture = self.output.join("figures").join(format!("{}.png", test.name));
        let drawn = self.stage(
            &format!("picture.{}", test.name),
            &["picture", &text(&mean), "--map", &text(&map), "-o", &text(&picture)],
            &[mean.clone(), map.clone()],
            [picture],
        );
        [tested, drawn]
    }

    /// The page: modes, tests, what became of each subject, and with `[page] subjects` their models.
    fn report(&self, subjects: &[Subject<'_>]) -> Stage {
        let (modes, status) = (self.output.join("group.shape-model.npz"), self.records().join("subjects.tsv"));
        let folders: Vec<PathBuf> =
            self.study.test.iter().map(|test| self.output.join("tests").join(&test.name)).collect();
        let list = format!("@{}", text(&self.records().join("models.txt")));
        let mut arguments = vec!["report".to_owned()];
        arguments.extend(self.study.page.subjects.then_some(list));
        let warnings = self.warnings();
        arguments.extend(words(&["--modes", &text(&modes), "--status", &text(&status)]));
        arguments.extend(words(&["--warnings", &text(&warnings)]));
        if !folders.is_empty() {
            arguments.push("--test".to_owned());
            arguments.extend(folders.iter().map(|folder| text(folder)));
        }
        arguments.extend(words(&["--title", &self.study.title, "-o", &text(&self.page()), "--force"]));
        let mut inputs = vec![modes, status, warnings];
        inputs.extend(folders.iter().flat_map(|folder| ["test.csv", "test.json"].map(|name| folder.join(name))));
        inputs.extend(subjects.iter().filter(|_| self.study.page.subjects).map(|subject| subject.model.clone()));
        let (folder, name) = (self.folder.clone(), "report".to_owned());
        Stage { folder, name, arguments, inputs, outputs: vec![self.page()] }
    }

    fn stage<const N: usize>(
        &self,
        name: &str,
        arguments: &[&str],
        inputs: &[PathBuf],
        outputs: [PathBuf; N],
    ) -> Stage {
        let mut arguments = words(arguments);
        arguments.push("--force".to_owned());
        let (folder, name) = (self.folder.clone(), name.to_owned());
        Stage { folder, name, arguments, inputs: inputs.to_vec(), outputs: outputs.to_vec() }
    }

    /// Where the models lie that are compared.
    pub(super) fn aligned(&self, subjects: &[Subject<'_>]) -> Vec<PathBuf> {
        let place = |subject: &Subject<'_>| match (self.study.align.method, subject.model.file_name()) {
            (Method::Joint | Method::Fixed, Some(name)) => self.output.join("aligned").join(name),
            _ => subject.model.clone(),
        };
        subjects.iter().map(place).collect()
    }

    /// Writes the lists and the table that the stages read; a file whose text hasn't changed stays.
    pub(super) fn write_lists(&self, subjects: &[Subject<'_>]) -> Result<()> {
        let models: Vec<PathBuf> = subjects.iter().map(|subject| subject.model.clone()).collect();
        let aligned = self.aligned(subjects);
        let lines = |paths: &[PathBuf]| -> Result<String> {
            let of = |path: &PathBuf| -> Result<String> { Ok(self.relative(path)? + "\n") };
            paths.iter().map(of).collect()
        };
        self.write("models.txt", &lines(&models)?)?;
        self.write("aligned.txt", &lines(&aligned)?)?;
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(["id", "model"].into_iter().chain(self.columns()))?;
        for (subject, path) in subjects.iter().zip(&aligned) {
            let path = self.relative(path)?;
            writer.write_record([subject.id, &path].into_iter().chain(subject.cells.iter().map(String::as_str)))?;
        }
        self.write("aligned.csv", &String::from_utf8(writer.into_inner()?)?)
    }

    /// A path as the lists have it, which lie in a folder of the output.
    fn relative(&self, path: &Path) -> Result<String> {
        let path = path.strip_prefix(&self.output).with_context(|| path.display().to_string())?;
        Ok(Path::new("..").join(path).display().to_string())
    }

    pub(super) fn write(&self, name: &str, text: &str) -> Result<()> {
        let path = self.records().join(name);
        if spharm_files::read(&path, text.len() as u64).is_ok_and(|found| found == text.as_bytes()) {
            return Ok(());
        }
        write_new(&path, true, |out| out.write_all(text.as_bytes()))?;
        Ok(())
    }
}

/// The status file of a shard; of the whole study without one.
fn status_name(shard: Option<Shard>) -> String {
    shard.map_or("all.tsv".to_owned(), |shard| format!("{}.tsv", shard.to_string().replace('/', "-of-")))
}

fn words(words: &[&str]) -> Vec<String> {
    words.iter().map(|word| (*word).to_owned()).collect()
}

fn text(path: &Path) -> String {
    path.display().to_string()
}
