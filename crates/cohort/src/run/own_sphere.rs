//! Fits surfaces that come without a sphere, and are mapped to spheres of their own.

use spharm::parametrize::Input;
use spharm::{FitParams, Monitor};

use super::error::RunError;
use super::event::{Event, Mapping, RowFit};
use super::groups::Group;
use super::item::Item;
use super::sync::lock;
use super::work::Work;
use crate::Row;
use crate::files::{MadeOf, Mapped};

impl Work<'_> {
    /// Maps each surface of a group to a sphere of its own, writes the sphere beside the model, and fits the surface
    /// over it.
    pub(super) fn on_their_own(&self, group: &Group, monitor: &dyn Monitor) -> Result<(), RunError> {
        for &number in &group.rows {
            self.monitor.check()?;
            let row = &self.cohort.rows[number];
            self.ledger.start(number, row);
            match self.on_its_own(number, row, monitor) {
                Ok(Some(fit)) => self.ledger.done(number, row, fit)?,
                Ok(None) => {}
                Err(error) => self.failed(number, error)?,
            }
        }
        Ok(())
    }

    fn on_its_own(&self, number: usize, row: &Row, monitor: &dyn Monitor) -> Result<Option<RowFit>, RunError> {
        let params = self.weighted(row)?;
        let Some(item) = self.decide(number, None, &params)? else { return Ok(None) };
        let mapped = self.map(row, &item, &params, monitor)?;
        let surface = &mapped.surface;
        let fit_and_write = || -> Result<RowFit, RunError> {
            let (fit, report) = surface.fit(&params, monitor)?;
            self.ledger.observer.event(&Event::Fitted(&report));
            let preparation = self.params.preparation.of(false, item.record.label);
            let made_of = MadeOf { preparation, surface: Some(surface), ..MadeOf::default() };
            let mut fitted = self.write((row, &item), &surface.parametrized.sphere, fit, made_of, &params)?;
            fitted.mapped = Some(Mapping::new(item.files.sphere(), surface));
            Ok(fitted)
        };
        fit_and_write().inspect_err(|_| mapped.remove()).map(Some)
    }

    /// Reads one surface and maps it to a sphere.
    fn map(&self, row: &Row, item: &Item, params: &FitParams, monitor: &dyn Monitor) -> Result<Mapped, RunError> {
        let observer = self.ledger.observer;
        let surface = lock(&self.reader).read(&row.surface, item.record.label, monitor)?;
        if let (Some(_), Input::Label(_)) = (params.area, &surface) {
            return Err(RunError::AreaOfLabel { input: item.record.to_string() });
        }
        for change in surface.changes(self.params.preparation.cut_handles) {
            observer.event(&Event::Warning(&format!("{}: {change}", item.record)));
        }
        let reuse = self.params.if_exists.keeps();
        let mapped = item.files.map(&surface, &item.record, params, reuse, item.replace, monitor);
        let mapped = mapped.map_err(|error| RunError::from(error).of(&item.record))?;
        let report = &mapped.surface.parametrized.map.report;
        let reused = mapped.written.is_empty();
        observer.event(&Event::Mapped { row, sphere: &item.files.sphere(), report, reused });
        report.warnings.iter().for_each(|warning| observer.event(&Event::Warning(&warning.to_string())));
        if let Some(steps) = mapped.surface.steps {
            lock(&self.steps).push((item.record.to_string(), steps));
        }
        report.notes.iter().for_each(|note| observer.event(&Event::Note(&note.to_string())));
        Ok(mapped)
    }
}
