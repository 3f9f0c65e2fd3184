//! Prints notes, warnings and progress to stderr.
//!
//! If stderr is a terminal, progress is shown as a bar. Otherwise, such as in the log of a cluster job, progress is
//! shown as occasional lines, the first after two seconds. `-q` leaves only warnings. With [`json_lines`] every line is
//! a JSON object with the field `event`, for programs that read the log.

use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressState, ProgressStyle};
use serde_json::{Value, json};

pub use spharm_monitor::Unit;

use crate::printable::{json as json_text, one_line};
use crate::size::Size;

/// Minimum elapsed time before the time left is forecast; earlier forecasts would be unreliable.
const FORECAST_AFTER: Duration = Duration::from_secs(5);
/// Percentage of the work that must be done before the time left is forecast.
const FORECAST_FROM_PERCENT: u64 = 5;

/// Prints notes, warnings and progress to stderr, as far as the flags `--verbose` and `--quiet` allow.
#[derive(Debug, Clone, Copy)]
pub struct Console {
    verbose: bool,
    quiet: bool,
    terminal: bool,
}

static JSON_LINES: AtomicBool = AtomicBool::new(false);

/// Makes all further stderr lines of this process JSON objects.
pub fn json_lines() {
    JSON_LINES.store(true, Ordering::Relaxed);
}

fn is_json() -> bool {
    JSON_LINES.load(Ordering::Relaxed)
}

/// Kind of a line, which determines the line's prefix or, in JSON, its `event`.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Kind {
    Note,
    Warning,
    Error,
    Progress,
}

/// Prints a line to stderr, preceded by an empty line if the text begins with a line break. Write errors are ignored:
/// the work continues even if nothing reads stderr any more.
pub(crate) fn say(kind: Kind, text: impl Display) {
    let (event, prefix) = match kind {
        Kind::Note => ("note", ""),
        Kind::Warning => ("warning", "warning: "),
        Kind::Error => ("error", "error: "),
        Kind::Progress => ("progress", ""),
    };
    if is_json() {
        print(&json!({ "event": event, "text": text.to_string() }));
    } else {
        let text = text.to_string();
        let (gap, text) = text.strip_prefix('\n').map_or(("", text.as_str()), |rest| ("\n", rest));
        let _ = writeln!(std::io::stderr().lock(), "{gap}{prefix}{}", one_line(text));
    }
}

fn print(value: &Value) {
    // Write the line in a single call, so that lines of several threads don't interleave.
    let _ = std::io::stderr().lock().write_all(format!("{}\n", json_text(&value.to_string())).as_bytes());
}

impl Console {
    /// Returns the console for `--verbose` and `--quiet`.
    pub fn new(verbose: bool, quiet: bool) -> Self {
        Self { verbose, quiet, terminal: std::io::stderr().is_terminal() }
    }

    /// Prints a note, unless the console is quiet.
    pub fn note(&self, text: impl Display) {
        if !self.quiet {
            say(Kind::Note, text);
        }
    }

    /// Prints a detail, if the console is verbose.
    pub fn detail(&self, text: impl Display) {
        if self.verbose {
            say(Kind::Note, text);
        }
    }

    /// Prints a warning: something may be wrong.
    pub fn warn(&self, text: impl Display) {
        say(Kind::Warning, text);
    }

    /// Prints an event for programs that read the log, if [`json_lines`] was called. `value` returns an object with
    /// the field `event`.
    pub fn event(&self, value: impl FnOnce() -> Value) {
        if is_json() {
            print(&value());
        }
    }

    /// Starts to show progress towards `total`; a `total` of zero means that it is unknown.
    pub fn progress(&self, label: &str, total: u64, unit: Unit) -> Progress {
        if self.quiet {
            return Progress { bar: None, lines: None };
        }
        if !self.terminal || is_json() {
            let lines = Lines { label: label.to_owned(), total, unit, state: Mutex::new(State::new()) };
            return Progress { bar: None, lines: Some(lines) };
        }
        let template = match (unit, total) {
            (_, 0) => "{prefix} {spinner} {elapsed} {msg}".to_owned(),
            (Unit::Bytes, _) => {
                "{prefix} [{bar:30}] {bytes}/{total_bytes}, {binary_bytes_per_sec}{forecast} {msg}".to_owned()
            }
            (Unit::Count(name), _) => format!("{{prefix}} [{{bar:30}}] {{pos}}/{{len}} {name}{{forecast}} {{msg}}"),
            _ => "{prefix} [{bar:30}] {percent} %{forecast} {msg}".to_owned(),
        };
        let style = ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let style = style.with_key("forecast", |state: &ProgressState, out: &mut dyn std::fmt::Write| {
            // Writing to the bar's own buffer can't fail.
            let _ = write!(out, "{}", Forecast::of(state.pos(), state.len().unwrap_or(0), state.elapsed()));
        });
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(10));
        bar.set_style(style.progress_chars("=> "));
        bar.set_prefix(one_line(label).into_owned());
        if total == 0 {
            // If the total is unknown, an animated symbol shows that the work continues.
            bar.enable_steady_tick(Duration::from_millis(200));
        }
        Progress { bar: Some(bar), lines: None }
    }
}

