//! Processes the rows of a run: decides about existing outputs, reads surfaces, fits them and writes models.

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use spharm::parametrize::volume::{VoxelSteps, is_volume};
use spharm::{Error, FileRecord, Fit, FitParams, Kind, Monitor, Sphere, Stage, Target, fit_each};

use super::error::RunError;
use super::event::{Event, RowFit};
use super::groups::{Group, groups};
use super::item::{Item, id};
use super::ledger::Ledger;
use super::mask;
use super::params::{Cohort, RunParams};
use super::quiet::Quiet;
use super::sphere::{read_sphere, scalar_at};
use super::sync::lock;
use crate::Row;
use crate::equal::Inputs;
use crate::files::MadeOf;
use crate::reader::SurfaceReader;

/// State of a run, shared by its threads.
pub(super) struct Work<'a> {
    pub(super) cohort: &'a Cohort,
    pub(super) params: &'a RunParams,
    pub(super) monitor: &'a dyn Monitor,
    pub(super) ledger: &'a Ledger<'a>,
    pub(super) reader: &'a SurfaceReader,
    /// For each row that is to be fitted and isn't finished: its files and the record of its input.
    pub(super) items: Mutex<HashMap<usize, Item>>,
    /// Names of the labels whose models reproduce the staircase of their voxels, each with data about the steps.
    pub(super) steps: Mutex<Vec<(String, VoxelSteps)>>,
    /// The inputs checked so far, to find equal inputs.
    pub(super) inputs: Mutex<Inputs>,
    /// Record of the file that was hashed last. It is kept so that a volume with many labels isn't hashed again for
    /// every label.
    record: Mutex<Option<(PathBuf, FileRecord)>>,
}

/// The reason why a row of a group isn't fitted.
enum NoFit {
    /// The row is skipped because its model exists.
    Skip,
    /// The row can't be fitted.
    Row(RunError),
    /// No row of the group can be fitted.
    Group(RunError),
    /// The run must end.
    Stop(RunError),
}

impl From<Error> for NoFit {
    fn from(error: Error) -> Self {
        match error {
            error if error.is_interrupted() => Self::Stop(error.into()),
            Error::Surface(_) | Error::NotConverged(_) => Self::Row(error.into()),
            error => Self::Group(error.into()),
        }
    }
}

impl<'a> Work<'a> {
    pub(super) fn new(
        cohort: &'a Cohort,
        params: &'a RunParams,
        reader: &'a SurfaceReader,
        monitor: &'a dyn Monitor,
        ledger: &'a Ledger<'a>,
    ) -> Self {
        let (items, record) = (Mutex::default(), Mutex::default());
        let (steps, inputs) = (Mutex::default(), Mutex::default());
        Self { cohort, params, monitor, ledger, reader, items, steps, inputs, record }
    }

    /// Fits all rows.
    pub(super) fn all(&self) -> Result<(), RunError> {
        let mut left: Vec<usize> = (0..self.cohort.rows.len()).collect();
        if self.cohort.check_first {
            left = self.check(left)?;
        }
        let groups = groups(&self.cohort.rows, &left);
        let own = groups.iter().filter(|group| group.sphere.is_none()).map(|group| group.rows.len()).sum::<usize>();
        if own > 1 {
            self.ledger.observer.event(&Event::OwnSpheres(own));
        }
        let quiet = Quiet(self.monitor);
        let many = groups.len() > 1 || own > 1;
        if many {
            self.monitor.begin(Stage::counted("fit", "surfaces"), left.len() as u64);
        }
        let inner: &dyn Monitor = if many { &quiet } else { self.monitor };
        for group in groups {
            self.monitor.check()?;
            let step = |rows: usize| {
                if many {
                    self.monitor.step(rows as u64)
                }
            };
            match &group.sphere {
                Some(path) => {
                    self.on_sphere(path, &group, inner)?;
                    step(group.rows.len());
                }
                None => self.on_their_own(&group, inner, &step)?,
            }
        }
        if many {
            self.monitor.end();
        }
        Ok(())
    }

