//! What becomes of rows, as it becomes known: counts, the status file, events, and what the report will show.
//!
//! Of more rows than [`LISTED`] only counts and the worst are kept, so that memory doesn't grow with their number.

use std::collections::BTreeMap;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Instant;

use anyhow::Result;
use serde::Serialize;
use serde_json::json;
use spharm::cohort::{Entry, Row, State, StatusFile};
use spharm_cli::console::Console;
use spharm_cli::exit::line_with_advice;
use spharm_cli::paths::shown;

use super::fitted::Fitted;

/// Most rows of which the report and the table show each.
pub(super) const LISTED: usize = 200;
/// Most failures that the report names.
const NAMED: usize = 100;
/// Most failures, and warnings of batches, that are printed.
const PRINTED: usize = 20;
/// How many of the worst are shown.
const WORST: usize = 5;

/// What becomes of rows.
pub(super) struct Ledger<'a> {
    console: &'a Console,
    /// Rows of this call.
    rows: usize,
    /// Warnings of failures are left to the call's own error.
    alone: bool,
    inner: Mutex<Inner>,
}

#[derive(Default)]
struct Inner {
    counts: BTreeMap<&'static str, usize>,
    status: Option<StatusFile>,
    /// Rows that are being worked on, and since when.
    under_way: BTreeMap<usize, Instant>,
    fitted: Vec<(usize, Fitted)>,
    skipped: Vec<Skipped>,
    failed: Vec<Failed>,
    worst: Vec<Distance>,
    msd: Sum,
    xsd: Sum,
    shown: HashSet<String>,
    finished: Vec<bool>,
}

/// A surface whose model is there already.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Skipped {
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    input: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    label: Option<i64>,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    output: PathBuf,
}

/// A surface that can't be fitted.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Failed {
    pub(super) id: String,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    input: PathBuf,
    error: String,
}

/// How far a model is from its surface.
#[derive(Debug, Clone, Serialize)]
pub(super) struct Distance {
    pub(super) id: String,
    pub(super) msd: f64,
    pub(super) xsd: f64,
    #[serde(serialize_with = "spharm_cli::paths::serialize_shown")]
    pub(super) output: PathBuf,
}

/// Mean and maximum of what was added.
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

/// What the report shows of the rows.
pub(super) struct Outcome {
    /// Rows by state, in the order of [`State::ALL`].
    pub(super) counts: Vec<(State, usize)>,
    /// Each, where there are few; in the order of the rows.
    pub(super) fitted: Option<Vec<Fitted>>,
    pub(super) skipped: Vec<Skipped>,
    pub(super) failed: Vec<Failed>,
    pub(super) worst: Vec<Distance>,
    /// msd and xsd of all.
    pub(super) distances: [serde_json::Value; 2],
}

impl Outcome {
    pub(super) fn count(&self, state: State) -> usize {
        self.counts.iter().find(|(of, _)| *of == state).map_or(0, |(_, count)| *count)
    }
}

