//! Rows to fit, a surface each: what `fit` and the verbs that find surfaces in folders share.
//!
//! A verb makes [`Rows`], each a surface with its id, and hands them to [`run`]. They are grouped by sphere, and a
//! group is streamed through [`fit_each`](spharm::fit_each): a row's file is read and its outputs are looked at when
//! its turn comes. The [`Ledger`] keeps what becomes of it.
//!
//! | module | contents |
//! |---|---|
//! | `args`, `options` | what verbs have in common |
//! | `groups` | rows that share a sphere |
//! | `item` | what to do about outputs that exist |
//! | `work` | one row after another: read, map, fit, write |
//! | `own_sphere` | surfaces that come without a sphere |
//! | `quiet` | the progress of one group among many |
//! | `evaluate` | models on one sphere |
//! | `ledger` | counts, status file, events |
//! | `equal` | inputs that are there twice |
//! | `fitted`, `report` | the table and the report |
//! | `unread` | vertices that aren't read |
//! | `weights` | rows' own weights, and a mask |
//! | `dry_run` | what would be done |

mod args;
mod dry_run;
pub(crate) mod equal;
mod evaluate;
mod fitted;
mod groups;
mod item;
mod ledger;
mod options;
mod own_sphere;
mod quiet;
mod report;
mod unread;
mod weights;
mod work;

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

use anyhow::{Result, bail};
use spharm::cohort::State;
use spharm::files::ModelFiles;
use spharm::parametrize::volume::steps_of_labels;
use spharm::rerun::IfExists;
use spharm_cli::console::json_lines;
use spharm_cli::machine::raise_file_limit;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted, same_place};
use spharm_surface::io::remove_leftovers;

pub(crate) use args::{CohortArgs, Log};
pub(crate) use dry_run::{Preview, preview};
pub(crate) use evaluate::{Evaluate, icosphere_within};
pub(crate) use options::{Options, Rows};

use ledger::{Ledger, Outcome};
use report::Totals;
pub(crate) use work::concerns_all;
use work::{Work, lock};

/// Applies what a verb was asked to log, before anything is printed.
pub(crate) fn set_log(cohort: &CohortArgs) {
    if cohort.log == Log::Json {
        json_lines();
    }
}

/// Fits all rows; says what became of each.
///
/// # Errors
///
/// Where rows failed, after all that can be done; or at the first, unless failures don't end the call.
pub(crate) fn run(rows: Rows, options: &Options, monitor: &ConsoleMonitor, started: Instant) -> Result<()> {
    let console = monitor.console();
    check_outputs(options.report.iter().map(|path| OutputFile::new(path, "--report")), options.replaces_report())?;
    check_apart(&rows, options)?;
    if options.cohort.dry_run {
        return dry_run::run(&rows, options, monitor);
    }
    raise_file_limit();
    if options.if_exists != IfExists::Refuse {
        // What killed calls left beside the models; what can't be removed is in nobody's way.
        let models = rows.rows.iter().map(|row| row.model(&rows.folder));
        let folders: BTreeSet<PathBuf> = models.filter_map(|model| model.parent().map(Path::to_owned)).collect();
        folders.iter().filter(|folder| folder.is_dir()).for_each(|folder| drop(remove_leftovers(folder)));
    }
    let goes_on = options.cohort.keep_going;
    let ledger = Ledger::new(console, rows.rows.len(), options.cohort.status.as_deref(), goes_on)?;
    let work = Work::new(&rows, options, monitor, &ledger);
    let mut totals = Totals::default();
    totals.seconds.read = started.elapsed().as_secs_f64();
    let result = options.threads.pool()?.install(|| work.all(&mut totals));
    if result.is_err() {
        // The error that ended the call is the one to show.
        let _ = ledger.interrupted(|number| (rows.rows[number].id.clone(), rows.rows[number].model(&rows.folder)));
    }
    let doubts = lock(&work.inputs).warnings().into_iter().chain(steps_of_labels(&lock(&work.steps)));
    doubts.for_each(|warning| console.warn(warning));
    let outcome = ledger.outcome();
    let skipped = outcome.count(State::Skipped);
    if skipped > 0 {
        let there = if skipped == 1 { "exists and is" } else { "exist and are" };
        console.note(format!("{} {there} left alone", counted(skipped, "output")));
    }
    finish(result, &outcome, &totals, options, monitor, started)
}

/// Refuses a report or a status file with the name of a file that belongs to a row.
fn check_apart(rows: &Rows, options: &Options) -> Result<()> {
    let beside = [(&options.report, "--report"), (&options.cohort.status, "--status")];
    let beside: Vec<_> = beside.iter().filter_map(|(path, flag)| Some((path.as_ref()?, flag))).collect();
    for row in rows.rows.iter().filter(|_| !beside.is_empty()) {
        let files = ModelFiles { model: row.model(&rows.folder) };
        let own = [files.csv(), files.standard_errors(), files.sphere(), files.surface(), files.cut_surface()];
        for path in own.iter().chain([&files.model, &files.fixed_surface()]) {
            if let Some((path, flag)) = beside.iter().find(|(other, _)| same_place(other, path)) {
                bail!("{}: a file of {}'s model has this name; choose another {flag}", path.display(), row.id);
            }
        }
    }
    Ok(())
}

/// Writes the report whatever happened, prints it if nothing did, and returns what is wrong.
fn finish(
    result: Result<()>,
    outcome: &Outcome,
    totals: &Totals,
    options: &Options,
    monitor: &ConsoleMonitor,
    started: Instant,
) -> Result<()> {
    let total = started.elapsed().as_secs_f64();
    let report = report::report(options, outcome, totals, total);
    monitor.console().event(|| {
        let counts = outcome.counts.iter().map(|(state, count)| (state.name().to_owned(), (*count).into()));
        let more = [("event".to_owned(), "end".into()), ("seconds".to_owned(), total.into())];
        more.into_iter().chain(counts).collect::<serde_json::Map<_, _>>().into()
    });
    let goes_on = options.cohort.keep_going || options.cohort.status.is_some();
    if let Err(error) = result {
        if goes_on {
            let _ = report::write(options, &report);
        }
        return Err(error);
    }
    report::write(options, &report)?;
    report::show(options, &report, outcome, total)?;
    match outcome.count(State::Failed) {
        0 => Ok(()),
        failed => {
            const NAMED: usize = 5;
            let all: usize = outcome.counts.iter().map(|(_, count)| count).sum();
            let names: Vec<&str> = outcome.failed.iter().take(NAMED).map(|failed| failed.id.as_str()).collect();
            let more = if failed > names.len() { format!(" and {} more", failed - names.len()) } else { String::new() };
            let others = match all - failed {
                0 => "",
                _ => "; the other models are there, and --skip-existing leaves them out next time",
            };
            bail!("{failed} of {} failed: {}{more}{others}", counted(all, "surface"), names.join(", "))
        }
    }
}
