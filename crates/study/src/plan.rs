//! Plans a study: its subjects, and the paths of the files that it writes.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use spharm_cohort::{Manifest, Row, State};
use spharm_surface::io::write_new;

use super::config::{Method, Study};
use super::fits::{Fits, Outcomes, SIGNALS, SIGNALS_FOLDER, SURFACES};
use super::paths::{absolute, ascend, without_folder};
use super::test::Test;
use super::{exclusion, sides, subjects};

/// Folder within the output folder for the records from which a study is resumed.
const RECORDS: &str = ".study";
/// Name of the folder of the plain alignment, with which the correspondence is compared.
pub(super) const PLAIN: &str = "plain";

/// A study with its resolved paths and subjects.
pub(super) struct Plan {
    /// Path of the study's file.
    pub(super) file: PathBuf,
    /// Text of the study's file.
    pub(super) text: String,
    pub(super) study: Study,
    /// Folder that contains the study's file.
    pub(super) folder: PathBuf,
    /// Folder of all outputs.
    pub(super) output: PathBuf,
    pub(super) table: PathBuf,
    /// Manifest of the subjects, without the excluded subjects.
    pub(super) manifest: Manifest,
    /// Rows of the excluded subjects, with the reasons.
    pub(super) excluded: Vec<(Row, String)>,
    /// Method of bringing the subjects into correspondence.
    pub(super) method: Method,
    /// Landmark file of each subject, in table order, if the study has landmarks.
    pub(super) landmarks: Option<Vec<PathBuf>>,
    /// Files of the signals that guide the correspondence, for each subject in table order.
    pub(super) guides: Vec<Vec<PathBuf>>,
    /// Text of the manifest that the study writes; `None` if the study's table itself is the manifest.
    made_text: Option<Vec<u8>>,
    /// Manifest of the subjects' signals and its text, if the study has signals.
    signals: Option<(Manifest, Vec<u8>)>,
    /// Arguments that are passed to all stages, such as the number of threads.
    pub(super) common: Vec<String>,
}

/// A subject with its model.
pub(super) struct Subject<'a> {
    pub(super) id: &'a str,
    pub(super) cells: &'a [String],
    pub(super) model: PathBuf,
    /// Path of the mesh or volume that is registered.
    pub(super) surface: PathBuf,
    /// Label in the volume; `None` for a mesh.
    pub(super) label: Option<i64>,
    /// Whether the subject is mirrored before it is compared.
    pub(super) mirrored: bool,
    pub(super) landmarks: Option<PathBuf>,
    /// Files of the signals that guide the correspondence.
    pub(super) guides: &'a [PathBuf],
}

impl Plan {
    /// Reads a study file and its table. `output`, if given, overrides the output folder that the file names.
    pub(super) fn read(path: &Path, output: Option<PathBuf>, common: Vec<String>) -> Result<Self> {
        Self::of_text(path, Study::text(path)?, output, common)
    }