impl<'a> Ledger<'a> {
    /// A ledger of so many rows; `goes_on` whether failures don't end the call.
    pub(super) fn new(console: &'a Console, rows: usize, status: Option<&Path>, goes_on: bool) -> Result<Self> {
        let status = status.map(StatusFile::open).transpose()?;
        let inner = Mutex::new(Inner { status, finished: vec![false; rows], ..Inner::default() });
        Ok(Self { console, rows, alone: !goes_on, inner })
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A row is being worked on.
    pub(super) fn start(&self, number: usize, row: &Row) {
        self.lock().under_way.insert(number, Instant::now());
        self.console.event(|| json!({ "event": "start", "id": row.id, "surface": shown(&row.surface) }));
    }

    /// A row's model was made.
    pub(super) fn done(&self, number: usize, row: &Row, fitted: Fitted) -> Result<()> {
        let (msd, xsd) = fitted.distances();
        let output = fitted.output.clone();
        let entry = Entry { msd, xsd, ..Entry::new(&row.id, State::Done) };
        self.finish(number, entry, &output, |inner| {
            inner.msd.add(msd.unwrap_or(f64::NAN));
            inner.xsd.add(xsd.unwrap_or(f64::NAN));
            if let (Some(msd), Some(xsd)) = (msd, xsd) {
                inner.worst.push(Distance { id: row.id.clone(), msd, xsd, output: output.clone() });
                inner.worst.sort_by(|a, b| b.xsd.total_cmp(&a.xsd).then_with(|| a.id.cmp(&b.id)));
                inner.worst.truncate(WORST);
            }
            if self.rows <= LISTED {
                inner.fitted.push((number, fitted));
            }
        })
    }

    /// A row's model was there.
    pub(super) fn skipped(&self, number: usize, row: &Row, label: Option<i64>, output: &Path) -> Result<()> {
        self.finish(number, Entry::new(&row.id, State::Skipped), output, |inner| {
            if self.rows <= LISTED {
                inner.skipped.push(Skipped { input: row.surface.clone(), label, output: output.to_owned() });
            }
        })
    }

    /// A row can't be fitted.
    pub(super) fn failed(&self, number: usize, row: &Row, output: &Path, error: &anyhow::Error) -> Result<()> {
        let error = line_with_advice(error);
        let entry = Entry { error: error.clone(), ..Entry::new(&row.id, State::Failed) };
        let mut printed = 0;
        self.finish(number, entry, output, |inner| {
            printed = inner.failed.len();
            if inner.failed.len() < NAMED {
                inner.failed.push(Failed { id: row.id.clone(), input: row.surface.clone(), error: error.clone() });
            }
        })?;
        match printed {
            _ if self.alone => {}
            0..PRINTED => self.console.warn(format!("{}: {error}", row.id)),
            PRINTED => self.console.warn("further failures are in the table of --status and in the report alone"),
            _ => {}
        }
        Ok(())
    }

    /// The process was asked to stop: the rows that it was working on are not finished.
    pub(super) fn interrupted(&self, row: impl Fn(usize) -> (String, PathBuf)) -> Result<()> {
        let numbers: Vec<usize> = self.lock().under_way.keys().copied().collect();
        for number in numbers {
            let (id, output) = row(number);
            self.finish(number, Entry::new(&id, State::Interrupted), &output, |_| {})?;
        }
        Ok(())
    }

    fn finish(&self, number: usize, entry: Entry, output: &Path, more: impl FnOnce(&mut Inner)) -> Result<()> {
        let mut inner = self.lock();
        let started = inner.under_way.remove(&number);
        let output = output.to_string_lossy().into_owned();
        let entry = Entry { seconds: started.map(|started| started.elapsed().as_secs_f64()), output, ..entry };
        *inner.counts.entry(entry.state.name()).or_default() += 1;
        inner.finished[number] = true;
        more(&mut inner);
        let written = inner.status.as_mut().map_or(Ok(()), |status| status.append(&entry));
        drop(inner);
        self.console.event(|| {
            let Entry { id, state, msd, xsd, seconds, error, output } = &entry;
            let error = (!error.is_empty()).then_some(error);
            json!({
                "event": state.name(), "id": id, "msd": msd, "xsd": xsd, "seconds": seconds, "error": error, "output": output,
            })
        });
        Ok(written?)
    }

    /// Prints a warning once, and not too many of them.
    pub(super) fn warn_once(&self, warning: String) {
        let mut inner = self.lock();
        let count = inner.shown.len();
        if count > PRINTED || !inner.shown.insert(warning.clone()) {
            return;
        }
        drop(inner);
        if count == PRINTED {
            self.console.warn("further warnings aren't shown");
        } else {
            self.console.warn(warning);
        }
    }

    /// Whether it is known what became of a row.
    pub(super) fn is_finished(&self, number: usize) -> bool {
        self.lock().finished[number]
    }

    /// Returns what became of the rows.
    pub(super) fn outcome(&self) -> Outcome {
        let mut inner = self.lock();
        inner.fitted.sort_unstable_by_key(|(number, _)| *number);
        let fitted = std::mem::take(&mut inner.fitted).into_iter().map(|(_, fitted)| fitted).collect();
        let counts = State::ALL.map(|state| (state, inner.counts.get(state.name()).copied().unwrap_or(0)));
        Outcome {
            counts: counts.to_vec(),
            fitted: (self.rows <= LISTED).then_some(fitted),
            skipped: std::mem::take(&mut inner.skipped),
            failed: std::mem::take(&mut inner.failed),
            worst: std::mem::take(&mut inner.worst),
            distances: [inner.msd.report(), inner.xsd.report()],
        }
    }
}
