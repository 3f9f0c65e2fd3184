//! Shows the events of a run on the console or as JSON lines, and summarises them for the report.
//!
//! If a run has more than [`LISTED`] rows, only counts and the rows with the largest errors are kept, so that memory
//! doesn't grow with the number of rows.

use std::collections::{BTreeMap, HashSet};
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use serde_json::json;
use spharm::parametrize::Report;
use spharm::{BatchReport, FitWarning, ManyReport, Seconds};
use spharm_cli::advice;
use spharm_cli::console::Console;
use spharm_cli::exit::line_with_advice;
use spharm_cli::paths::shown;
use spharm_cohort::run::{Event, Observer, Outcome, RowFit, RunError};
use spharm_cohort::{Entry, Row, State};

use super::fitted::Fitted;
use super::options::Options;

/// Largest number of rows that the report and the table list individually.
pub(super) const LISTED: usize = 200;
/// Largest number of failures that the report lists.
const NAMED: usize = 100;
/// Maximum number of failures, and of warnings about rows, that are printed.
const PRINTED: usize = 20;
/// Number of rows above which the warnings are repeated at the end.
const LONG: usize = 10;
/// Number of rows with the largest errors that are shown.
const WORST: usize = 5;

/// Observer of a run that prints its events and collects the summary.
pub(crate) struct Rows<'a> {
    console: &'a Console,
    /// Number of rows.
    rows: usize,
    /// Whether the run ends at the first failure. If so, the failure isn't printed here, because the call returns it as
    /// its error.
    alone: bool,
    /// Whether a later step aligns the models. If so, no warning is given about models that don't correspond yet.
    aligned_later: bool,
    summary: Mutex<Summary>,
    /// The first [`PRINTED`] warnings, which are repeated at the end.
    warnings: Mutex<Vec<String>>,
}

/// Summary of the rows for the report.
#[derive(Default)]
pub(super) struct Summary {
    /// Fitted rows, in row order; `None` if there are more than [`LISTED`] rows.
    pub(super) fitted: Option<Vec<Fitted>>,
    pub(super) skipped: Vec<Skipped>,
    pub(super) failed: Vec<Failed>,
    pub(super) worst: Vec<Distance>,
    msd: Sum,
    xsd: Sum,
    /// Wall time of each stage, in seconds.
    pub(super) seconds: Seconds,
    /// Wall time spent mapping surfaces to spheres, in seconds.
    pub(super) parametrize: f64,
    /// Number of groups of surfaces that were fitted together.
    groups: usize,
    pub(super) scheme: Option<String>,
    pub(super) dtype: Option<&'static str>,
    pub(super) batches: Vec<Batch>,
    numbered: Vec<(usize, Fitted)>,
    states: BTreeMap<State, usize>,
    printed: HashSet<String>,
}

/// Surfaces that were fitted together, with the report on their common fit.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Batch {
    ids: Vec<String>,
    #[serde(flatten)]
    report: BatchReport,
}

/// A surface that was skipped because its model exists.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Skipped {
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    input: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    label: Option<i64>,
    output: String,
}

/// A surface that couldn't be fitted.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Failed {
    pub(super) id: String,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    input: PathBuf,
    error: String,
}

/// Distance of a model from its surface.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Distance {
    pub(super) id: String,
    pub(super) msd: f64,
    pub(super) xsd: f64,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    pub(super) output: PathBuf,
}

/// Running count, sum and maximum of values, from which their mean and maximum are computed.
#[derive(Debug, Clone, Copy, Default)]
struct Sum {
    sum: f64,
    count: usize,
    most: f64,
}

impl Sum {
    fn add(&mut self, value: f64) {
        if value.is_finite() {
            (self.sum, self.count, self.most) = (self.sum + value, self.count + 1, self.most.max(value));
        }
    }

    fn report(self) -> serde_json::Value {
        json!({ "mean": (self.count > 0).then(|| self.sum / self.count as f64), "max": (self.count > 0).then_some(self.most) })
    }
}

impl Summary {
    pub(super) fn count(&self, state: State) -> usize {
        self.states.get(&state).copied().unwrap_or(0)
    }

    /// Returns the number of rows in each state, in the order of [`State::ALL`].
    pub(super) fn counts(&self) -> impl Iterator<Item = (State, usize)> {
        State::ALL.into_iter().map(|state| (state, self.count(state)))
    }

