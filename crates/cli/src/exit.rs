//! Exit codes and signals: 0 success, 1 failure, 2 wrong usage, 75 interrupted.

use std::error::Error;
use std::io::Write;
use std::panic::AssertUnwindSafe;
use std::path::Path;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};

use clap::Command;
use signal_hook::consts::{SIGINT, SIGTERM};
use signal_hook::flag;
use spharm_cohort::run::{RunError, chained};
use spharm_monitor::Interrupted;
use spharm_solver::SolverError;

use crate::advice::advice;
use crate::console::{Kind, say};
use crate::printable;
use crate::usage::Usage;

/// Exit code of interrupted work: EX_TEMPFAIL from sysexits.h, which means that the same command may succeed later.
const INTERRUPTED: u8 = 75;
const FAILURE: u8 = 1;
/// Exit code of wrong usage; clap uses the same code.
const USAGE: u8 = 2;

/// Signals that ask a process to stop. On Windows, SIGINT is sent by Ctrl+C.
const STOPS: &[i32] = &[
    SIGINT,
    SIGTERM,
    #[cfg(unix)]
    signal_hook::consts::SIGHUP,
];

static CANCEL: LazyLock<Arc<AtomicBool>> = LazyLock::new(listen);

/// Returns the flag that is set when the process has been asked to stop (SIGINT, SIGTERM, SIGHUP). The first call
/// installs the signal handlers. A second signal ends the process immediately.
pub fn cancel() -> &'static AtomicBool {
    &CANCEL
}

fn listen() -> Arc<AtomicBool> {
    let cancel = Arc::new(AtomicBool::new(false));
    for &signal in STOPS {
        if !is_ignored(signal) {
            // Handlers run in the order of their registration. Register the conditional shutdown first, so that it
            // finds the flag unset at the first signal. Registration fails only for signals that can't be caught.
            let _ = flag::register_conditional_shutdown(signal, i32::from(INTERRUPTED), Arc::clone(&cancel));
            let _ = flag::register(signal, Arc::clone(&cancel));
        }
    }
    // If SIGXFSZ has a handler, a write beyond the limit on file sizes (`ulimit -f`) fails with EFBIG. Without a
    // handler, the signal would end the process.
    #[cfg(unix)]
    let _ = flag::register(libc::SIGXFSZ, Arc::default());
    cancel
}

/// Returns whether a signal was already ignored when this process started, as it is under `nohup` and in background
/// jobs of shells. Such a signal stays ignored.
fn is_ignored(signal: i32) -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    let mask = mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).unwrap_or(0);
    mask >> (signal - 1) & 1 == 1
}

/// Returns the subcommand of `program` with the name `verb`, whose usage is shown with errors. Returns `program` if it
/// has no such subcommand.
pub fn command_of(mut program: Command, verb: &str) -> Command {
    program.build();
    program.find_subcommand(verb).cloned().unwrap_or(program)
}

/// Runs a verb and returns the exit code. An error or a panic is printed to stderr as one line; a [`Usage`] error is
/// printed in clap's format, with the usage of `command`.
pub fn run(work: impl FnOnce() -> anyhow::Result<()>, command: impl FnOnce() -> Command) -> u8 {
    cancel();
    let Err(error) = caught(work) else { return 0 };
    if is_closed_pipe(&error) {
        return 0;
    }
    if let Some(usage) = error.downcast_ref::<Usage>() {
        return wrong_usage(&usage.of(command()), false);
    }
    say(Kind::Error, line_with_advice(error.as_ref()));
    if is_interrupted(&error) { INTERRUPTED } else { FAILURE }
}

/// Prints clap's message, which is an error about the arguments or the requested help, and returns the exit code. If
/// `tame` is set, control characters in arguments are escaped; clap would print them unchanged.
pub fn wrong_usage(error: &clap::Error, tame: bool) -> u8 {
    // A failure to print is ignored: if stderr is closed, the failure can't be reported.
    let _ = if error.use_stderr() && tame {
        let text = error.render().to_string();
        std::io::stderr().lock().write_all(printable::lines(&text).as_bytes())
    } else {
        error.print()
    };
    if error.use_stderr() { USAGE } else { 0 }
}

