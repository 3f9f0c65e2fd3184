//! Determines the memory that this process may use, as reported by the system.

use std::fs::read_to_string;
use std::path::Path;

use crate::Error;

/// Free memory in bytes that is assumed if the system doesn't report it.
const UNKNOWN: u64 = 2 << 30;

/// A limit on the memory of this process. Only Unix has such limits.
#[derive(Clone, Copy)]
enum Limit {
    /// Limits the size of the process's data (`ulimit -d`).
    Data,
    /// Limits the size of the process's address space (`ulimit -v`).
    AddressSpace,
}

impl Limit {
    /// Returns the limit in bytes; `None` if the process has no such limit.
    fn current(self) -> Option<u64> {
        #[cfg(unix)]
        {
            use rustix::process::{Resource, getrlimit};
            getrlimit(match self {
                Self::Data => Resource::Data,
                Self::AddressSpace => Resource::As,
            })
            .current
        }
        #[cfg(not(unix))]
        None
    }
}

/// All limits that are checked. Each limit is listed with the field of `/proc/self/status` that it restricts, and with
/// its name in messages.
const LIMITS: [(Limit, &str, &str); 2] =
    [(Limit::Data, "VmData:", "data (ulimit -d)"), (Limit::AddressSpace, "VmSize:", "address space (ulimit -v)")];

/// Returns the free memory in bytes: the minimum of the system's free memory, the unused part of the limits of this
/// process's control groups, and the unused part of the limits on its data and address space. Returns 2 GiB if none of
/// these is known.
pub fn available_memory() -> usize {
    let free = free_of_system();
    let groups = read_to_string("/proc/self/cgroup").unwrap_or_default();
    let groups = free_in_groups(&groups, Path::new("/sys/fs/cgroup"));
    let limits =
        LIMITS.iter().filter_map(|&(limit, used, _)| Some(limit.current()?.saturating_sub(process_status(used)?)));
    free.into_iter().chain(groups).chain(limits).min().unwrap_or(UNKNOWN) as usize
}

/// Returns the free memory of the system; `None` if the system doesn't report it.
#[cfg(target_os = "linux")]
fn free_of_system() -> Option<u64> {
    let meminfo = read_to_string("/proc/meminfo").ok()?;
    let line = meminfo.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    Some(line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()? << 10)
}

/// Returns the free memory of the system; `None` if the system doesn't report it.
#[cfg(not(target_os = "linux"))]
fn free_of_system() -> Option<u64> {
    let mut system = sysinfo::System::new();
    system.refresh_memory();
    Some(system.available_memory()).filter(|free| *free > 0)
}

/// Returns the smallest amount of free memory among control groups and their ancestors; `None` if no group has a limit.
/// `groups` is the text of `/proc/self/cgroup`, which lists the groups. The hierarchies of both versions are mounted
/// below `root`.
fn free_in_groups(groups: &str, root: &Path) -> Option<u64> {
    let of_line = |line: &str| -> Option<u64> {
        let mut parts = line.splitn(3, ':');
        let (_, controllers, path) = (parts.next()?, parts.next()?, parts.next()?);
        let (mount, version) = match controllers {
            "" => (root.to_owned(), &V2),
            names if names.split(',').any(|name| name == "memory") => (root.join("memory"), &V1),
            _ => return None,
        };
        // In a container, the path may be the path on the host. Only the root of such a path exists in the container.
        let group = Path::new(path.trim_start_matches('/'));
        group.ancestors().filter_map(|group| version.free(&mount.join(group))).min()
    };
    groups.lines().filter_map(of_line).min()
}

/// Names of the files with limits and usage, for one version of control groups.
struct Version {
    limits: &'static [&'static str],
    used: &'static str,
    /// Fields of `memory.stat` that count the pages of cached files. These pages are included in the usage, but are
    /// dropped when memory is short.
    files: [&'static str; 2],
}

/// Names of the files of version 1 of control groups.
const V1: Version = Version {
    limits: &["memory.limit_in_bytes"],
    used: "memory.usage_in_bytes",
    files: ["total_inactive_file ", "total_active_file "],
};

/// Names of the files of version 2 of control groups. `memory.high` is treated as a limit, too: above it, the system
/// doesn't kill a process, but slows it down almost to a standstill.
const V2: Version = Version {
    limits: &["memory.max", "memory.high"],
    used: "memory.current",
    files: ["inactive_file ", "active_file "],
};

