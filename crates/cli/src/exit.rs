//! Exit codes and signals: 0 success, 1 failure, 2 wrong usage, 75 interrupted.

use std::sync::atomic::AtomicBool;
use std::sync::{Arc, LazyLock};

use clap::Command;
use signal_hook::consts::{SIGHUP, SIGINT, SIGTERM};
use signal_hook::flag;
use spharm_monitor::Interrupted;
use spharm_solver::SolverError;

use crate::advice::advice;
use crate::console::{Kind, say};
use crate::usage::Usage;

/// EX_TEMPFAIL of sysexits.h: the same command may succeed later.
const INTERRUPTED: u8 = 75;
const FAILURE: u8 = 1;
/// As clap has it.
const USAGE: u8 = 2;

static CANCEL: LazyLock<Arc<AtomicBool>> = LazyLock::new(listen);

/// Returns the flag that is set when the process has been asked to stop (SIGINT, SIGTERM, SIGHUP). Signals are handled
/// from the first call on; a second one ends the process at once.
pub fn cancel() -> &'static AtomicBool {
    &CANCEL
}

fn listen() -> Arc<AtomicBool> {
    let cancel = Arc::new(AtomicBool::new(false));
    for signal in [SIGINT, SIGTERM, SIGHUP] {
        if !is_ignored(signal) {
            // In this order the first signal finds the flag unset. Registering fails only for signals that can't be caught.
            let _ = flag::register_conditional_shutdown(signal, i32::from(INTERRUPTED), Arc::clone(&cancel));
            let _ = flag::register(signal, Arc::clone(&cancel));
        }
    }
    cancel
}

/// Whether this process was started with a signal ignored, as `nohup` does and shells do for jobs in the background. It
/// stays ignored.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

/// Returns the command of a verb of `program`, for the usage that an error shows.
pub fn command_of(mut program: Command, verb: &str) -> Command {
    program.build();
    program.find_subcommand(verb).cloned().unwrap_or(program)
}

/// Runs a verb and returns the exit code. An error is printed as one line to stderr; a [`Usage`] error as clap prints its
/// own, with the usage of `command`.
pub fn run(work: impl FnOnce() -> anyhow::Result<()>, command: impl FnOnce() -> Command) -> u8 {
    let Err(error) = work() else { return 0 };
    if is_closed_pipe(&error) {
        return 0;
    }
    if let Some(usage) = error.downcast_ref::<Usage>() {
        // Where stderr is gone, there is nobody to tell.
        let _ = usage.of(command()).print();
        return USAGE;
    }
    say(Kind::Error, line_with_advice(&error));
    if is_interrupted(&error) { INTERRUPTED } else { FAILURE }
}

/// Returns an error in one line, as the program shows it: the chain's messages, with what to do.
pub fn line_with_advice(error: &anyhow::Error) -> String {
    let advice = advice(error).map_or(String::new(), |advice| format!("; {advice}"));
    format!("{}{advice}", one_line(error))
}

/// Joins the error chain, skipping repeated messages, and names of files that the next message begins with.
fn one_line(error: &anyhow::Error) -> String {
    let mut parts: Vec<String> = Vec::new();
    for text in error.chain().map(ToString::to_string) {
        if parts.iter().any(|part| part.contains(&text)) {
            continue;
        }
        if parts.last().is_some_and(|last| text.starts_with(&format!("{last}: "))) {
            parts.pop();
        }
        parts.push(text);
    }
    parts.join(": ").replace('\n', " ")
}

/// Returns whether work was asked to stop, and did.
pub fn is_interrupted(error: &anyhow::Error) -> bool {
    error
        .chain()
        .any(|cause| cause.is::<Interrupted>() || matches!(cause.downcast_ref(), Some(SolverError::Interrupted(_))))
}

/// Whether the reader of stdout has gone away, which isn't a failure of this program.
fn is_closed_pipe(error: &anyhow::Error) -> bool {
    error.root_cause().downcast_ref::<std::io::Error>().is_some_and(|e| e.kind() == std::io::ErrorKind::BrokenPipe)
        && error.downcast_ref::<crate::output::ToStdout>().is_some()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interruption_is_known_however_deep_it_lies() {
        use spharm_parametrize::ParametrizeError;
        use spharm_surface::SurfaceError;

        let surface = || SurfaceError::from(Interrupted);
        let mapping = || ParametrizeError::from(surface());
        assert!(is_interrupted(&anyhow::Error::from(surface()).context("a and b")));
        assert!(is_interrupted(&anyhow::Error::from(mapping()).context("a")));
        for error in [spharm::Error::from(surface()), spharm::Error::from(mapping())] {
            assert!(error.is_interrupted() && is_interrupted(&error.into()));
        }
    }

    #[test]
    fn a_file_is_named_once() {
        let line = |chain: &[&str]| {
            let (root, contexts) = chain.split_last().expect("a message");
            let error =
                contexts.iter().rev().fold(anyhow::anyhow!("{root}"), |error, text| error.context(text.to_string()));
            one_line(&error)
        };
        assert_eq!(line(&["x.nii", "x.nii: expected one label"]), "x.nii: expected one label");
        assert_eq!(line(&["x.ply", "not closed"]), "x.ply: not closed");
        assert_eq!(line(&["cannot write x.ply: full", "full"]), "cannot write x.ply: full");
        assert_eq!(line(&["a and b", "a", "a: no such file"]), "a and b: a: no such file");
    }
}
