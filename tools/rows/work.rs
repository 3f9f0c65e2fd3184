//! One row after another: read, map, fit, write.

use std::collections::HashMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use anyhow::{Result, anyhow, bail};
use spharm::cohort::Row;
use spharm::files::MadeOf;
use spharm::parametrize::volume::{VoxelSteps, is_volume};
use spharm::{
    Error, FileRecord, Fit, FitParams, FitWarning, Kind, ModelError, Monitor, Sphere, Stage, SurfaceError, Target,
    fit_each,
};
use spharm_cli::advice;
use spharm_cli::exit::{is_interrupted, line_with_advice};
use spharm_cli::inputs::read_sphere;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::surfaces::{Labels, SurfaceReader};

use super::equal::Inputs;
use super::fitted::{Fitted, Mapped};
use super::groups::{Group, groups};
use super::item::{Item, id};
use super::ledger::{LISTED, Ledger};
use super::options::{Options, Rows};
use super::quiet::Quiet;
use super::report::Totals;
use super::unread;

/// Rows under way.
pub(super) struct Work<'a> {
    pub(super) rows: &'a Rows,
    pub(super) options: &'a Options,
    pub(super) monitor: &'a ConsoleMonitor,
    pub(super) ledger: &'a Ledger<'a>,
    pub(super) reader: Mutex<SurfaceReader>,
    /// What was decided of rows that aren't finished.
    items: Mutex<HashMap<usize, Item>>,
    /// Labels whose models follow the voxels' steps, by their names.
    pub(super) steps: Mutex<Vec<(String, VoxelSteps)>>,
    /// The inputs that have been looked at.
    pub(super) inputs: Mutex<Inputs>,
    /// Of the file that was hashed last: a volume has many labels.
    record: Mutex<Option<(PathBuf, FileRecord)>>,
}

/// Why a row has no model.
enum Broken {
    /// It has one.
    Skip,
    /// It can't be fitted.
    Row(anyhow::Error),
    /// None of those on its sphere can.
    Group(anyhow::Error),
    /// The call is to end.
    Stop(anyhow::Error),
}