/// Message of the first panic.
static PANIC: Mutex<Option<String>> = Mutex::new(None);

/// Runs work and converts a panic to an error. A panic is caused by a defect, or by a failure that the standard library
/// doesn't return as an error, such as a failure to close a folder. With `RUST_BACKTRACE` the panic is also printed as
/// usual.
fn caught(work: impl FnOnce() -> anyhow::Result<()>) -> anyhow::Result<()> {
    PANIC.lock().unwrap_or_else(PoisonError::into_inner).take();
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        if std::env::var_os("RUST_BACKTRACE").is_some_and(|wanted| wanted != "0") {
            usual(panic);
        }
        let text = panic.payload_as_str().unwrap_or("no reason given");
        let at = panic.location().map_or(String::new(), |at| {
            let file = Path::new(at.file()).file_name().unwrap_or_default();
            format!(" ({}:{})", file.display(), at.line())
        });
        // Keep the first panic: a later one is a consequence of it and less informative.
        PANIC.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(format!("{text}{at}"));
    }));
    // Unwind safety: the process ends after a panic, so data that a panic left half-changed isn't used again.
    let done = std::panic::catch_unwind(AssertUnwindSafe(work));
    // Restore the standard library's hook, for programs that embed this one in their own process.
    drop(std::panic::take_hook());
    done.unwrap_or_else(|_| {
        let text = PANIC.lock().unwrap_or_else(PoisonError::into_inner).take().unwrap_or_default();
        Err(anyhow::anyhow!("unexpected failure: {text}; if it happens again, please report it"))
    })
}

/// Returns an error as the program shows it, in one line: the messages of the error and its sources, then the advice.
pub fn line_with_advice(error: &(dyn Error + 'static)) -> String {
    let advice = advice(error).map_or(String::new(), |advice| format!("; {advice}"));
    printable::one_line(&format!("{}{advice}", chained(error))).into_owned()
}

/// Returns whether the work was interrupted on request.
pub fn is_interrupted(error: &anyhow::Error) -> bool {
    error.chain().any(|cause| {
        let of_fit = || cause.downcast_ref::<spharm::Error>().is_some_and(spharm::Error::is_interrupted);
        let of_run = || cause.downcast_ref::<RunError>().is_some_and(RunError::is_interrupted);
        let of_solver = || matches!(cause.downcast_ref(), Some(SolverError::Interrupted(_)));
        cause.is::<Interrupted>() || of_fit() || of_run() || of_solver()
    })
}

/// Returns whether an error means that the reader of stdout has closed the pipe, which isn't a failure of this program.
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
    fn a_panic_is_a_failure() {
        let command = || Command::new("x");
        assert_eq!(run(|| panic!("unexpected error during closedir"), command), FAILURE);
        assert_eq!(
            run(
                || Err(std::thread::spawn(|| panic!("in a thread"))
                    .join()
                    .map_err(|_| anyhow::anyhow!("x"))
                    .unwrap_err()),
                command
            ),
            FAILURE
        );
        assert_eq!(run(|| Ok(()), command), 0);
    }

    #[test]
    fn a_file_is_named_once() {
        let line = |chain: &[&str]| {
            let (root, contexts) = chain.split_last().expect("a message");
            let error =
                contexts.iter().rev().fold(anyhow::anyhow!("{root}"), |error, text| error.context(text.to_string()));
            chained(error.as_ref())
        };
        assert_eq!(line(&["x.nii", "x.nii: expected one label"]), "x.nii: expected one label");
        assert_eq!(line(&["x.ply", "not closed"]), "x.ply: not closed");
        assert_eq!(line(&["cannot write x.ply: full", "full"]), "cannot write x.ply: full");
        assert_eq!(line(&["a and b", "a", "a: no such file"]), "a and b: a: no such file");
    }
}
