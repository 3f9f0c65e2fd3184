//! Fits surfaces that are given without a sphere. Each is fitted over a sphere that is computed for it.
//!
//! Mapping and fitting a small surface, such as that of a label, is hardly faster with several threads than with one.
//! Therefore several surfaces are processed at the same time, each with an equal share of the memory budget. Surfaces
//! that need more memory are processed one after another, with the whole budget.

use rayon::prelude::*;
use spharm::parametrize::{Input, Warning};
use spharm::{Error, FitParams, Monitor, ParametrizeError, SurfaceError, check_surface};

use super::error::RunError;
use super::event::{Event, Mapping, RowFit};
use super::groups::Group;
use super::item::Item;
use super::sync::lock;
use super::work::Work;
use crate::Row;
use crate::files::{MadeOf, Mapped};

/// Number of surfaces per thread in a batch. If it is too small, threads idle at the end of each batch. If it is too
/// large, each surface gets only a small share of the memory.
const PER_THREAD: usize = 8;

impl Work<'_> {
    /// Maps each surface of a group to a separate sphere, writes the sphere beside the model, and fits the surface over
    /// it. Calls `step(1)` whenever a row is finished.
    pub(super) fn on_their_own(
        &self,
        group: &Group,
        monitor: &dyn Monitor,
        step: &(dyn Fn(usize) + Sync),
    ) -> Result<(), RunError> {
        let threads = rayon::current_num_threads();
        // Without `keep_going`, rows are processed in order, so that no row is processed after a failure.
        let side_by_side = threads > 1 && self.params.keep_going;
        let together = if side_by_side { group.rows.len().min(threads * PER_THREAD) } else { 1 };
        let share = (together > 1).then(|| self.params.fit.memory_budget() / together);
        for numbers in group.rows.chunks(together) {
            self.monitor.check()?;
            let process = |number: usize, share: Option<usize>| {
                let done = self.row(number, share, monitor)?;
                if done {
                    step(1);
                }
                Ok(done)
            };
            let done: Vec<Result<bool, RunError>> =
                numbers.par_iter().with_max_len(1).map(|&number| process(number, share)).collect();
            for (&number, done) in numbers.iter().zip(done) {
                if !done? {
                    process(number, None)?;
                }
            }
        }
        Ok(())
    }

    /// Processes one row, within a share of the memory budget if one is given. Returns false if the share wasn't large
    /// enough, so that the row still has to be processed.
    fn row(&self, number: usize, share: Option<usize>, monitor: &dyn Monitor) -> Result<bool, RunError> {
        self.monitor.check()?;
        let row = &self.cohort.rows[number];
        self.ledger.start(number, row);
        match self.attempt(number, row, share, monitor) {
            Ok(Done::Fitted(fit)) => self.ledger.done(number, row, *fit)?,
            Ok(Done::Skipped) => {}
            Ok(Done::TooLarge) => return Ok(false),
            Err(error) => self.failed(number, error)?,
        }
        Ok(true)
    }

    fn attempt(&self, number: usize, row: &Row, share: Option<usize>, monitor: &dyn Monitor) -> Result<Done, RunError> {
        let params = self.weighted(row)?;
        let Some(item) = self.decide(number, None, &params)? else { return Ok(Done::Skipped) };
        match self.on_its_own(row, &item, share, params, monitor) {
            Err(error) if share.is_some() && matches!(error.of_fit(), Some(spharm::Error::Memory { .. })) => {
                // Keep the decision about the row for a second attempt with the whole budget.
                lock(&self.items).insert(number, item);
                Ok(Done::TooLarge)
            }
            fit => Ok(Done::Fitted(Box::new(fit?))),
        }
    }

    fn on_its_own(
        &self,
        row: &Row,
        item: &Item,
        share: Option<usize>,
        mut params: FitParams,
        monitor: &dyn Monitor,
    ) -> Result<RowFit, RunError> {
        let read = self.reader.read(&row.surface, item.record.label, monitor);
        // Errors about files contain the path. Errors about repairs and cuts don't, so add the input to them.
        let surface = read.map_err(|error| match error {
            Error::Parametrize(
                ParametrizeError::BadSurface { .. }
                | ParametrizeError::InvalidMesh { .. }
                | ParametrizeError::NothingToWrap { .. }
                | ParametrizeError::FarVertex { .. }
                | ParametrizeError::LossyWrap { .. }
                | ParametrizeError::OpenSheet { .. }
                | ParametrizeError::OneSided { .. }
                | ParametrizeError::LargeRepair { .. },
            ) => RunError::from(error).of(&item.record),
            error => error.into(),
        })?;
        if share.is_some() {
            // Check the memory before the surface's repairs are reported. If the share doesn't suffice, a second
            // attempt with the whole budget would report the repairs again.
            params.memory = share;
            check_surface(&surface, &params)?;
        }
        let mapped = self.map(row, item, &surface, &params, monitor)?;
        let surface = &mapped.surface;
        let fit_and_write = || -> Result<RowFit, RunError> {
            let (fit, report) = surface.fit(&params, monitor)?;
            self.ledger.observer.event(&Event::Fitted { report: &report, rows: &[row] });
            let preparation = self.params.preparation.of(false, item.record.label);
            let made_of = MadeOf { preparation, surface: Some(surface), ..MadeOf::default() };
            let mut fitted = self.write((row, item), &surface.parametrized.sphere, fit, made_of, &params)?;
            fitted.mapped = Some(Mapping::new(item.files.sphere(), surface));
            Ok(fitted)
        };
        fit_and_write().inspect_err(|_| mapped.remove())
    }

    /// Maps one surface to a sphere.
    fn map(
        &self,
        row: &Row,
        item: &Item,
        surface: &Input,
        params: &FitParams,
        monitor: &dyn Monitor,
    ) -> Result<Mapped, RunError> {
        let observer = self.ledger.observer;
        if let (Some(_), Input::Label(_)) = (params.area, surface) {
            return Err(RunError::AreaOfLabel { input: item.record.to_string() });
        }
        let repair = surface.label().and_then(|label| label.repair);
        for change in surface.changes(self.params.preparation.cut_handles) {
            let text = format!("{}: {change}", item.record);
            observer.event(&match repair.is_some_and(|repair| repair.is_large_loss()) {
                true => Event::RowWarning(&text),
                false => Event::Warning(&text),
            });
        }
        let reuse = self.params.if_exists.keeps();
        let mapped = item.files.map(surface, &item.record, params, reuse, item.replace, monitor);
        let mapped = mapped.map_err(|error| match error {
            // The user didn't give the name of this file, so name the model to which the file belongs.
            Error::Surface(SurfaceError::OutputExists { .. }) => {
                let model = item.files.model.display();
                let context = format!("{model}: a file beside this model exists, perhaps written by another process");
                RunError::from(error).of(context)
            }
            error => RunError::from(error).of(&item.record),
        })?;
        let report = &mapped.surface.parametrized.map.report;
        let reused = mapped.written.is_empty();
        observer.event(&Event::Mapped { row, sphere: &item.files.sphere(), report, reused });
        for warning in &report.warnings {
            let text = format!("{}: {warning}", item.record);
            observer.event(&match warning {
                Warning::Inward => Event::RowWarning(&text),
                _ => Event::Warning(&text),
            });
        }
        if let Some(steps) = mapped.surface.steps {
            lock(&self.steps).push((item.record.to_string(), steps));
        }
        report.notes.iter().for_each(|note| observer.event(&Event::Note(&note.to_string())));
        Ok(mapped)
    }
}

/// The outcome of a row.
enum Done {
    Fitted(Box<RowFit>),
    Skipped,
    /// The surface needs more than its share of the memory.
    TooLarge,
}