    /// Decides about every row, before any row is fitted. Returns the indices of the rows to fit.
    fn check(&self, numbers: Vec<usize>) -> Result<Vec<usize>, RunError> {
        let mut left = Vec::new();
        let sphere = self.cohort.sphere.as_ref();
        let params = self.params_at(self.params.fit.clone(), sphere)?;
        for number in numbers {
            match self.decide(number, sphere, &params) {
                Ok(Some(item)) => {
                    lock(&self.items).insert(number, item);
                    left.push(number);
                }
                Ok(None) => {}
                Err(error) => self.failed(number, error)?,
            }
        }
        Ok(left)
    }

    /// Decides whether to fit a row. Returns `None`, and records the row as skipped, if its model exists.
    pub(super) fn decide(
        &self,
        number: usize,
        sphere: Option<&Sphere>,
        params: &FitParams,
    ) -> Result<Option<Item>, RunError> {
        if let Some(item) = lock(&self.items).remove(&number) {
            return Ok(Some(item));
        }
        let row = &self.cohort.rows[number];
        let label = self.label(row, sphere.is_some())?;
        let (record, image) = (self.record_of(&row.surface)?, self.params.preparation.reading.image);
        let record = match label {
            Some(label) => record.with_label(label, [image.channel, image.time]),
            None => record,
        };
        lock(&self.inputs).add_row(row, &record);
        let model = row.model(&self.cohort.folder);
        let item = Item::decide(row, model.clone(), record, sphere, params, self.params)?;
        if item.is_none() {
            self.ledger.skipped(number, row, label, &model)?;
        }
        Ok(item)
    }

    /// Returns the label from which a row's surface is extracted, or `None` for a mesh.
    fn label(&self, row: &Row, on_sphere: bool) -> Result<Option<i64>, RunError> {
        let volume = is_volume(&row.surface) && !on_sphere;
        if let Some(mask) = row.region.as_ref().filter(|_| !on_sphere) {
            // A region applies only to signals, and an input without a sphere is a surface.
            return Err(RunError::MaskedSurface { path: row.surface.clone(), mask: mask.clone() });
        }
        match row.label {
            Some(label) if self.cohort.check_first => Ok(Some(label)),
            Some(_) if !volume => Err(RunError::LabelOfMesh { path: row.surface.clone() }),
            label if volume => Ok(Some(self.reader.volume(&row.surface, &Quiet(self.monitor))?.choose(label)?)),
            _ => Ok(None),
        }
    }

    fn record_of(&self, path: &Path) -> Result<FileRecord, RunError> {
        if !is_volume(path) {
            return Ok(FileRecord::of(path)?);
        }
        let mut known = lock(&self.record);
        match &*known {
            Some((last, record)) if last == path => Ok(record.clone()),
            _ => Ok(known.insert((path.to_owned(), FileRecord::of(path)?)).1.clone()),
        }
    }

    /// Returns the settings of the fit, with the row's weights if the row specifies any.
    pub(super) fn weighted(&self, row: &Row) -> Result<FitParams, RunError> {
        // If the run continues after failures, the row's name is reported with its outcome, so the error doesn't need
        // it.
        mask::weighted(&self.params.fit, row)
            .map_err(|error| if self.params.keep_going { error } else { error.of(&row.id) })
    }

    /// Returns `params` for a sphere, with the weights set to 0 outside the run's mask, if the run has a mask. If
    /// models are kept, the scalar type is set to that of the store, unless another type is requested.
    pub(super) fn params_at(&self, mut params: FitParams, sphere: Option<&Sphere>) -> Result<FitParams, RunError> {
        let Some(sphere) = sphere else { return Ok(params) };
        if self.params.if_exists.keeps() {
            // Look up the type once for the sphere: a look-up for every existing model over the sphere would be slow.
            params.scalar = scalar_at(sphere, &params);
        }
        match &self.params.mask {
            Some(path) => {
                let weights = mask::masked(&params.weights, path, sphere)?;
                Ok(params.with_weights(weights))
            }
            None => Ok(params),
        }
    }

    /// Reads a sphere. Warnings about the sphere are reported, or cause an error in a strict run.
    pub(super) fn sphere(&self, path: &Path) -> Result<Sphere, RunError> {
        let observer = self.ledger.observer;
        read_sphere(path, self.params.fit.strict, &|text| observer.event(&Event::Warning(text)))
    }

