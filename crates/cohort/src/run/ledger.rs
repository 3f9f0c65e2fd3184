//! Records which rows are in progress, and the outcome of each row as soon as it is known.

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Mutex;
use std::time::Instant;

use super::error::RunError;
use super::event::{Event, Observer, Outcome, RowFit};
use super::params::Cohort;
use super::sync::lock;
use crate::{CohortError, Entry, Row, State, StatusFile};

/// Collects the outcomes of a run's rows, writes them to the table of outcomes, and reports them to the observer.
pub(super) struct Ledger<'a> {
    pub(super) observer: &'a dyn Observer,
    inner: Mutex<Inner>,
}

struct Inner {
    status: Option<StatusFile>,
    /// Rows in progress, with their start times.
    under_way: BTreeMap<usize, Instant>,
    finished: Vec<bool>,
}

impl<'a> Ledger<'a> {
    pub(super) fn new(observer: &'a dyn Observer, rows: usize, status: Option<&Path>) -> Result<Self, CohortError> {
        let status = status.map(StatusFile::open).transpose()?;
        let inner = Inner { status, under_way: BTreeMap::new(), finished: vec![false; rows] };
        Ok(Self { observer, inner: Mutex::new(inner) })
    }

    /// Records that work on a row has begun.
    pub(super) fn start(&self, number: usize, row: &Row) {
        lock(&self.inner).under_way.insert(number, Instant::now());
        self.observer.event(&Event::Started { row });
    }

    /// Records that a row's model has been written.
    pub(super) fn done(&self, number: usize, row: &Row, fit: RowFit) -> Result<(), CohortError> {
        let (msd, xsd) = fit.report.passes.last().map_or((None, None), |last| (last.msd, last.xsd));
        let entry = Entry { msd, xsd, ..Entry::new(&row.id, State::Done) };
        let model = fit.files.model.clone();
        self.finish(number, row, entry, &model, Outcome::Done(Box::new(fit)))
    }

    /// Records that a row was skipped because its model exists.
    pub(super) fn skipped(
        &self,
        number: usize,
        row: &Row,
        label: Option<i64>,
        model: &Path,
    ) -> Result<(), CohortError> {
        self.finish(number, row, Entry::new(&row.id, State::Skipped), model, Outcome::Skipped { label })
    }

    /// Records that a row can't be fitted.
    pub(super) fn failed(&self, number: usize, row: &Row, model: &Path, error: &RunError) -> Result<(), CohortError> {
        let entry = Entry { error: self.observer.line(error), ..Entry::new(&row.id, State::Failed) };
        self.finish(number, row, entry, model, Outcome::Failed(error))
    }

    /// Records the rows in progress after `error` has ended the run. If the error concerns all rows, the rows are
    /// recorded as failed. Otherwise the rows are recorded as interrupted, with the error as the reason unless the run
    /// was cancelled. Failures to write the table are ignored.
    pub(super) fn ended(&self, cohort: &Cohort, error: &RunError) {
        let numbers: Vec<usize> = lock(&self.inner).under_way.keys().copied().collect();
        for number in numbers {
            let row = &cohort.rows[number];
            let model = row.model(&cohort.folder);
            if error.concerns_all() {
                let _ = self.failed(number, row, &model, error);
                continue;
            }
            let mut entry = Entry::new(&row.id, State::Interrupted);
            if !error.is_interrupted() {
                entry.error = format!("the run ended before this row was finished: {}", self.observer.line(error));
            }
            let _ = self.finish(number, row, entry, &model, Outcome::Interrupted);
        }
    }

    /// Returns whether a row's outcome has been recorded.
    pub(super) fn is_finished(&self, number: usize) -> bool {
        lock(&self.inner).finished[number]
    }

    fn finish(
        &self,
        number: usize,
        row: &Row,
        entry: Entry,
        model: &Path,
        outcome: Outcome<'_>,
    ) -> Result<(), CohortError> {
        let mut inner = lock(&self.inner);
        let started = inner.under_way.remove(&number);
        let output = model.to_string_lossy().into_owned();
        let entry = Entry { seconds: started.map(|started| started.elapsed().as_secs_f64()), output, ..entry };
        inner.finished[number] = true;
        let written = inner.status.as_mut().map_or(Ok(()), |status| status.append(&entry));
        drop(inner);
        self.observer.event(&Event::Finished { number, row, entry: &entry, outcome, model });
        written
    }
}
