//! What the tools share.
//!
//! | module | what |
//! |---|---|
//! | [`size`] | sizes as people write them: `512MiB` |
//! | [`threads`] | how many threads, and the pool |
//! | [`console`] | notes, warnings and progress on stderr |
//! | [`exit`] | from errors to exit codes; signals |
//! | [`advice`] | which flag mends an error of the library |
//! | [`inputs`] | spheres, surfaces and signals from files, checked |
//! | [`monitor`] | the progress of the library on the console |
//! | [`usage`] | arguments that don't go together |
//! | [`output`] | results to stdout, reports to files |
//! | [`machine`] | peak memory, versions |

pub mod advice;
pub mod console;
pub mod exit;
pub mod inputs;
pub mod machine;
pub mod monitor;
pub mod output;
pub mod size;
pub mod threads;
pub mod usage;

use clap::Args;

pub use usage::Usage;

/// Flags of every tool.
#[derive(Debug, Clone, Copy, Args)]
pub struct Common {
    /// More about what is going on
    #[arg(short, long, global = true)]
    pub verbose: bool,
    /// No notes and no progress: the result, warnings and errors only
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
}

impl Common {
    /// The console that these flags ask for.
    pub fn console(self) -> console::Console {
        console::Console::new(self.verbose, self.quiet)
    }
}
