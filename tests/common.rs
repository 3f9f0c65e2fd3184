//! Helpers that the tests share: paths, and functions that run the tools.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::sync::mpsc::RecvTimeoutError;
use std::time::Duration;

use rustix::process::{Pid, Signal, kill_process};

pub(crate) use spharm_testdata::{reference, shared};

/// Returns the root of the repository.
pub(crate) fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the number of repetitions of a randomised test; `./run soak` uses ten times as many.
pub(crate) fn times(count: usize) -> usize {
    if std::env::var_os("SPHARM_SOAK").is_some() { 10 * count } else { count }
}

/// Returns the command `spharm` with a verb, to which the verb's arguments can be added.
pub(crate) fn tool(verb: &str) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_spharm"));
    command.arg(verb).env_remove("SPHARM_STORE").env_remove("SLURM_CPUS_PER_TASK");
    command
}

/// Runs a command that must succeed and returns its output.
pub(crate) fn succeed(command: &mut Command) -> String {
    let output = finish(command);
    assert!(output.status.success(), "{command:?}\n{}", text(&output));
    String::from_utf8(output.stdout).expect("stdout is UTF-8")
}

/// Runs a command that must fail with exit code 1 and one error line, without a signal, a panic or a hang. Returns the
/// line.
pub(crate) fn fail(command: &mut Command) -> String {
    error_line(&finish(command))
}

/// Returns the single error line of a command that failed with exit code 1.
pub(crate) fn error_line(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(1), "{}", text(output));
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let errors: Vec<&str> = stderr.lines().filter(|line| line.starts_with("error: ")).collect();
    assert_eq!(errors.len(), 1, "one line says what is wrong: {stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    errors[0].to_owned()
}

/// Runs a command that must end on its own; a command that hangs is killed and fails the test.
pub(crate) fn finish(command: &mut Command) -> Output {
    wait(command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("the tool starts"))
}

/// Waits for a process to end on its own.
pub(crate) fn wait(child: Child) -> Output {
    /// Time after which a command is considered to hang: longer than any command of a test takes, however slow the
    /// machine.
    const HANGS: Duration = Duration::from_secs(300);
    let pid = Pid::from_child(&child);
    let (ended, end) = std::sync::mpsc::channel::<()>();
    let watch = std::thread::spawn(move || {
        let hangs = end.recv_timeout(HANGS) == Err(RecvTimeoutError::Timeout);
        if hangs {
            // The signal fails if the process has just ended, which is no error.
            let _ = kill_process(pid, Signal::KILL);
        }
        hangs
    });
    let output = child.wait_with_output().expect("it has ended");
    drop(ended);
    assert!(!watch.join().expect("no panic"), "it hangs: {}", text(&output));
    output
}

/// Returns both output streams of a finished command.
pub(crate) fn text(output: &Output) -> String {
    let stream = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    format!("{}\nstdout: {}\nstderr: {}", output.status, stream(&output.stdout), stream(&output.stderr))
}
