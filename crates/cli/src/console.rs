//! Notes, warnings and progress, all on stderr.
//!
//! Where stderr is a terminal, progress is a bar. Elsewhere (a log of a cluster job) it is a line now and then, the
//! first after two seconds. `-q` leaves warnings only.

use std::fmt::Display;
use std::io::{IsTerminal, Write};
use std::sync::Mutex;
use std::sync::PoisonError;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use crate::size::Size;

/// Where a tool says what it does.
#[derive(Debug, Clone, Copy)]
pub struct Console {
    verbose: bool,
    quiet: bool,
    terminal: bool,
}

/// A line on stderr. Whoever reads it may have gone away, which is no reason to stop the work.
pub(crate) fn say(text: impl Display) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// What a progress counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unit {
    /// Bytes, shown as sizes.
    Bytes,
    /// Anything else.
    Count(&'static str),
}

impl Console {
    /// From the flags.
    pub fn new(verbose: bool, quiet: bool) -> Self {
        Self { verbose, quiet, terminal: std::io::stderr().is_terminal() }
    }

    /// Something worth knowing.
    pub fn note(&self, text: impl Display) {
        if !self.quiet {
            say(text);
        }
    }

    /// Something for those who asked for more.
    pub fn detail(&self, text: impl Display) {
        if self.verbose {
            say(text);
        }
    }

    /// Something that may be wrong.
    pub fn warn(&self, text: impl Display) {
        say(format_args!("warning: {text}"));
    }

    /// Progress towards `total`.
    pub fn progress(&self, label: &str, total: u64, unit: Unit) -> Progress {
        if self.quiet {
            return Progress { bar: None, lines: None };
        }
        if !self.terminal {
            let lines = Lines { label: label.to_owned(), total, unit, state: Mutex::new(State::new()) };
            return Progress { bar: None, lines: Some(lines) };
        }
        let counts = match unit {
            Unit::Bytes => "{bytes}/{total_bytes}, {binary_bytes_per_sec}".to_owned(),
            Unit::Count(name) => format!("{{pos}}/{{len}} {name}"),
        };
        let template = format!("{{prefix}} [{{bar:30}}] {counts}, {{eta}} left {{msg}}");
        let style = ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar());
        let bar = ProgressBar::with_draw_target(Some(total), ProgressDrawTarget::stderr_with_hz(10));
        bar.set_style(style.progress_chars("=> "));
        bar.set_prefix(label.to_owned());
        Progress { bar: Some(bar), lines: None }
    }
}

/// A running progress. It disappears from a terminal when it is dropped.
#[derive(Debug)]
pub struct Progress {
    bar: Option<ProgressBar>,
    lines: Option<Lines>,
}

impl Progress {
    /// `step` more are done.
    pub fn add(&self, step: u64) {
        if let Some(bar) = &self.bar {
            bar.inc(step);
        }
        if let Some(lines) = &self.lines {
            lines.add(step);
        }
    }

    /// What is being done now.
    pub fn say(&self, text: impl Display) {
        if let Some(bar) = &self.bar {
            bar.set_message(text.to_string());
        }
        if let Some(lines) = &self.lines {
            lines.lock().saying = text.to_string();
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
    saying: String,
}

impl State {
    fn new() -> Self {
        Self { started: Instant::now(), next: Duration::from_secs(2), done: 0, saying: String::new() }
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
        if elapsed < state.next || state.done >= self.total {
            return;
        }
        state.next = elapsed + Duration::from_secs(10);
        let rate = state.done as f64 / elapsed.as_secs_f64();
        let left = (self.total - state.done) as f64 / rate.max(f64::MIN_POSITIVE);
        let percent = 100.0 * state.done as f64 / self.total as f64;
        let rate = match self.unit {
            Unit::Bytes => format!("{}/s", Size(rate as usize)),
            Unit::Count(name) => format!("{rate:.1} {name}/s"),
        };
        say(format_args!("{}: {percent:.0} %, {rate}, {left:.0} s left {}", self.label, state.saying));
    }
}
