//! What the process took, and what it runs as.

use anyhow::{Result, bail};
use rustix::process::{Resource, getrlimit};
use serde::Serialize;

use crate::size::Size;

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
    Memory { peak_resident: status("VmHWM:"), anonymous: status("RssAnon:") }
}

/// A field of `/proc/self/status` in bytes.
fn status(name: &str) -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(name))?;
    let kib: u64 = line.trim().trim_end_matches(" kB").trim().parse().ok()?;
    Some(kib << 10)
}

/// Refuses to start what a limit on this process's data (`ulimit -d`) or address space (`ulimit -v`) would break off:
/// `data` and `mapped` are the bytes that will be asked for, of anonymous memory and of mapped files.
///
/// # Errors
///
/// When a limit is too low, with the least that works.
pub fn check_limits(data: usize, mapped: usize) -> Result<()> {
    let checks = [
        (Resource::Data, "VmData:", data, "data (ulimit -d)"),
        (Resource::As, "VmSize:", data + mapped, "address space (ulimit -v)"),
    ];
    for (resource, used, more, name) in checks {
        let (Some(limit), Some(used)) = (getrlimit(resource).current, status(used)) else { continue };
        let needed = used + more as u64;
        if limit < needed {
            let (limit, needed) = (Size(limit as usize), Size(needed as usize));
            bail!(
                "the limit on this process's {name} is {limit}; this takes {needed}: raise it or use fewer --threads"
            );
        }
    }
    Ok(())
}

/// Raises the limit on open files as far as the system allows: a store has a file for each degree.
pub fn raise_file_limit() {
    let limit = getrlimit(Resource::Nofile);
    // At worst it stays what it was, and an error names it when it is reached.
    let _ = rustix::process::setrlimit(Resource::Nofile, rustix::process::Rlimit { current: limit.maximum, ..limit });
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

/// Bytes of memory that are free to be used, by the system's account and by that of this process's group; two gibibytes
/// where neither tells.
pub fn available_memory() -> usize {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let number = |path: &str| read(path)?.trim().parse::<u64>().ok();
    let meminfo = read("/proc/meminfo").unwrap_or_default();
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"));
    let free = line.and_then(|line| line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()).map(|kib| kib << 10);
    let groups = [
        ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
        ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
    ];
    let group = groups.iter().find_map(|(limit, used)| Some(number(limit)?.saturating_sub(number(used)?)));
    free.into_iter().chain(group).min().unwrap_or(2 << 30) as usize
}