impl Version {
    /// Returns the free memory of a control group: its limit minus its usage without the pages of cached files. Returns
    /// `None` if the limit or the usage is unknown.
    fn free(&self, group: &Path) -> Option<u64> {
        let number = |name: &&str| read_to_string(group.join(name)).ok()?.trim().parse::<u64>().ok();
        let limit = self.limits.iter().filter_map(number).min()?;
        let stat = read_to_string(group.join("memory.stat")).unwrap_or_default();
        let field = |name: &str| stat.lines().find_map(|line| line.strip_prefix(name)?.trim().parse::<u64>().ok());
        let files: u64 = self.files.iter().filter_map(|name| field(name)).sum();
        Some(limit.saturating_sub(number(&self.used)?.saturating_sub(files)))
    }
}

/// A limit on this process that a computation would exceed.
pub(crate) struct Exceeded {
    pub(crate) what: &'static str,
    /// Number of bytes allowed.
    pub(crate) limit: u64,
    /// Number of bytes needed.
    pub(crate) needed: u64,
}

/// Returns the limit that a further `data` bytes of anonymous memory and `mapped` bytes of mapped files would exceed,
/// if there is one.
pub(crate) fn exceeded(data: usize, mapped: usize) -> Option<Exceeded> {
    LIMITS.iter().zip([data, data.saturating_add(mapped)]).find_map(|(&(limit, used, what), more)| {
        let (limit, used) = (limit.current()?, process_status(used)?);
        let needed = used.saturating_add(more as u64);
        (limit < needed).then_some(Exceeded { what, limit, needed })
    })
}

/// Checks that this process's limits on data (`ulimit -d`) and address space (`ulimit -v`) allow a further `data`
/// bytes of anonymous memory and `mapped` bytes of mapped files, before work starts.
///
/// # Errors
///
/// [`Error::Limit`], with the smallest sufficient limit, if a limit would be exceeded.
pub fn check_limits(data: usize, mapped: usize) -> Result<(), Error> {
    exceeded(data, mapped).map_or(Ok(()), |Exceeded { what, limit, needed }| Err(Error::Limit { what, limit, needed }))
}

/// Returns a field of `/proc/self/status`, such as `VmHWM:`, in bytes; `None` if the system doesn't provide it.
pub fn process_status(field: &str) -> Option<u64> {
    let text = read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix(field))?;
    let kib: u64 = line.trim().trim_end_matches(" kB").trim().parse().ok()?;
    Some(kib << 10)
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    #[test]
    fn the_tightest_group_on_the_way_to_the_root_counts() {
        let root = tempfile::tempdir().unwrap();
        let group = |path: &str, files: [(&str, &str); 2]| {
            let folder = root.path().join(path);
            fs::create_dir_all(&folder).unwrap();
            files.iter().for_each(|(name, text)| fs::write(folder.join(name), text).unwrap());
        };
        group("slurm", [("memory.max", "1000\n"), ("memory.current", "400\n")]);
        group("slurm/job", [("memory.max", "max\n"), ("memory.current", "300\n")]);
        group("memory/a", [("memory.limit_in_bytes", "900\n"), ("memory.usage_in_bytes", "800\n")]);
        let free = |text: &str| free_in_groups(text, root.path());
        assert_eq!(free("0::/slurm/job\n"), Some(600));
        assert_eq!(free("0::/elsewhere\n"), None);
        assert_eq!(free("5:cpu,memory:/a/b\n3:pids:/a\n0::/slurm\n"), Some(100));
        assert_eq!(free("3:pids:/slurm\n"), None);
    }

    #[test]
    fn pages_of_files_count_as_free_and_slowing_down_as_a_limit() {
        let root = tempfile::tempdir().unwrap();
        let group = |path: &str, files: &[(&str, &str)]| {
            let folder = root.path().join(path);
            fs::create_dir_all(&folder).unwrap();
            files.iter().for_each(|(name, text)| fs::write(folder.join(name), text).unwrap());
        };
        let stat = "anon 300\ninactive_file 250\nactive_file 50\ninactive_anon 10\n";
        group("pod", &[("memory.max", "1000\n"), ("memory.current", "700\n"), ("memory.stat", stat)]);
        group("pod/step", &[("memory.max", "max\n"), ("memory.high", "500\n"), ("memory.current", "100\n")]);
        let stat = "inactive_file 1\ntotal_inactive_file 30\ntotal_active_file 20\n";
        let old = [("memory.limit_in_bytes", "400\n"), ("memory.usage_in_bytes", "390\n"), ("memory.stat", stat)];
        group("memory/job", &old);
        let free = |text: &str| free_in_groups(text, root.path());
        assert_eq!(free("0::/pod\n"), Some(600));
        assert_eq!(free("0::/pod/step\n"), Some(400));
        assert_eq!(free("9:memory:/job/step_0\n0::/pod\n"), Some(60));
        // A group with a known limit but unknown usage, for example because the usage file isn't readable.
        group("odd", &[("memory.max", "1000\n")]);
        assert_eq!(free("0::/odd\n"), None);
    }
}