    /// Reads the table of a study, as if `text` were the contents of the file at `path`.
    pub(super) fn of_text(path: &Path, text: String, output: Option<PathBuf>, common: Vec<String>) -> Result<Self> {
        let mut study = Study::parse(&text).with_context(|| path.display().to_string())?;
        sides::check(&study).with_context(|| path.display().to_string())?;
        let folder = path.parent().unwrap_or(Path::new(""));
        let table = folder.join(&study.subjects.table);
        let output = match output {
            // Recorded paths are relative to the study's folder, so an output outside this folder needs an absolute
            // path.
            Some(output) if !output.starts_with(folder) => std::path::absolute(output)?,
            Some(output) => output,
            None => folder.join(&study.output),
        };
        let made = output.join(RECORDS).join("manifest.tsv");
        let (mut manifest, mut made_text) = subjects::manifest(&study.subjects, folder, &table, &made)?;
        let of_rows = |listed: &[exclusion::Named]| sides::rows_of(listed, &study.subjects, &manifest);
        let (accept, exclude) = (of_rows(&study.subjects.accept), of_rows(&study.subjects.exclude));
        (study.subjects.accept, study.subjects.exclude) = (accept, exclude);
        exclusion::check_ids(&study.subjects.accept, &manifest)
            .with_context(|| format!("{}: `accept` in [subjects]", path.display()))?;
        let excluded = exclusion::exclude(&study.subjects.exclude, &mut manifest, &mut made_text, &made)
            .with_context(|| format!("{}: `exclude` in [subjects]", path.display()))?;
        if let Some((row, _)) = excluded.iter().find(|(row, _)| study.subjects.accept.iter().any(|of| of.id == row.id))
        {
            bail!("{}: subject {:?} is in both `exclude` and `accept` of [subjects]", path.display(), row.id);
        }
        if let Some(row) = manifest.rows.iter().find(|row| row.output.is_some()) {
            bail!(
                "{}: line {}: a study names its models after the ids; remove the column `output`",
                table.display(),
                row.line
            );
        }
        for test in &study.test {
            let is_column = |name: &str| manifest.columns.iter().any(|other| other == name);
            for column in test.columns(is_column) {
                if !is_column(column) {
                    bail!(
                        "{}: test {:?}: {} has no column {column:?}; its columns are {}",
                        path.display(),
                        test.name,
                        table.display(),
                        if manifest.columns.is_empty() { "none".to_owned() } else { manifest.columns.join(", ") }
                    );
                }
            }
        }
        let landmarks = subjects::landmarks(&study.subjects, folder, &table, &manifest)?;
        let named = || path.display().to_string();
        let guides =
            subjects::guides(&study.align.signals, &study.subjects, folder, &table, &manifest).with_context(named)?;
        let made = output.join(RECORDS).join("signals.tsv");
        let signals = subjects::signals(&study.subjects, folder, &table, &manifest, &made).with_context(named)?;
        let spheres = study.fit.sphere().is_some() || manifest.rows.iter().all(|row| row.sphere.is_some());
        let method = study.align.method.unwrap_or(if spheres { Method::Fixed } else { Method::Correspond });
        let (file, folder) = (path.to_owned(), folder.to_owned());
        Ok(Self {
            file,
            text,
            folder,
            output,
            study,
            table,
            manifest,
            excluded,
            method,
            landmarks,
            guides,
            made_text,
            signals,
            common,
        })
    }

    /// Returns whether all subjects are fitted over one sphere.
    pub(super) fn has_one_sphere(&self) -> bool {
        self.study.fit.sphere().is_some()
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

    /// Returns the folder of the models after alignment or correspondence. Method "none" has no such folder and
    /// compares the fitted models.
    pub(super) fn aligned_folder(&self) -> PathBuf {
        self.output.join(if self.method == Method::Correspond { "group" } else { "aligned" })
    }

    /// Returns the path of the mean model.
    pub(super) fn mean(&self) -> PathBuf {
        let folder = if self.method == Method::Correspond { self.aligned_folder() } else { self.output.clone() };
        folder.join("mean.spharm.npz")
    }

    /// Returns the folder of a test's results.
    pub(super) fn test_folder(&self, test: &Test) -> PathBuf {
        self.output.join("tests").join(&test.name)
    }

    pub(super) fn page(&self) -> PathBuf {
        self.output.join("report.html")
    }

    /// Returns the fits of the surfaces and, after them, the fits of the signals.
    pub(super) fn fits(&self) -> Vec<Fits<'_>> {
        let surfaces = Fits { name: SURFACES, manifest: &self.manifest, models: self.models(), status: self.status() };
        let folder = self.output.join(SIGNALS_FOLDER);
        let of_signals = |manifest| Fits { name: SIGNALS, manifest, status: folder.join("status"), models: folder };
        std::iter::once(surfaces).chain(self.signals.as_ref().map(|(manifest, _)| of_signals(manifest))).collect()
    }

