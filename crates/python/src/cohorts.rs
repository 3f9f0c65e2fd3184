//! Fits cohorts, and passes results to Python as they become available.

use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::mpsc::{Receiver, Sender, channel};

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use serde_json::json;
use spharm::parametrize::volume::{VolumeReading, VoxelValues};
use spharm::{Preparation, SurfaceError};
use spharm_cohort::rerun::IfExists;
use spharm_cohort::run::{Cohort, Event, Observer, Outcome, RunError, RunParams, run};
use spharm_cohort::{CohortError, Entry, Manifest, Row, Shard, check_id};

use crate::errors::{Failure, exception};
use crate::fitting::{Settings, report_of};
use crate::repairs::Changes;
use crate::run::{Started, lock};
use crate::volumes::{axes_of, label_surface_of, reading};

/// A finished row as returned to Python: index, id, state, path of the model, error, report as JSON, seconds.
type Finished = (usize, String, &'static str, PathBuf, Option<String>, Option<String>, Option<f64>);

/// A message from the thread of the run to the Python iterator.
enum Message {
    Finished(Finished),
    Warning(String),
    End(Result<(), Failure>),
}

/// A row of a cohort as passed from Python: id, surface, sphere, weights, output, label, region.
type RowGiven = (String, PathBuf, Option<PathBuf>, Option<PathBuf>, Option<PathBuf>, Option<i64>, Option<PathBuf>);

/// A run in progress. Dropping it cancels the run.
#[pyclass(frozen)]
pub(crate) struct CohortRun {
    receive: Mutex<Receiver<Message>>,
    started: Started,
    rows: usize,
}

/// An observer that sends the events of a run to the Python iterator.
struct Sending(Mutex<Sender<Message>>);

impl Observer for Sending {
    fn event(&self, event: &Event<'_>) {
        let message = match event {
            Event::Finished { number, entry, outcome, model, .. } => {
                Message::Finished(finished(*number, entry, outcome, model))
            }
            Event::FitWarning { row, warning, .. } => Message::Warning(format!("{}: {warning}", row.id)),
            Event::RowWarning(text) | Event::Warning(text) | Event::CohortWarning(text) => {
                Message::Warning((*text).to_owned())
            }
            _ => return,
        };
        // Sending fails if Python has dropped the iterator; the message is then lost.
        drop(lock(&self.0).send(message));
    }
}

fn finished(number: usize, entry: &Entry, outcome: &Outcome<'_>, model: &Path) -> Finished {
    let report = match outcome {
        Outcome::Done(fit) => {
            let mut report = report_of(&fit.report);
            if let Some(report) = report.as_object_mut() {
                report.insert("parametrization".to_owned(), json!(fit.mapped));
            }
            Some(report.to_string())
        }
        _ => None,
    };
    let error = (!entry.error.is_empty()).then(|| entry.error.clone());
    (number, entry.id.clone(), entry.state.name(), model.to_owned(), error, report, entry.seconds)
}

/// Converts a run's error to a failure, which is then raised as an exception.
fn failure(error: RunError) -> Failure {
    match error {
        RunError::Fit(error) => Failure::from(error),
        RunError::Table(CohortError::Io { path, action, source: cause }) => {
            Failure::from(SurfaceError::Io { path, action, cause })
        }
        RunError::Of { context, source } => match *source {
            RunError::Fit(error) => Failure::Member { name: context, error: Box::new(error) },
            source => Failure::Argument(format!("{context}: {}", source.line())),
        },
        error => Failure::Argument(error.line()),
    }
}

#[pymethods]
impl CohortRun {
    /// Starts fitting the rows of a table, or the given rows.
    #[new]
    #[pyo3(signature = (
        table, rows, *, output, sphere, mask, shard, status, exists, keep_going, changes, voxel_size, axes,
        image, threshold, probability, label_surface, smooth_radius, settings
    ))]
    #[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
    fn new(
        py: Python<'_>,
        table: Option<PathBuf>,
        rows: Option<Vec<RowGiven>>,
        output: Option<PathBuf>,
        sphere: Option<PathBuf>,
        mask: Option<PathBuf>,
        shard: Option<String>,
        status: Option<PathBuf>,
        exists: &str,
        keep_going: bool,
        changes: Changes,
        voxel_size: Option<[f64; 3]>,
        axes: &str,
        image: (Option<usize>, Option<usize>),
        threshold: Option<f64>,
        probability: bool,
        label_surface: &str,
        smooth_radius: Option<f64>,
        settings: Settings<'_>,
    ) -> PyResult<Self> {
        let refused = |error: RunError| exception(py, failure(error));
        let shard = shard.map_or(Ok(Shard::default()), |shard| shard.parse::<Shard>());
        let shard = shard.map_err(|error| refused(error.into()))?;
        let cohort = match (table, rows) {
            (Some(table), _) => {
                let manifest = Manifest::read(table).map_err(|error| refused(error.into()))?;
                Cohort::of_manifest(manifest, output, shard)
            }
            (None, rows) => {
                for (id, ..) in rows.iter().flatten() {
                    check_id(id)
                        .map_err(|expected| PyValueError::new_err(format!("table: id {id:?}: expected {expected}")))?;
                }
                let row = |(id, surface, sphere, weights, output, label, region): RowGiven| Row {
                    id,
                    surface,
                    sphere,
                    weights,
                    output,
                    label,
                    region,
                    ..Row::default()
                };
                let rows: Vec<Row> = rows.unwrap_or_default().into_iter().map(row).collect();
                Cohort::new(shard.of(&rows).cloned().collect(), output.unwrap_or_default())
            }
        };
        let cohort = cohort.with_sphere(sphere);
        let fit = settings.params()?.with_threads(settings.threads);
        fit.check().map_err(|error| exception(py, error.into()))?;
        let mut params = RunParams::new(fit);
        let label_surface = label_surface_of(py, label_surface, smooth_radius)?;
        let reading = reading(image, VoxelValues::of(threshold, probability));
        let reading = VolumeReading { voxel_size, axes: axes_of(axes)?, ..reading };
        params.preparation = Preparation { reading, label_surface, ..changes.into() };
        (params.mask, params.status, params.keep_going) = (mask, status, keep_going);
        params.if_exists = match exists {
            "refuse" => IfExists::Refuse,
            "skip" => IfExists::Skip,
            "update" => IfExists::Update,
            "replace" => IfExists::Replace,
            found => {
                let expected = "expected refuse, skip, update or replace";
                return Err(PyValueError::new_err(format!("exists: {expected}; found {found}")));
            }
        };
        let (send, receive) = channel();
        let rows = cohort.rows.len();
        let started = Started::new(settings.threads, move |monitor| {
            let sending = Sending(Mutex::new(send.clone()));
            let done = run(&cohort, &params, &sending, monitor).map_err(failure);
            drop(send.send(Message::End(done)));
        })?;
        Ok(Self { receive: Mutex::new(receive), started, rows })
    }

    fn __len__(&self) -> usize {
        self.rows
    }

    /// Waits for the next finished row. Returns the row, or `None` after the last row, and the warnings issued before
    /// it.
    fn next(&self, py: Python<'_>) -> PyResult<(Option<Finished>, Vec<String>)> {
        let mut warnings = Vec::new();
        loop {
            let message = self.started.wait(py, &self.receive)?;
            match message {
                Some(Message::Finished(row)) => return Ok((Some(row), warnings)),
                Some(Message::Warning(text)) => warnings.push(text),
                Some(Message::End(Err(failure))) => return Err(exception(py, failure)),
                Some(Message::End(Ok(()))) | None => return Ok((None, warnings)),
            }
        }
    }

    /// Cancels the run. The run ends as soon as possible.
    fn stop(&self) {
        self.started.stop();
    }
}
