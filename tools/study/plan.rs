//! The plan of a study: its subjects, the paths of the files that it makes, and the lists that its stages read.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm_cohort::{Manifest, Merged, Row, State};
use spharm_surface::io::write_new;

use super::config::{Method, Study};
use super::{exclusion, subjects, surfaces};

/// Folder within the output folder for the records from which a study is resumed.
const RECORDS: &str = ".study";
/// Folder of the plain alignment, which is made for comparison.
pub(super) const PLAIN: &str = "plain";

/// A study with its resolved paths and subjects.
pub(super) struct Plan {
    /// The study's file.
    pub(super) file: PathBuf,
    pub(super) study: Study,
    /// The folder that contains the study's file.
    pub(super) folder: PathBuf,
    /// The folder of all outputs.
    pub(super) output: PathBuf,
    pub(super) table: PathBuf,
    /// The subjects, without the excluded ones.
    pub(super) manifest: Manifest,
    /// The excluded subjects, with the reasons.
    pub(super) excluded: Vec<(Row, String)>,
    /// Method of bringing the subjects into correspondence.
    pub(super) method: Method,
    /// Landmark file of each subject, in table order, if the study has landmarks.
    pub(super) landmarks: Option<Vec<PathBuf>>,
    /// Signal files of each subject, in table order.
    pub(super) signals: Vec<Vec<PathBuf>>,
    /// The manifest's text, if the manifest isn't the table itself.
    made_text: Option<Vec<u8>>,
    /// Arguments that all stages share, such as the number of threads.
    pub(super) common: Vec<String>,
}

/// A subject with its model.
pub(super) struct Subject<'a> {
    pub(super) id: &'a str,
    pub(super) cells: &'a [String],
    pub(super) model: PathBuf,
    /// The mesh or volume that is registered.
    pub(super) surface: PathBuf,
    /// Label in the volume.
    pub(super) label: Option<i64>,
    pub(super) landmarks: Option<PathBuf>,
    pub(super) signals: &'a [PathBuf],
}