impl From<Error> for Broken {
    fn from(error: Error) -> Self {
        match error {
            error if error.is_interrupted() => Self::Stop(error.into()),
            Error::Surface(_) | Error::NotConverged(_) => Self::Row(error.into()),
            error => Self::Group(error.into()),
        }
    }
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl<'a> Work<'a> {
    pub(super) fn new(
        rows: &'a Rows,
        options: &'a Options,
        monitor: &'a ConsoleMonitor,
        ledger: &'a Ledger<'a>,
    ) -> Self {
        let (reader, items, record) = (Mutex::new(options.reader()), Mutex::default(), Mutex::default());
        let (steps, inputs) = (Mutex::default(), Mutex::default());
        Self { rows, options, monitor, ledger, reader, items, steps, inputs, record }
    }

    /// Does all rows.
    pub(super) fn all(&self, totals: &mut Totals) -> Result<()> {
        let mut left: Vec<usize> = (0..self.rows.rows.len()).collect();
        if self.rows.check_first {
            left = self.check(left)?;
        }
        let groups = groups(&self.rows.rows, &left);
        let own = groups.iter().filter(|group| group.sphere.is_none()).map(|group| group.rows.len()).sum::<usize>();
        if own > 1 && !self.options.aligned_later {
            self.monitor.console().note(
                "each surface gets a sphere of its own, turned arbitrarily: coefficients of different models don't \
                 correspond; for that give a common --sphere",
            );
        }
        let quiet = Quiet(self.monitor);
        let many = groups.len() > 1;
        if many {
            self.monitor.begin(Stage::counted("fit", "surfaces"), left.len() as u64);
        }
        let inner: &dyn Monitor = if many { &quiet } else { self.monitor };
        for group in groups {
            self.monitor.check()?;
            match &group.sphere {
                Some(path) => self.on_sphere(path, &group, totals, inner)?,
                None => self.on_their_own(&group, totals, inner)?,
            }
            if many {
                self.monitor.step(group.rows.len() as u64);
            }
        }
        if many {
            self.monitor.end();
        }
        Ok(())
    }

    /// Decides what to do about every row, before any work; returns those that are to be fitted.
    fn check(&self, numbers: Vec<usize>) -> Result<Vec<usize>> {
        let mut left = Vec::new();
        let sphere = self.rows.sphere.as_ref();
        let params = self.masked(self.options.params.clone(), sphere)?;
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

    /// Decides what to do about a row; `None` where its model is there, which is noted down.
    pub(super) fn decide(&self, number: usize, sphere: Option<&Sphere>, params: &FitParams) -> Result<Option<Item>> {
        if let Some(item) = lock(&self.items).remove(&number) {
            return Ok(Some(item));
        }
        let (row, console) = (&self.rows.rows[number], self.monitor.console());
        let label = self.label(row, sphere.is_some())?;
        let record = FileRecord { label, ..self.record_of(&row.surface)? };
        lock(&self.inputs).add_row(row, &record);
        let model = row.model(&self.rows.folder);
        let item = Item::decide(row, model.clone(), record, sphere, params, self.options, console)?;
        if item.is_none() {
            self.ledger.skipped(number, row, label, &model)?;
        }
        Ok(item)
    }

    /// The label that a row's surface is made of; none of a mesh.
    fn label(&self, row: &Row, on_sphere: bool) -> Result<Option<i64>> {
        let volume = is_volume(&row.surface) && !on_sphere;
        match row.label {
            Some(label) if self.rows.check_first => Ok(Some(label)),
            Some(_) if !volume => {
                bail!(
                    "{}: a label is for volumes without a sphere (.nii, .mgz, .nrrd, .tif, .npy)",
                    row.surface.display()
                )
            }
            label if volume => {
                let (path, label) = (row.surface.clone(), label.map(Labels::One));
                let found = lock(&self.reader).surfaces(&[path], label, true, &Quiet(self.monitor))?;
                Ok(found.first().and_then(|(_, label)| *label))
            }
            _ => Ok(None),
        }
    }

    fn record_of(&self, path: &Path) -> Result<FileRecord> {
        if !is_volume(path) {
            return Ok(FileRecord::of(path)?);
        }
        let mut known = lock(&self.record);
        match &*known {
            Some((last, record)) if last == path => Ok(record.clone()),
            _ => Ok(known.insert((path.to_owned(), FileRecord::of(path)?)).1.clone()),
        }
    }

    /// Fits a group over its sphere.
    fn on_sphere(&self, path: &Path, group: &Group, totals: &mut Totals, monitor: &dyn Monitor) -> Result<()> {
        let prepare = || -> Result<(Option<Sphere>, FitParams)> {
            let strict = self.options.params.strict;
            let read = || read_sphere(path, strict, self.monitor.console());
            let own = if self.rows.sphere.is_some() { None } else { Some(read()?) };
            let params = self.params(&self.rows.rows[group.rows[0]])?;
            let params = self.masked(params, own.as_ref().or(self.rows.sphere.as_ref()))?;
            Ok((own, params))
        };
        let fitted = prepare().map_err(Broken::Group).and_then(|(sphere, params)| {
            let Some(sphere) = sphere.as_ref().or(self.rows.sphere.as_ref()) else { return Ok(()) };
            for part in unread::parts(&self.rows.rows, &group.rows, sphere, &params).map_err(Broken::Group)? {
                self.note_unread(&part, sphere);
                let read = |place: usize| self.read(part.rows[place], sphere, &params);
                let done = |place: usize, fit: Result<Fit, Broken>| {
                    self.hand_over(part.rows[place], fit, sphere, &params, &part)
                };
                let (_, report) = fit_each(sphere, part.rows.len(), &read, &part.params, &done, monitor)?;
                totals.add(report, self.rows.rows.len() <= LISTED);
            }
            Ok(())
        });
        match fitted {
            Ok(()) | Err(Broken::Skip) => Ok(()),
            Err(Broken::Stop(error)) => Err(error),
            Err(Broken::Row(error) | Broken::Group(error)) if !self.options.cohort.keep_going => Err(error),
            Err(Broken::Row(error) | Broken::Group(error)) => {
                let name = path.display().to_string();
                let error = error.context(name.clone());
                for &number in group.rows.iter().filter(|&&number| !self.ledger.is_finished(number)) {
                    let row = &self.rows.rows[number];
                    let model = row.model(&self.rows.folder);
                    // The row's own sphere, whose contents are the same.
                    match row.sphere.as_ref().filter(|own| *own != path) {
                        Some(own) => {
                            let line = line_with_advice(&error).replace(&name, &own.display().to_string());
                            self.ledger.failed(number, row, &model, &anyhow!(line))?;
                        }
                        None => self.ledger.failed(number, row, &model, &error)?,
                    }
                }
                Ok(())
            }
        }
    }

    /// Notes how many vertices are left out, unless there are too many rows.
    fn note_unread(&self, part: &unread::Part, sphere: &Sphere) {
        if part.unread == 0 || self.rows.rows.len() > LISTED {
            return;
        }
        for &number in &part.rows {
            let surface = self.rows.rows[number].surface.display();
            let (unread, all) = (part.unread, sphere.directions.len());
            self.monitor.console().note(format!("{surface}: {unread} of {all} vertices aren't read"));
        }
    }

    /// Reads a row's target.
    fn read(&self, number: usize, sphere: &Sphere, params: &FitParams) -> Result<Target, Broken> {
        let row = &self.rows.rows[number];
        self.ledger.start(number, row);
        let item = self.decide(number, Some(sphere), params).map_err(Broken::Row)?.ok_or(Broken::Skip)?;
        let own = own_name(row, sphere);
        let sphere = own.as_ref().unwrap_or(sphere);
        let target = spharm::read_target_with_gaps(&row.surface, sphere).map_err(anyhow::Error::from);
        let target = match &self.options.check {
            Some(check) => check(row, sphere, target),
            None => target,
        };
        let mut target = target.map_err(Broken::Row)?;
        if let Some(region) = row.region.as_ref().filter(|_| target.kind == Kind::Signal) {
            unread::continue_from(region, &mut target, sphere, self.monitor).map_err(Broken::Row)?;
        }
        for warning in &target.warnings {
            let text = format!("{}: {warning}", row.surface.display());
            if params.strict {
                return Err(Broken::Row(anyhow!(text)));
            }
            self.ledger.warn_once(text);
        }
        lock(&self.items).insert(number, item);
        Ok(target)
    }

    fn hand_over(
        &self,
        number: usize,
        fit: Result<Fit, Broken>,
        sphere: &Sphere,
        params: &FitParams,
        part: &unread::Part,
    ) -> Result<(), Broken> {
        let (row, unread) = (&self.rows.rows[number], part.unread);
        let outcome = match fit {
            Ok(mut fit) => {
                // Those that were asked for: gaps of the row itself are no setting.
                fit.report.settings.weights = params.weights.name().to_owned();
                fit.report.settings.weights_hash = params.weights.hash();
                let Some(item) = lock(&self.items).remove(&number) else { return Ok(()) };
                if unread > 0 {
                    let name = row.surface.display().to_string();
                    let warning = unread::runaway(&name, &fit, &part.params, sphere).map_err(Broken::Stop)?;
                    warning.into_iter().for_each(|warning| self.ledger.warn_once(warning));
                }
                let own = own_name(row, sphere);
                self.write((row, &item), own.as_ref().unwrap_or(sphere), fit, MadeOf::default(), params, None)
            }
            Err(Broken::Skip) => return Ok(()),
            Err(Broken::Row(error)) => Err(error),
            Err(other) => return Err(other),
        };
        match outcome {
            Ok(mut fitted) => {
                fitted.unread = (unread > 0).then_some(unread);
                self.ledger.done(number, row, fitted).map_err(Broken::Stop)
            }
            Err(error) => {
                lock(&self.items).remove(&number);
                self.failed(number, error).map_err(Broken::Stop)
            }
        }
    }

    /// Notes down that a row failed; the error itself where that ends the call.
    pub(super) fn failed(&self, number: usize, error: anyhow::Error) -> Result<()> {
        if is_interrupted(&error) {
            return Err(error);
        }
        let row = &self.rows.rows[number];
        let noted = self.ledger.failed(number, row, &row.model(&self.rows.folder), &error);
        // The reason why there is no model is the one to show, also where it couldn't be noted down.
        if !self.options.cohort.keep_going || concerns_all(&error) {
            return Err(error);
        }
        noted
    }

    pub(super) fn write(
        &self,
        (row, item): (&Row, &Item),
        sphere: &Sphere,
        fit: Fit,
        made_of: MadeOf<'_>,
        params: &FitParams,
        mapped: Option<Mapped>,
    ) -> Result<Fitted> {
        for warning in &fit.report.warnings {
            let text = match warning {
                FitWarning::Oscillation { .. } => {
                    format!("{}: {warning}; {}", row.surface.display(), advice::of_oscillation(params))
                }
                warning => warning.to_string(),
            };
            self.ledger.warn_once(text);
        }
        let made_of = MadeOf { id: id(row), input: Some(&item.record), region: item.region.as_ref(), ..made_of };
        if let Some(evaluate) = &self.options.evaluate {
            evaluate.write(&item.files, sphere, &fit, item.replace.beside)?;
        }
        item.files.write(sphere, &fit, &made_of, self.options.coefficients_csv, item.replace)?;
        Ok(Fitted::new(row, item, fit.report, mapped))
    }
}

/// The sphere under the row's own name, where another row's of the same contents was read.
fn own_name(row: &Row, sphere: &Sphere) -> Option<Sphere> {
    let own = row.sphere.as_ref().filter(|path| sphere.path.as_ref() != Some(*path));
    own.map(|path| Sphere { path: Some(path.clone()), ..sphere.clone() })
}

/// Whether every other row would fail alike: there is no room for models, or no right to write them.
pub(crate) fn concerns_all(error: &anyhow::Error) -> bool {
    use ErrorKind::{FileTooLarge, QuotaExceeded, ReadOnlyFilesystem, StorageFull};
    // None of these is an error of reading.
    let kind = |cause: &(dyn std::error::Error + 'static)| match (cause.downcast_ref(), cause.downcast_ref()) {
        (Some(SurfaceError::Io { cause, .. }), _) => Some(cause.kind()),
        (_, Some(Error::Model(ModelError::Surface(SurfaceError::Io { cause, .. })))) => Some(cause.kind()),
        _ => cause.downcast_ref::<std::io::Error>().map(std::io::Error::kind),
    };
    let mut kinds = error.chain().filter_map(kind);
    kinds.any(|kind| matches!(kind, StorageFull | QuotaExceeded | ReadOnlyFilesystem | FileTooLarge))
}