    /// Returns the fits of the signals; `None` if the study has no signals.
    pub(super) fn signal_fits(&self) -> Option<Fits<'_>> {
        self.fits().into_iter().nth(1)
    }

    /// Returns the folder of status files to which messages about failures refer: the signals' folder if only fits of
    /// signals failed, otherwise the surfaces' folder.
    pub(super) fn status_of_failures(&self) -> PathBuf {
        let fails = |fits: &Fits<'_>| fits.merged().is_ok_and(|merged| !fits.failed(&merged).is_empty());
        self.fits().into_iter().find(fails).map_or_else(|| self.status(), |fits| fits.status)
    }

    pub(super) fn models(&self) -> PathBuf {
        self.output.join("models")
    }

    /// Returns all subjects in table order, with the paths at which their models will be written.
    pub(super) fn subjects_planned<'s>(&'s self) -> Vec<Subject<'s>> {
        let folder = self.models();
        let of = |(index, row): (usize, &'s Row)| {
            let model = row.model(&folder);
            let landmarks = self.landmarks.as_ref().and_then(|files| files.get(index).cloned());
            let (surface, label) = (row.surface.clone(), row.label);
            let guides = &self.guides[index];
            let mirrored = sides::is_mirrored(&self.study.subjects, &self.manifest, row);
            Subject { id: &row.id, cells: &row.extra, surface, label, mirrored, model, landmarks, guides }
        };
        self.manifest.rows.iter().enumerate().map(of).collect()
    }

    /// Returns the subjects that were fitted. Skips a subject whose last fit failed, even if its model of an earlier
    /// run exists.
    pub(super) fn subjects(&self, outcomes: &Outcomes) -> Vec<Subject<'_>> {
        let fits = self.fits();
        let done = |id: &str| outcomes.is_done(id) && fits.iter().all(|fits| fits.model(id).exists());
        self.subjects_planned().into_iter().filter(|subject| done(subject.id)).collect()
    }

    /// Writes the outcome of each subject for the page. Times are omitted and paths are relative to the study's folder,
    /// so that equal results give equal bytes.
    pub(super) fn write_status(&self, outcomes: &Outcomes) -> Result<()> {
        let mut writer = csv::WriterBuilder::new().delimiter(b'\t').from_writer(Vec::new());
        writer.write_record(["id", "state", "error", "accepted"].into_iter().chain(self.columns()))?;
        for row in &self.manifest.rows {
            let entry = outcomes.entry(&row.id);
            let state = match entry.map(|entry| entry.state) {
                Some(State::Done | State::Skipped) => "done",
                Some(State::Failed) => "failed",
                _ => "missing",
            };
            let error = entry.map_or_else(String::new, |entry| self.in_folder(&entry.error));
            let cells = row.extra.iter().map(String::as_str);
            writer.write_record([&row.id, state, error.as_str(), self.accepted(&row.id)].into_iter().chain(cells))?;
        }
        for (row, reason) in &self.excluded {
            let cells = row.extra.iter().map(String::as_str);
            writer.write_record([&row.id, "excluded", reason, ""].into_iter().chain(cells))?;
        }
        self.write("subjects.tsv", &String::from_utf8(writer.into_inner()?)?)
    }

    /// Replaces the paths in a message that lie in the study's folder by paths relative to this folder, so that the
    /// message doesn't depend on the current folder.
    fn in_folder(&self, message: &str) -> String {
        // Absolute forms of the folder's path are removed as well, because a manifest written by the study contains
        // absolute paths, with or without `..`.
        let whole = absolute(&self.folder).unwrap_or_default();
        let folders = [self.folder.clone(), ascend(Path::new(""), &whole), whole];
        folders.iter().fold(message.to_owned(), |message, folder| without_folder(&message, &text(&folder.join(""))))
    }

    /// Writes the warnings shown at the head of the page.
    pub(super) fn write_warnings(&self, warnings: &[String]) -> Result<()> {
        self.write("warnings/all.json", &(serde_json::to_string_pretty(warnings)? + "\n"))
    }

    /// Returns the reason why a subject's flags are accepted; empty if they aren't accepted.
    fn accepted(&self, id: &str) -> &str {
        let named = self.study.subjects.accept.iter().find(|of| of.id == id);
        named.map_or("", |of| if of.reason.is_empty() { "no reason given" } else { &of.reason })
    }

    pub(super) fn columns(&self) -> impl Iterator<Item = &str> {
        self.manifest.columns.iter().map(String::as_str)
    }

    /// Writes the manifests, unless the study's table itself is the manifest.
    pub(super) fn write_manifests(&self) -> Result<()> {
        let signals = self.signals.as_ref().map(|(_, text)| ("signals.tsv", text));
        let made = self.made_text.as_ref().map(|text| ("manifest.tsv", text)).into_iter().chain(signals);
        made.into_iter().try_for_each(|(name, text)| self.write(name, std::str::from_utf8(text)?))
    }
}

/// Writes a file, unless its text hasn't changed.
pub(super) fn write_changed(path: &Path, text: &str) -> Result<()> {
    if spharm_files::read(path, text.len() as u64).is_ok_and(|found| found == text.as_bytes()) {
        return Ok(());
    }
    write_new(path, true, |out| out.write_all(text.as_bytes()))?;
    Ok(())
}

pub(super) fn text(path: &Path) -> String {
    path.display().to_string()
}