impl Plan {
    /// Reads a study file and its table.
    pub(super) fn read(path: &Path, common: Vec<String>) -> Result<Self> {
        let study = Study::read(path)?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let table = folder.join(&study.subjects.table);
        let output = folder.join(&study.output);
        let made = output.join(RECORDS).join("manifest.tsv");
        let (mut manifest, mut made_text) = subjects::manifest(&study.subjects, folder, &table, &made)?;
        exclusion::check_ids(&study.subjects.accept, &manifest)
            .with_context(|| format!("{}: `accept` in [subjects]", path.display()))?;
        let excluded = exclusion::exclude(&study.subjects.exclude, &mut manifest, &mut made_text, &made)
            .with_context(|| format!("{}: `exclude` in [subjects]", path.display()))?;
        if let Some(row) = manifest.rows.iter().find(|row| row.output.is_some()) {
            bail!(
                "{}: line {}: a study names its models by the ids; remove the column `output`",
                table.display(),
                row.line
            );
        }
        for test in &study.test {
            for column in test.columns() {
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
        let landmarks = subjects::landmarks(&study.subjects, folder, &table, &manifest)?;
        let signals = subjects::signals(&study.align.signals, folder, &table, &manifest)
            .with_context(|| path.display().to_string())?;
        let spheres = has_one_sphere(&study) || manifest.rows.iter().all(|row| row.sphere.is_some());
        let method = study.align.method.unwrap_or(if spheres { Method::Fixed } else { Method::Correspond });
        let (file, folder) = (path.to_owned(), folder.to_owned());
        Ok(Self {
            file,
            folder,
            output,
            study,
            table,
            manifest,
            excluded,
            method,
            landmarks,
            signals,
            made_text,
            common,
        })
    }

    /// Returns whether all subjects are fitted over one sphere.
    pub(super) fn has_one_sphere(&self) -> bool {
        has_one_sphere(&self.study)
    }

    /// Returns the folder of the files for resuming a study: lists, tables for the tests, records of the stages.
    pub(super) fn records(&self) -> PathBuf {
        self.output.join(RECORDS)
    }

    pub(super) fn status(&self) -> PathBuf {
        self.output.join("status")
    }

    /// Returns the path of the warnings shown at the head of the page.
    pub(super) fn warnings(&self) -> PathBuf {
        self.records().join("warnings").join("all.json")
    }

    /// Returns the path of the warnings of the alignment or the correspondence.
    pub(super) fn alignment_warnings(&self) -> PathBuf {
        let name = if self.method == Method::Correspond { "correspond.json" } else { "align.json" };
        self.records().join("warnings").join(name)
    }

    /// Returns the path of the report of the correspondence.
    pub(super) fn correspondence(&self) -> PathBuf {
        self.records().join("reports").join("correspond.json")
    }

    /// Returns the path of the table of the quality control.
    pub(super) fn checked(&self) -> PathBuf {
        self.output.join("quality.tsv")
    }

    /// Returns the path of the report of the quality control.
    pub(super) fn check_report(&self) -> PathBuf {
        self.records().join("reports").join("check.json")
    }

    /// Returns the folder of the subjects' pictures.
    pub(super) fn thumbnails(&self) -> PathBuf {
        self.output.join("thumbnails")
    }

    /// Returns the folder of the models after alignment or correspondence. Method "none" has no such folder; there the
    /// fitted models are compared.
    pub(super) fn aligned_folder(&self) -> PathBuf {
        self.output.join(if self.method == Method::Correspond { "group" } else { "aligned" })
    }

    /// Returns the path of the mean model.
    pub(super) fn mean(&self) -> PathBuf {
        let folder = if self.method == Method::Correspond { self.aligned_folder() } else { self.output.clone() };
        folder.join("mean.spharm.npz")
    }

    pub(super) fn page(&self) -> PathBuf {
        self.output.join("report.html")
    }

    /// Lists the tables of the subjects' outcomes, one per shard.
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

    /// Returns all subjects in table order, with the paths of their future models.
    pub(super) fn subjects_planned<'s>(&'s self) -> Vec<Subject<'s>> {
        let folder = self.models();
        let of = |(index, row): (usize, &'s Row)| {
            let model = row.model(&folder);
            let landmarks = self.landmarks.as_ref().and_then(|files| files.get(index).cloned());
            let (surface, label) = (row.surface.clone(), row.label);
            let signals = &self.signals[index];
            Subject { id: &row.id, cells: &row.extra, surface, label, model, landmarks, signals }
        };
        self.manifest.rows.iter().enumerate().map(of).collect()
    }

