//! Measures the memory of this process, and raises its limit on open files.

use serde::Serialize;

pub use spharm::Versions;
pub use spharm::machine::available_memory;
use spharm::machine::process_status;

/// Memory of this process in bytes; `None` if the system doesn't report it.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Memory {
    /// Peak resident memory so far, including mapped files.
    pub peak_resident: Option<u64>,
    /// Current anonymous memory, which excludes mapped files because the system can drop them at any time.
    pub anonymous: Option<u64>,
}

/// Returns the memory use of this process, from `/proc`.
pub fn memory() -> Memory {
    Memory { peak_resident: process_status("VmHWM:"), anonymous: process_status("RssAnon:") }
}

/// Raises the limit on open files to the system's maximum, because a store has one file per degree. Windows has no such
/// limit.
pub fn raise_file_limit() {
    #[cfg(unix)]
    {
        use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
        let limit = getrlimit(Resource::Nofile);
        // If this fails, the lower limit stays, and an error is reported when too many files are opened.
        let _ = setrlimit(Resource::Nofile, Rlimit { current: limit.maximum, ..limit });
    }
}