    /// Fits the rows of a group over their common sphere.
    fn on_sphere(&self, path: &Path, group: &Group, monitor: &dyn Monitor) -> Result<(), RunError> {
        let prepare = || -> Result<(Option<Sphere>, FitParams), RunError> {
            let own = if self.cohort.sphere.is_some() { None } else { Some(self.sphere(path)?) };
            let params = self.weighted(&self.cohort.rows[group.rows[0]])?;
            let params = self.params_at(params, own.as_ref().or(self.cohort.sphere.as_ref()))?;
            Ok((own, params))
        };
        let fitted = prepare().map_err(NoFit::Group).and_then(|(sphere, params)| {
            let Some(sphere) = sphere.as_ref().or(self.cohort.sphere.as_ref()) else { return Ok(()) };
            for part in mask::parts(&self.cohort.rows, &group.rows, sphere, &params).map_err(NoFit::Group)? {
                self.note_left_out(&part, sphere);
                let read = |place: usize| self.read(part.rows[place], sphere, &params);
                let done = |place: usize, fit: Result<Fit, NoFit>| {
                    self.hand_over(part.rows[place], fit, sphere, &params, &part)
                };
                let (_, report) = fit_each(sphere, part.rows.len(), &read, &part.params, &done, monitor)?;
                let rows: Vec<&Row> = part.rows.iter().map(|&number| &self.cohort.rows[number]).collect();
                self.ledger.observer.event(&Event::Fitted { report: &report, rows: &rows });
            }
            Ok(())
        });
        match fitted {
            Ok(()) | Err(NoFit::Skip) => Ok(()),
            Err(NoFit::Stop(error)) => Err(error),
            Err(NoFit::Row(error) | NoFit::Group(error)) if error.is_interrupted() => Err(error),
            Err(NoFit::Row(error) | NoFit::Group(error)) => self.group_failed(path, group, error),
        }
    }

    /// Records that the rows of a group failed, except those that are finished. Returns the error if it ends the run.
    fn group_failed(&self, path: &Path, group: &Group, error: RunError) -> Result<(), RunError> {
        let name = path.display().to_string();
        let error = if self.params.keep_going { error.of(&name) } else { error };
        for &number in group.rows.iter().filter(|&&number| !self.ledger.is_finished(number)) {
            let row = &self.cohort.rows[number];
            let model = row.model(&self.cohort.folder);
            // If the row's own sphere has another path than the group's (but equal contents), the error names the row's
            // path.
            let own = row.sphere.as_ref().filter(|own| *own != path).map(|own| {
                let line = self.ledger.observer.line(&error).replace(&name, &own.display().to_string());
                RunError::Sphere(line)
            });
            let noted = self.ledger.failed(number, row, &model, own.as_ref().unwrap_or(&error));
            if self.params.keep_going {
                noted?;
            }
        }
        // Return the error of the group, even if recording it failed too.
        if self.params.keep_going { Ok(()) } else { Err(error) }
    }

    fn note_left_out(&self, part: &mask::Part, sphere: &Sphere) {
        for &number in part.rows.iter().filter(|_| part.left_out > 0) {
            let (row, all) = (&self.cohort.rows[number], sphere.directions.len());
            self.ledger.observer.event(&Event::LeftOut { row, vertices: part.left_out, all });
        }
    }

    /// Reads and checks the target of a row.
    fn read(&self, number: usize, sphere: &Sphere, params: &FitParams) -> Result<Target, NoFit> {
        let row = &self.cohort.rows[number];
        self.ledger.start(number, row);
        let item = self.decide(number, Some(sphere), params).map_err(NoFit::Row)?.ok_or(NoFit::Skip)?;
        let own = own_name(row, sphere);
        let sphere = own.as_ref().unwrap_or(sphere);
        let target = spharm::read_target_with_gaps(&row.surface, sphere).map_err(RunError::from);
        let target = match &self.params.check {
            Some(check) => check(row, sphere, target),
            None => target,
        };
        let mut target = target.map_err(NoFit::Row)?;
        if let Some(region) = &row.region {
            if target.kind != Kind::Signal {
                return Err(NoFit::Row(RunError::MaskedSurface { path: row.surface.clone(), mask: region.clone() }));
            }
            mask::continue_from(region, &mut target, sphere, self.monitor).map_err(NoFit::Row)?;
        }
        for mask in self.params.mask.iter().chain(&row.region) {
            target.check_mask(mask, sphere);
        }
        for warning in &target.warnings {
            let text = format!("{}: {warning}", row.surface.display());
            if warning.is_note() {
                self.ledger.observer.event(&Event::Note(&text));
                continue;
            }
            if params.strict {
                return Err(NoFit::Row(RunError::Strict(text)));
            }
            self.ledger.observer.event(&Event::RowWarning(&text));
        }
        lock(&self.items).insert(number, item);
        Ok(target)
    }