    /// Returns the mean and the maximum, over all fits, of msd (mean squared distance) and of xsd (maximal squared
    /// distance).
    pub(super) fn distances(&self) -> [serde_json::Value; 2] {
        [self.msd.report(), self.xsd.report()]
    }

    fn add_group(&mut self, report: &ManyReport, rows: &[&Row], listed: bool) {
        let (sum, more) = (&mut self.seconds, report.seconds);
        sum.read += more.read;
        sum.plan += more.plan;
        sum.solve += more.solve;
        sum.write += more.write;
        self.groups += 1;
        self.scheme = Some(report.scheme.to_string()).filter(|_| self.groups == 1);
        self.dtype = self.dtype.or(Some(report.scalar.name()));
        if listed {
            let batch = |(report, targets): (&BatchReport, &Vec<usize>)| {
                let ids = targets.iter().filter_map(|&target| rows.get(target)).map(|row| row.id.clone()).collect();
                Batch { ids, report: report.clone() }
            };
            self.batches.extend(report.batches.iter().zip(&report.targets).map(batch));
        }
    }

    fn add_fit(&mut self, number: usize, row: &Row, fit: &RowFit, listed: bool) {
        self.parametrize += fit.mapped.as_ref().map_or(0.0, |mapped| mapped.report.seconds);
        let (msd, xsd) = fit.report.passes.last().map_or((None, None), |last| (last.msd, last.xsd));
        self.msd.add(msd.unwrap_or(f64::NAN));
        self.xsd.add(xsd.unwrap_or(f64::NAN));
        if let (Some(msd), Some(xsd)) = (msd, xsd) {
            self.worst.push(Distance { id: row.id.clone(), msd, xsd, output: fit.files.model.clone() });
            self.worst.sort_by(|a, b| b.xsd.total_cmp(&a.xsd).then_with(|| a.id.cmp(&b.id)));
            self.worst.truncate(WORST);
        }
        if listed {
            self.numbered.push((number, Fitted::new(row, fit)));
        }
    }
}