/// Progress of a task, shown on the console. When it is dropped, its bar disappears from the terminal.
#[derive(Debug)]
pub struct Progress {
    bar: Option<ProgressBar>,
    lines: Option<Lines>,
}

impl Progress {
    /// Advances the progress by `step`.
    pub fn add(&self, step: u64) {
        if let Some(bar) = &self.bar {
            bar.inc(step);
        }
        if let Some(lines) = &self.lines {
            lines.add(step);
        }
    }

    /// Sets the text next to a bar, which describes the current activity. Progress shown as lines has no such text.
    pub fn say(&self, text: impl Display) {
        if let Some(bar) = &self.bar {
            bar.set_message(one_line(&text.to_string()).into_owned());
        }
    }

    /// Runs `print`, which prints lines other than progress, without disturbing the bar.
    pub(crate) fn beside(&self, print: impl FnOnce()) {
        match &self.bar {
            Some(bar) => bar.suspend(print),
            None => print(),
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}

#[derive(Debug)]
struct Lines {
    label: String,
    total: u64,
    unit: Unit,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    started: Instant,
    next: Duration,
    done: u64,
}

impl State {
    fn new() -> Self {
        Self { started: Instant::now(), next: Duration::from_secs(2), done: 0 }
    }
}

impl Lines {
    fn lock(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn add(&self, step: u64) {
        let mut state = self.lock();
        state.done += step;
        let elapsed = state.started.elapsed();
        if elapsed < state.next || (self.total > 0 && state.done >= self.total) {
            return;
        }
        state.next = elapsed + Duration::from_secs(10);
        let done = state.done;
        let amount = match self.unit {
            _ if self.total == 0 => format!("{:.0} s", elapsed.as_secs_f64()),
            Unit::Bytes => {
                let rate = Size((done as f64 / elapsed.as_secs_f64()) as usize);
                format!("{:.0} %, {rate}/s", percent(done, self.total))
            }
            Unit::Count(name) => format!("{:.0} %, {done} of {} {name}", percent(done, self.total), self.total),
            _ => format!("{:.0} %", percent(done, self.total)),
        };
        let line = format!("{}: {amount}{}", self.label, Forecast::of(done, self.total, elapsed));
        say(Kind::Progress, line);
    }
}

fn percent(done: u64, total: u64) -> f64 {
    100.0 * done as f64 / total as f64
}

/// Forecast of the time left in seconds, printed as `, 12 s left`. Prints nothing if there is no forecast.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Forecast(Option<f64>);

impl Forecast {
    fn of(done: u64, total: u64, elapsed: Duration) -> Self {
        let soon = elapsed < FORECAST_AFTER || done.saturating_mul(100) < total.saturating_mul(FORECAST_FROM_PERCENT);
        if soon || done == 0 || done >= total {
            return Self(None);
        }
        Self(Some(elapsed.as_secs_f64() * (total - done) as f64 / done as f64))
    }
}

impl Display for Forecast {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.0 {
            Some(seconds) if seconds >= 120.0 => write!(f, ", {:.0} min left", seconds / 60.0),
            Some(seconds) => write!(f, ", {seconds:.0} s left"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_is_foreseen_before_some_seconds_and_some_work() {
        let text = |done, total, seconds| Forecast::of(done, total, Duration::from_secs(seconds)).to_string();
        assert_eq!(text(1, 2, 4), "", "too early");
        assert_eq!(text(4, 100, 60), "", "too little is done to estimate the time left");
        assert_eq!(text(0, 2, 60), "");
        assert_eq!(text(2, 2, 60), "");
        assert_eq!(text(5, 0, 60), "", "the total isn't known");
        assert_eq!(text(25, 100, 10), ", 30 s left");
        assert_eq!(text(5, 100, 60), ", 19 min left");
    }
}
