//! How many threads: what was asked for, else what the machine lets this process have.

use anyhow::{Context, Result};
use clap::Args;

/// What OpenBLAS is built for (`.cargo/config.toml`).
const MOST: usize = 64;

/// `--threads`.
#[derive(Debug, Clone, Copy, Args)]
pub struct Threads {
    /// Threads to use [default: the CPUs this process may run on, or SLURM_CPUS_PER_TASK if fewer]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    pub threads: Option<u16>,
}

impl Threads {
    /// The number of threads.
    pub fn count(self) -> usize {
        // Knows affinity masks and cgroup quotas.
        let available = std::thread::available_parallelism().map_or(1, |n| n.get());
        let slurm = std::env::var("SLURM_CPUS_PER_TASK").ok().and_then(|text| text.parse::<usize>().ok());
        let available = available.min(MOST);
        match (self.threads, slurm) {
            (Some(threads), _) => usize::from(threads),
            (None, Some(slurm)) if slurm > 0 => slurm.min(available),
            (None, _) => available,
        }
    }

    /// A pool of that many threads, in which the work is to be `install`ed.
    ///
    /// # Errors
    ///
    /// When the system refuses the threads.
    pub fn pool(self) -> Result<rayon::ThreadPool> {
        let builder = rayon::ThreadPoolBuilder::new().num_threads(self.count());
        builder.build().context("cannot start the threads; ask for fewer with --threads")
    }
}