    /// Returns the subjects that were fitted. A subject whose fit fails now is left out, even if its model of an
    /// earlier run exists.
    pub(super) fn subjects(&self, merged: &Merged) -> Vec<Subject<'_>> {
        let done = |id: &str| merged.entry(id).is_some_and(|entry| matches!(entry.state, State::Done | State::Skipped));
        self.subjects_planned().into_iter().filter(|subject| done(subject.id) && subject.model.exists()).collect()
    }

    /// Writes the outcome of each subject for the page. Times are left out, so that equal results give equal bytes.
    pub(super) fn write_status(&self, merged: &Merged) -> Result<()> {
        let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
        writer.write_record(["id", "state", "error", "accepted"].into_iter().chain(self.columns()))?;
        for row in &self.manifest.rows {
            let entry = merged.entry(&row.id);
            let state = match entry.map(|entry| entry.state) {
                Some(State::Done | State::Skipped) => "done",
                Some(State::Failed) => "failed",
                _ => "missing",
            };
            let error = entry.map_or("", |entry| entry.error.as_str());
            let cells = row.extra.iter().map(String::as_str);
            writer.write_record([&row.id, state, error, self.accepted(&row.id)].into_iter().chain(cells))?;
        }
        for (row, reason) in &self.excluded {
            let cells = row.extra.iter().map(String::as_str);
            writer.write_record([&row.id, "excluded", reason, ""].into_iter().chain(cells))?;
        }
        self.write("subjects.tsv", &String::from_utf8(writer.into_inner()?)?)
    }

    /// Writes the warnings shown at the head of the page.
    pub(super) fn write_warnings(&self, warnings: &[String]) -> Result<()> {
        self.write("warnings/all.json", &(serde_json::to_string_pretty(warnings)? + "\n"))
    }

    /// Returns the reason why a subject's flags are accepted; empty if they aren't.
    fn accepted(&self, id: &str) -> &str {
        let named = self.study.subjects.accept.iter().find(|of| of.id == id);
        named.map_or("", |of| if of.reason.is_empty() { "no reason given" } else { &of.reason })
    }

    fn columns(&self) -> impl Iterator<Item = &str> {
        self.manifest.columns.iter().map(String::as_str)
    }

    /// Writes the manifest, unless it is the table itself.
    pub(super) fn write_manifest(&self) -> Result<()> {
        self.made_text.as_deref().map_or(Ok(()), |text| self.write("manifest.tsv", std::str::from_utf8(text)?))
    }

    /// Returns the paths of the models that are compared.
    pub(super) fn aligned(&self, subjects: &[Subject<'_>]) -> Vec<PathBuf> {
        let folder = self.aligned_folder();
        let place = |subject: &Subject<'_>| match (self.method, subject.model.file_name()) {
            (Method::Correspond | Method::Joint | Method::Fixed, Some(name)) => folder.join(name),
            _ => subject.model.clone(),
        };
        subjects.iter().map(place).collect()
    }

    /// Writes the lists and the table that the stages read; leaves a file untouched if its text hasn't changed.
    pub(super) fn write_lists<'s>(&self, subjects: &'s [Subject<'_>]) -> Result<()> {
        let models: Vec<PathBuf> = subjects.iter().map(|subject| subject.model.clone()).collect();
        let aligned = self.aligned(subjects);
        let lines = |paths: &[PathBuf]| -> Result<String> {
            let of = |path: &PathBuf| -> Result<String> { Ok(self.relative(path)? + "\n") };
            paths.iter().map(of).collect()
        };
        self.write("models.txt", &lines(&models)?)?;
        self.write("aligned.txt", &lines(&aligned)?)?;
        if self.method == Method::Correspond {
            let folder = self.output.join(PLAIN);
            let plain = models.iter().filter_map(|model| Some(folder.join(model.file_name()?)));
            self.write("plain.txt", &lines(&plain.collect::<Vec<_>>())?)?;
            let of = |subject: &'s Subject<'_>| surfaces::Member {
                id: subject.id,
                surface: &subject.surface,
                label: subject.label,
                landmarks: subject.landmarks.as_deref(),
                signals: subject.signals,
            };
            let members: Vec<_> = subjects.iter().map(of).collect();
            self.write("surfaces.tsv", &surfaces::table(&members, &self.records())?)?;
            if self.landmarks.is_some() {
                self.write("landmarks.txt", &surfaces::landmarks(&members, &self.records())?)?;
            }
        }
        let mut writer = csv::Writer::from_writer(Vec::new());
        writer.write_record(["id", "model"].into_iter().chain(self.columns()))?;
        for (subject, path) in subjects.iter().zip(&aligned) {
            let path = self.relative(path)?;
            writer.write_record([subject.id, &path].into_iter().chain(subject.cells.iter().map(String::as_str)))?;
        }
        self.write("aligned.csv", &String::from_utf8(writer.into_inner()?)?)
    }

    /// Returns a path in the output relative to the folder of the lists.
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

/// Returns whether one sphere is given for the fits of all subjects.
fn has_one_sphere(study: &Study) -> bool {
    study.fit.arguments.iter().any(|argument| argument.split('=').next() == Some("--sphere"))
}

pub(super) fn text(path: &Path) -> String {
    path.display().to_string()
}