impl<'a> Rows<'a> {
    pub(crate) fn new(console: &'a Console, rows: usize, options: &Options) -> Self {
        let (alone, aligned_later) = (!options.run.keep_going, options.aligned_later);
        Self { console, rows, alone, aligned_later, summary: Mutex::default(), warnings: Mutex::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Summary> {
        self.summary.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns the summary. `read` is the time spent reading before the run, in seconds.
    pub(super) fn summary(&self, read: f64) -> Summary {
        let mut summary = std::mem::take(&mut *self.lock());
        summary.seconds.read += read;
        summary.numbered.sort_unstable_by_key(|(number, _)| *number);
        let fitted = std::mem::take(&mut summary.numbered).into_iter().map(|(_, fitted)| fitted).collect();
        summary.fitted = (self.rows <= LISTED).then_some(fitted);
        summary
    }

    /// Prints a warning unless the same warning was already printed, up to [`PRINTED`] warnings.
    fn warn_once(&self, warning: String) {
        let mut summary = self.lock();
        let count = summary.printed.len();
        if count > PRINTED || !summary.printed.insert(warning.clone()) {
            return;
        }
        drop(summary);
        if count == PRINTED {
            self.console.warn("further warnings are suppressed");
        } else {
            self.warn(&warning);
        }
    }

    fn warn(&self, warning: &str) {
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        if warnings.len() < PRINTED {
            warnings.push(warning.to_owned());
        }
        self.console.warn(warning);
    }

    /// Repeats the warnings after the table of a long run, so that users don't miss them. In a study, the study repeats
    /// them instead.
    pub(super) fn repeat_warnings(&self) {
        let warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        if self.rows > LONG && !self.aligned_later && !warnings.is_empty() {
            self.console.note("\nwarnings of this run, repeated:");
            warnings.iter().for_each(|warning| self.console.warn(warning));
        }
    }

    /// Prints a note about one surface. In a run of several surfaces, the note is printed only as a detail, because
    /// each surface gets its own line when it is finished.
    fn note(&self, text: impl std::fmt::Display) {
        if self.rows == 1 { self.console.note(text) } else { self.console.detail(text) }
    }

    fn mapped(&self, row: &Row, sphere: &std::path::Path, report: &Report, reused: bool) {
        let (input, path) = (row.surface.display(), sphere.display());
        self.note(match reused {
            true => format!("{path}: reusing the sphere made from {input} by an earlier call"),
            false => {
                let (by, seconds, area) = (&report.method, report.seconds, report.quality.area_rms);
                format!(
                    "{input}: no --sphere given; mapped by {by} in {seconds:.1} s to {path}, with a root mean \
                     square log area ratio of {area:.3}"
                )
            }
        });
    }

    fn finished(&self, number: usize, row: &Row, entry: &Entry, outcome: &Outcome<'_>) {
        let listed = self.rows <= LISTED;
        let mut summary = self.lock();
        let failures = summary.count(State::Failed);
        *summary.states.entry(entry.state).or_default() += 1;
        match outcome {
            Outcome::Done(fit) => summary.add_fit(number, row, fit, listed),
            Outcome::Skipped { label } if listed => {
                let (input, label, output) = (row.surface.clone(), *label, entry.output.clone());
                summary.skipped.push(Skipped { input, label, output });
            }
            Outcome::Failed(_) if failures < NAMED => {
                let (id, input, error) = (row.id.clone(), row.surface.clone(), entry.error.clone());
                summary.failed.push(Failed { id, input, error });
            }
            _ => {}
        }
        let done: usize = summary.states.values().sum();
        drop(summary);
        self.console.event(|| {
            let Entry { id, state, msd, xsd, seconds, error, output } = entry;
            let error = (!error.is_empty()).then_some(error);
            json!({
                "event": state.name(), "id": id, "msd": msd, "xsd": xsd, "seconds": seconds, "error": error, "output": output,
            })
        });
        match (outcome, failures) {
            (Outcome::Done(fit), _) if fit.mapped.is_some() && listed && self.rows > 1 => {
                let (rms, all) = (fit.report.surface_distance.as_ref().map(|of| of.rms_raw), self.rows);
                let rms = rms.map_or(String::new(), |rms| format!("rms {}, ", spharm_monitor::number(rms)));
                let seconds = entry.seconds.unwrap_or(0.0);
                self.console.note(format!("{done} of {all}: {}: {rms}{seconds:.1} s", row.id));
            }
            (Outcome::Failed(_), _) if self.alone => {}
            (Outcome::Failed(_), 0..PRINTED) => self.console.warn(format!("{}: {}", row.id, entry.error)),
            (Outcome::Failed(_), PRINTED) => {
                self.console.warn("further failures are listed only in the --status table and in the report");
            }
            _ => {}
        }
    }
}

impl Observer for Rows<'_> {
    fn event(&self, event: &Event<'_>) {
        let console = self.console;
        match event {
            Event::OwnSpheres(_) if self.aligned_later => {}
            Event::OwnSpheres(_) => console.note(
                "each surface is mapped to its own sphere, in an arbitrary rotation, so coefficients of different models \
                 don't correspond; give a common --sphere for corresponding coefficients",
            ),
            Event::Started { row } => {
                console.event(|| json!({ "event": "start", "id": row.id, "surface": shown(&row.surface) }));
            }
            Event::Mapped { row, sphere, report, reused } => self.mapped(row, sphere, report, *reused),
            Event::LeftOut { row, vertices, all } if self.rows <= LISTED => {
                console.note(format!("{}: {vertices} of {all} vertices are excluded", row.surface.display()));
            }
            Event::FitWarning { row, warning, params } => self.warn_once(match warning {
                FitWarning::Oscillation { .. } => {
                    format!("{}: {warning}; {}", row.surface.display(), advice::of_oscillation(params))
                }
                warning => warning.to_string(),
            }),
            Event::Finished { number, row, entry, outcome, .. } => self.finished(*number, row, entry, outcome),
            Event::Fitted { report, rows } => self.lock().add_group(report, rows, self.rows <= LISTED),
            Event::RowWarning(text) => self.warn_once((*text).to_owned()),
            Event::Warning(text) | Event::CohortWarning(text) => self.warn(text),
            Event::Note(text) => self.note(text),
            _ => {}
        }
    }

    fn line(&self, error: &RunError) -> String {
        line_with_advice(error)
    }
}