    fn hand_over(
        &self,
        number: usize,
        fit: Result<Fit, NoFit>,
        sphere: &Sphere,
        params: &FitParams,
        part: &mask::Part,
    ) -> Result<(), NoFit> {
        let row = &self.cohort.rows[number];
        let outcome = match fit {
            Ok(mut fit) => {
                // Record the requested weights, without the zeros at missing values: these zeros depend on the row's
                // data and aren't a setting.
                fit.report.settings.weights = params.weights.name().to_owned();
                fit.report.settings.weights_hash = params.weights.hash();
                let Some(item) = lock(&self.items).remove(&number) else { return Ok(()) };
                if part.left_out > 0 {
                    let name = row.surface.display().to_string();
                    let warning = mask::runaway(&name, &fit, &part.params, sphere).map_err(NoFit::Stop)?;
                    warning.iter().for_each(|warning| self.ledger.observer.event(&Event::RowWarning(warning)));
                }
                let own = own_name(row, sphere);
                self.write((row, &item), own.as_ref().unwrap_or(sphere), fit, MadeOf::default(), params)
            }
            Err(NoFit::Skip) => return Ok(()),
            Err(NoFit::Row(error)) => Err(error),
            Err(other) => return Err(other),
        };
        match outcome {
            Ok(fitted) => {
                let fitted = RowFit { left_out: part.left_out, ..fitted };
                self.ledger.done(number, row, fitted).map_err(|error| NoFit::Stop(error.into()))
            }
            Err(error) => {
                lock(&self.items).remove(&number);
                self.failed(number, error).map_err(NoFit::Stop)
            }
        }
    }

    /// Records that a row failed. Returns the error if it ends the run.
    pub(super) fn failed(&self, number: usize, error: RunError) -> Result<(), RunError> {
        if error.is_interrupted() {
            return Err(error);
        }
        let row = &self.cohort.rows[number];
        let noted = self.ledger.failed(number, row, &row.model(&self.cohort.folder), &error);
        // Return the error of the row, even if recording it failed too.
        if !self.params.keep_going || error.concerns_all() {
            return Err(error);
        }
        Ok(noted?)
    }

    pub(super) fn write(
        &self,
        (row, item): (&Row, &Item),
        sphere: &Sphere,
        fit: Fit,
        made_of: MadeOf<'_>,
        params: &FitParams,
    ) -> Result<RowFit, RunError> {
        for warning in &fit.report.warnings {
            self.ledger.observer.event(&Event::FitWarning { row, warning, params });
        }
        let made_of = MadeOf { id: id(row), input: Some(&item.record), region: item.region.as_ref(), ..made_of };
        if let Some(evaluate) = &self.params.evaluate {
            evaluate.write(&item.files, sphere, &fit, item.replace.beside)?;
        }
        item.files.write(sphere, &fit, &made_of, self.params.coefficients_csv, item.replace)?;
        if let Some(other) = &item.replaces {
            let text = format!("{}: replaces the model of {other}", item.files.model.display());
            self.ledger.observer.event(&Event::Warning(&text));
        }
        Ok(RowFit { files: item.files.clone(), report: fit.report, left_out: 0, mapped: None })
    }
}

/// Returns a copy of `sphere` with the path that the row gives for its sphere, since rows whose spheres have equal
/// contents share one sphere. Returns `None` if `sphere` already has this path, or if the row has no sphere.
fn own_name(row: &Row, sphere: &Sphere) -> Option<Sphere> {
    let own = row.sphere.as_ref().filter(|path| sphere.path.as_ref() != Some(*path));
    own.map(|path| Sphere { path: Some(path.clone()), ..sphere.clone() })
}
