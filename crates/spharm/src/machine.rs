//! Memory that this process may use, by the system's account.

use rustix::process::{Resource, getrlimit};

use crate::Error;

/// What is assumed to be free where the system doesn't say.
const UNKNOWN: u64 = 2 << 30;

/// Returns the bytes of memory that are free, by the system's account and by that of this process's control group,
/// whichever is less; 2 GiB where neither can be read.
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
    free.into_iter().chain(group).min().unwrap_or(UNKNOWN) as usize
}

/// Checks, before work starts, that this process's limits on data (`ulimit -d`) and address space (`ulimit -v`) allow
/// for `data` bytes of anonymous memory and `mapped` bytes of mapped files beyond what it has.
///
/// # Errors
///
/// [`Error::Limit`] with the limit and the least that works.
pub fn check_limits(data: usize, mapped: usize) -> Result<(), Error> {
    let checks = [
        (Resource::Data, "VmData:", data, "data (ulimit -d)"),
        (Resource::As, "VmSize:", data + mapped, "address space (ulimit -v)"),
    ];
    for (resource, used, more, what) in checks {
        let (Some(limit), Some(used)) = (getrlimit(resource).current, process_status(used)) else { continue };
        let needed = used + more as u64;
        if limit < needed {
            return Err(Error::Limit { what, limit, needed });
        }
    }
    Ok(())
}

/// Returns a field of `/proc/self/status`, such as `VmHWM:`, in bytes; `None` where the system has none.
pub fn process_status(field: &str) -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(field))?;
    let kib: u64 = line.trim().trim_end_matches(" kB").trim().parse().ok()?;
    Some(kib << 10)
}
