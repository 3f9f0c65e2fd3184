//! What the process took, and what it may take.

use rustix::process::{Resource, getrlimit};
use serde::Serialize;

pub use spharm::Versions;
use spharm::machine::process_status;
pub use spharm::machine::{available_memory, check_limits};

/// Memory of this process, bytes; `None` where the system doesn't tell.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Memory {
    /// Largest resident size so far, mapped files included.
    pub peak_resident: Option<u64>,
    /// Anonymous memory at the end: without mapped files, which the system can drop at any time.
    pub anonymous: Option<u64>,
}

/// Reads this process's memory from `/proc`.
pub fn memory() -> Memory {
    Memory { peak_resident: process_status("VmHWM:"), anonymous: process_status("RssAnon:") }
}

/// Raises the limit on open files as far as the system allows: a store has a file for each degree.
pub fn raise_file_limit() {
    let limit = getrlimit(Resource::Nofile);
    // At worst it stays what it was, and an error names it when it is reached.
    let _ = rustix::process::setrlimit(Resource::Nofile, rustix::process::Rlimit { current: limit.maximum, ..limit });
}
