//! Determines the number of threads: the requested number or, by default, the number of CPUs that this process may use.

use anyhow::{Context, Result};
use clap::Args;

/// Maximum number of threads that this project's build of OpenBLAS supports (`.cargo/config.toml`).
const MOST: usize = 64;

/// Argument `--threads`.
#[derive(Debug, Clone, Copy, Args)]
pub struct Threads {
    /// Number of threads [default: all CPUs]
    ///
    /// The default is the number of CPUs that this process may run on, or SLURM_CPUS_PER_TASK if that is fewer.
    #[arg(long, value_name = "N", help_heading = crate::help::RESOURCES, value_parser = clap::value_parser!(u16).range(1..=64))]
    pub threads: Option<u16>,
}

impl Threads {
    /// Returns the number of threads.
    pub fn count(self) -> usize {
        // The default takes affinity masks and cgroup quotas into account.
        let available = std::thread::available_parallelism().map_or(1, |n| n.get());
        let slurm = std::env::var("SLURM_CPUS_PER_TASK").ok().and_then(|text| text.parse::<usize>().ok());
        let available = available.min(MOST);
        match (self.threads, slurm) {
            (Some(threads), _) => usize::from(threads),
            (None, Some(slurm)) if slurm > 0 => slurm.min(available),
            (None, _) => available,
        }
    }

    /// Starts a pool with this number of threads. Run the work with the pool's method `install`.
    ///
    /// # Errors
    ///
    /// If the system refuses to start the threads.
    pub fn pool(self) -> Result<rayon::ThreadPool> {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(self.count());
        builder.build().context("cannot start the threads; ask for fewer with --threads")
    }
}
