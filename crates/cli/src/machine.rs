//! What the process took, and what it runs as.

use serde::Serialize;

/// Memory of this process, bytes; `None` where the system doesn't tell.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Memory {
    /// Largest resident size so far, mapped files included.
    pub peak_resident: Option<u64>,
    /// Anonymous memory now: without mapped files, which the system can drop at any time.
    pub anonymous: Option<u64>,
}

/// Reads this process's memory from `/proc`.
pub fn memory() -> Memory {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let field = |name: &str| {
        let line = status.lines().find_map(|line| line.strip_prefix(name))?;
        let kib: u64 = line.trim().trim_end_matches(" kB").trim().parse().ok()?;
        Some(kib << 10)
    };
    Memory { peak_resident: field("VmHWM:"), anonymous: field("RssAnon:") }
}

/// Versions that a result may depend on.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct Versions {
    /// This program.
    pub spharm: &'static str,
    /// The store's format.
    pub store_format: u32,
    /// Operating system and processor.
    pub platform: (&'static str, &'static str),
}

/// The versions of this build.
pub fn versions() -> Versions {
    Versions {
        spharm: env!("CARGO_PKG_VERSION"),
        store_format: spharm_store::header::VERSION,
        platform: (std::env::consts::OS, std::env::consts::ARCH),
    }
}
