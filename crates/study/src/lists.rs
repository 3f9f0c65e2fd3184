//! Writes the lists of models and the tables of subjects that the stages of a study read.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::config::Method;
use super::fits::SIGNALS_FOLDER;
use super::plan::{PLAIN, Plan, Subject, write_changed};
use super::test::Test;
use super::{sides, surfaces};

/// Name of the file that lists the models of the mirrored subjects.
pub(super) const MIRRORED: &str = "mirrored.txt";
/// Name of the file that lists the models of the mirrored subjects' signals.
pub(super) const MIRRORED_SIGNALS: &str = "mirrored-signals.txt";

impl Plan {
    /// Returns the path of each subject's model for comparisons: the aligned model if the study aligns models,
    /// otherwise the fitted model.
    pub(super) fn aligned(&self, subjects: &[Subject<'_>]) -> Vec<PathBuf> {
        let folder = self.aligned_folder();
        let place = |subject: &Subject<'_>| match (self.method, subject.model.file_name()) {
            (Method::Correspond | Method::Joint | Method::Fixed, Some(name)) => folder.join(name),
            _ => subject.model.clone(),
        };
        subjects.iter().map(place).collect()
    }

    /// Writes the lists and tables that the stages read; leaves a file untouched if its text hasn't changed.
    pub(super) fn write_lists<'s>(&self, subjects: &'s [Subject<'_>]) -> Result<()> {
        let models: Vec<PathBuf> = subjects.iter().map(|subject| subject.model.clone()).collect();
        let aligned = self.aligned(subjects);
        let lines = |paths: &[PathBuf]| -> Result<String> {
            let of = |path: &PathBuf| -> Result<String> { Ok(self.relative(path)? + "\n") };
            paths.iter().map(of).collect()
        };
        self.write("models.txt", &lines(&models)?)?;
        self.write("aligned.txt", &lines(&aligned)?)?;
        if self.has_sides() {
            let of = |models: Vec<PathBuf>| subjects.iter().zip(models).filter(|(subject, _)| subject.mirrored);
            let mirrored = |models| lines(&of(models).map(|(_, model)| model).collect::<Vec<_>>());
            self.write(MIRRORED, &mirrored(models.clone())?)?;
            if let Some(fits) = self.signal_fits() {
                let signals = subjects.iter().map(|subject| fits.model(subject.id)).collect();
                self.write(MIRRORED_SIGNALS, &mirrored(signals)?)?;
            }
        }
        if self.method == Method::Correspond {
            let folder = self.output.join(PLAIN);
            let plain = models.iter().filter_map(|model| Some(folder.join(model.file_name()?)));
            self.write("plain.txt", &lines(&plain.collect::<Vec<_>>())?)?;
            let of = |subject: &'s Subject<'_>| surfaces::Member {
                id: subject.id,
                surface: &subject.surface,
                label: subject.label,
                mirrored: subject.mirrored,
                landmarks: subject.landmarks.as_deref(),
                signals: subject.guides,
            };
            let members: Vec<_> = subjects.iter().map(of).collect();
            self.write("surfaces.tsv", &surfaces::table(&members, &self.records())?)?;
            if self.landmarks.is_some() {
                self.write("landmarks.txt", &surfaces::landmarks(&members, &self.records())?)?;
            }
        }
        self.study.test.iter().try_for_each(|test| self.write_tested(test, subjects))
    }

    /// Returns whether the study includes both sides of each subject.
    pub(super) fn has_sides(&self) -> bool {
        !self.study.subjects.sides.is_empty()
    }

    /// Returns the noun for a row of the manifest: `subject`, or `surface` if a subject may have several rows. A
    /// subject may have several rows in studies with sides or with blocks.
    pub(super) fn row_noun(&self) -> &'static str {
        let has_blocks = self.study.test.iter().any(|test| test.blocks.is_some());
        if self.has_sides() || has_blocks { "surface" } else { "subject" }
    }

    /// Returns the number of subjects. A subject with two sides is counted once.
    pub(super) fn subjects_counted(&self) -> usize {
        let of_sides = if self.has_sides() { sides::subjects(&self.manifest) } else { None };
        of_sides.map_or(self.manifest.rows.len(), |subjects| subjects.len())
    }

    /// Returns the folder of the mirrored signals' models.
    pub(super) fn mirrored_signals(&self) -> PathBuf {
        self.output.join(SIGNALS_FOLDER).join("mirrored")
    }

    /// Returns the rows of a test: the index of the subject, its model, and the model to subtract, if any.
    pub(super) fn tested(&self, test: &Test, subjects: &[Subject<'_>]) -> Vec<(usize, PathBuf, Option<PathBuf>)> {
        let models = match self.signal_fits().filter(|_| test.is_of_values()) {
            None => self.aligned(subjects),
            Some(fits) => {
                let folder = self.mirrored_signals();
                let mirrored = |model: PathBuf| model.file_name().map_or(model.clone(), |name| folder.join(name));
                let of = |subject: &Subject<'_>| {
                    let model = fits.model(subject.id);
                    if subject.mirrored { mirrored(model) } else { model }
                };
                subjects.iter().map(of).collect()
            }
        };
        let rows = sides::tested(
            test,
            &self.study.subjects,
            subjects.iter().map(|subject| subject.cells),
            &self.manifest.columns,
        );
        let pair =
            |(row, other): (usize, Option<usize>)| (row, models[row].clone(), other.map(|other| models[other].clone()));
        rows.into_iter().map(pair).collect()
    }

    /// Returns the path of the table of a test's models.
    pub(super) fn tested_table(&self, test: &Test) -> PathBuf {
        let name = if test.is_of_values() { "signals" } else { "aligned" };
        let side = test.side.as_ref().map_or_else(String::new, |side| format!(".{side}"));
        self.records().join(format!("{name}{side}.csv"))
    }

    /// Returns the names of the columns with models in a test's table. If differences of the sides are tested, these
    /// are the names of the sides; the second column has the models to subtract.
    pub(super) fn model_columns(&self, test: &Test) -> [&str; 2] {
        match &self.study.subjects.sides[..] {
            [first, second] if test.is_of_differences() => [first, second],
            _ => ["model", ""],
        }
    }

    /// Writes the table of a test, with one row per subject: its model, the model to subtract if differences are
    /// tested, and its columns from the study's table.
    fn write_tested(&self, test: &Test, subjects: &[Subject<'_>]) -> Result<()> {
        let mut writer = csv::Writer::from_writer(Vec::new());
        let models = self.model_columns(test).into_iter().filter(|name| !name.is_empty());
        writer.write_record(std::iter::once("id").chain(models).chain(self.columns()))?;
        for (row, model, other) in self.tested(test, subjects) {
            let subject = &subjects[row];
            let paths = std::iter::once(&model).chain(&other).map(|path| self.relative(path));
            let paths = paths.collect::<Result<Vec<_>>>()?;
            let own = std::iter::once(subject.id).chain(paths.iter().map(String::as_str));
            writer.write_record(own.chain(subject.cells.iter().map(String::as_str)))?;
        }
        write_changed(&self.tested_table(test), &String::from_utf8(writer.into_inner()?)?)
    }

    /// Returns a path within the output folder, relative to the folder of the lists.
    fn relative(&self, path: &Path) -> Result<String> {
        let path = path.strip_prefix(&self.output).with_context(|| path.display().to_string())?;
        Ok(Path::new("..").join(path).display().to_string())
    }

    /// Writes a file into the folder of records, unless its text hasn't changed.
    pub(super) fn write(&self, name: &str, text: &str) -> Result<()> {
        write_changed(&self.records().join(name), text)
    }
}
