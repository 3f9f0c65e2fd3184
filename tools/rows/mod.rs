//! Arguments, tables and reports shared by `fit` and the verbs that find surfaces in folders. Each row is one surface
//! to fit.
//!
//! A verb makes a [`Cohort`] and passes it to [`run`], which calls [`spharm_cohort::run::run`](spharm_cohort::run::run)
//! and shows its events.
//!
//! | module | contents |
//! |---|---|
//! | `args`, `options` | common arguments |
//! | `console` | events of the run, on the console and for the report |
//! | `dry_run` | preview of a run |
//! | `fitted`, `report` | the table and the report |

mod args;
mod console;
mod dry_run;
mod fitted;
mod options;
mod report;

use std::time::Instant;

use anyhow::{Result, bail};
use spharm::generate::{icosphere_bytes, icosphere_counts};
use spharm::{Model, Sphere};
use spharm_cli::console::json_lines;
use spharm_cli::machine::raise_file_limit;
use spharm_cli::memory::Budget;
use spharm_cli::monitor::ConsoleMonitor;
use spharm_cli::output::{OutputFile, check_outputs, counted, same_place};
use spharm_cohort::State;
use spharm_cohort::files::ModelFiles;
use spharm_cohort::run::Cohort;

pub(crate) use args::{CohortArgs, Log};
pub(crate) use console::Rows;
pub(crate) use dry_run::{Previewed, preview};
pub(crate) use options::{Options, if_exists};

use console::Summary;

/// Applies `--log`; must be called before anything is printed.
pub(crate) fn set_log(cohort: &CohortArgs) {
    if cohort.log == Log::Json {
        json_lines();
    }
}

/// Fits all rows, and reports the outcome of each.
///
/// # Errors
///
/// If rows fail. With `keep_going`, the error is returned after all rows have been fitted, otherwise at the first
/// failure.
pub(crate) fn run(cohort: &Cohort, options: &Options, monitor: &ConsoleMonitor, started: Instant) -> Result<()> {
    let console = monitor.console();
    check_outputs(options.report.iter().map(|path| OutputFile::new(path, "--report")), options.replaces_report())?;
    check_apart(cohort, options)?;
    if options.dry_run {
        return dry_run::run(cohort, options, monitor);
    }
    raise_file_limit();
    let rows = Rows::new(console, cohort.rows.len(), options);
    let read = started.elapsed().as_secs_f64();
    let result = options.threads.pool()?.install(|| spharm_cohort::run::run(cohort, &options.run, &rows, monitor));
    let summary = rows.summary(read);
    let skipped = summary.count(State::Skipped);
    if skipped > 0 {
        let exist = if skipped == 1 { "exists and was" } else { "exist and were" };
        console.note(format!("{} {exist} skipped", counted(skipped, "output")));
    }
    let ended = finish(result.map_err(anyhow::Error::from), &summary, options, monitor, started);
    rows.repeat_warnings();
    ended
}

/// Refuses a report or status file whose path is also the path of a model to be written, or of a companion file of such
/// a model.
fn check_apart(cohort: &Cohort, options: &Options) -> Result<()> {
    let beside = [(&options.report, "--report"), (&options.run.status, "--status")];
    let beside: Vec<_> = beside.iter().filter_map(|(path, flag)| Some((path.as_ref()?, flag))).collect();
    for row in cohort.rows.iter().filter(|_| !beside.is_empty()) {
        for path in (ModelFiles { model: row.model(&cohort.folder) }).all() {
            if let Some((path, flag)) = beside.iter().find(|(other, _)| same_place(other, &path)) {
                bail!(
                    "{}: this name is reserved for an output file of {}; choose another {flag}",
                    path.display(),
                    row.id
                );
            }
        }
    }
    Ok(())
}

/// Writes and prints the report, and returns the error with which the call ends. If the run itself failed, the report
/// isn't printed, and is written only with `keep_going` or a status file.
fn finish(
    result: Result<()>,
    summary: &Summary,
    options: &Options,
    monitor: &ConsoleMonitor,
    started: Instant,
) -> Result<()> {
    let total = started.elapsed().as_secs_f64();
    let report = report::report(options, summary, total);
    monitor.console().event(|| {
        let counts = summary.counts().map(|(state, count)| (state.name().to_owned(), count.into()));
        let more = [("event".to_owned(), "end".into()), ("seconds".to_owned(), total.into())];
        more.into_iter().chain(counts).collect::<serde_json::Map<_, _>>().into()
    });
    let goes_on = options.run.keep_going || options.run.status.is_some();
    if let Err(error) = result {
        if goes_on {
            let _ = report::write(options, &report);
        }
        return Err(error);
    }
    report::write(options, &report)?;
    report::show(options, &report, summary, total)?;
    match summary.count(State::Failed) {
        0 => Ok(()),
        failed => {
            const NAMED: usize = 5;
            let all: usize = summary.counts().map(|(_, count)| count).sum();
            let names: Vec<&str> = summary.failed.iter().take(NAMED).map(|failed| failed.id.as_str()).collect();
            let more = if failed > names.len() { format!(" and {} more", failed - names.len()) } else { String::new() };
            let others = match all - failed {
                0 => "",
                _ => "; the other models are finished, and --skip-existing skips them next time",
            };
            bail!("{failed} of {} failed: {}{more}{others}", counted(all, "surface"), names.join(", "))
        }
    }
}

/// Returns the icosphere on which models of a degree are evaluated, or an error if memory doesn't suffice. `option` is
/// the text that the error puts before the number of subdivisions: the subcommand and its option, such as `bids
/// --icosphere `.
pub(crate) fn icosphere_within(budget: Budget, option: &str, subdivisions: u32, degree: usize) -> Result<Sphere> {
    let needed = |subdivisions: u32| {
        let [vertices, faces] = icosphere_counts(subdivisions);
        icosphere_bytes(subdivisions).max(Model::bytes_to_evaluate(vertices, faces, 3, degree))
    };
    let (verb, setting) = option.split_once(' ').unwrap_or_default();
    let fewer = (0..subdivisions).rev().map(|fewer| (format!("{setting}{fewer}"), needed(fewer)));
    budget.check_or(format_args!("{verb} {setting}{subdivisions}"), needed(subdivisions), fewer)?;
    Ok(Sphere::icosphere(subdivisions))
}
