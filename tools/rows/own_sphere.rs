//! Surfaces that are mapped to spheres of their own.

use anyhow::{Context, Result, bail};
use spharm::cohort::Row;
use spharm::files::{MadeOf, Mapped as Found};
use spharm::parametrize::Input;
use spharm::{FitParams, Monitor};

use super::fitted::{Fitted, Mapped};
use super::groups::Group;
use super::item::Item;
use super::ledger::LISTED;
use super::report::Totals;
use super::work::{Work, lock};

impl Work<'_> {
    /// Maps each surface of a group to a sphere of its own, which is written beside its model, and fits it there.
    pub(super) fn on_their_own(&self, group: &Group, totals: &mut Totals, monitor: &dyn Monitor) -> Result<()> {
        for &number in &group.rows {
            self.monitor.check()?;
            let row = &self.rows.rows[number];
            self.ledger.start(number, row);
            match self.on_its_own(number, row, totals, monitor) {
                Ok(Some(fitted)) => self.ledger.done(number, row, fitted)?,
                Ok(None) => {}
                Err(error) => self.failed(number, error)?,
            }
        }
        Ok(())
    }

    fn on_its_own(
        &self,
        number: usize,
        row: &Row,
        totals: &mut Totals,
        monitor: &dyn Monitor,
    ) -> Result<Option<Fitted>> {
        let params = self.params(row)?;
        let Some(item) = self.decide(number, None, &params)? else { return Ok(None) };
        let found = self.map(row, &item, &params, monitor)?;
        let mapped = Mapped::new(item.files.sphere(), &found.surface);
        totals.parametrize += mapped.report.seconds;
        let fit_and_write = || -> Result<Fitted> {
            let (fit, report) = found.surface.fit(&params, monitor)?;
            totals.add(report, self.rows.rows.len() <= LISTED);
            let preparation = self.options.preparation(false, item.record.label);
            let made_of = MadeOf { preparation, surface: Some(&found.surface), ..MadeOf::default() };
            self.write((row, &item), &found.surface.parametrized.sphere, fit, made_of, &params, Some(mapped))
        };
        let fitted = fit_and_write();
        if fitted.is_err() {
            found.remove();
        }
        fitted.map(Some)
    }

    /// Maps one surface to the sphere.
    fn map(&self, row: &Row, item: &Item, params: &FitParams, monitor: &dyn Monitor) -> Result<Found> {
        let (input, console) = (row.surface.display(), self.monitor.console());
        let surface = lock(&self.reader).read(&row.surface, item.record.label, monitor)?;
        if let (Some(_), Input::Label(_)) = (params.area, &surface) {
            bail!("{}: --area is for meshes; the quadrangles around a label are mapped with equal areas", item.record);
        }
        for change in surface.changes(self.options.cut_handles) {
            console.warn(format!("{}: {change}", item.record));
        }
        let reuse = self.options.if_exists.keeps();
        let found = item.files.map(&surface, &item.record, params, reuse, item.replace, monitor);
        let found = found.with_context(|| input.to_string())?;
        let (report, path) = (&found.surface.parametrized.map.report, item.files.sphere());
        let (path, seconds, area) = (path.display(), report.seconds, report.quality.area_rms);
        console.note(match (found.written.is_empty(), report.method) {
            (true, _) => format!("{path}: the sphere that an earlier call made of {input} is used again"),
            (_, by) => {
                format!(
                    "{input}: no --sphere; mapped by {by} in {seconds:.1} s, log area ratio {area:.3} rms, to {path}"
                )
            }
        });
        report.warnings.iter().for_each(|warning| console.warn(warning));
        if let Some(steps) = found.surface.steps {
            lock(&self.steps).push((item.record.to_string(), steps));
        }
        report.notes.iter().for_each(|note| console.note(note));
        Ok(found)
    }
}
