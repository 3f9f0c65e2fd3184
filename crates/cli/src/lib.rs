//! The command line around the library: the code shared by the verbs (subcommands) of `spharm`.
//!
//! All code that reads flags, prints, handles signals or ends the process is here or in the verbs; the library does
//! none of this.
//!
//! | module | contents |
//! |---|---|
//! | [`cells`] | number of cells in the rows of tables |
//! | [`freesurfer`] | names of files in FreeSurfer's folders |
//! | [`models`] | the surface to which a model was fitted |
//! | [`size`] | sizes as people write them: `512MiB` |
//! | [`threads`] | the number of threads, and the pool |
//! | [`console`] | notes, warnings and progress on stderr |
//! | [`exit`] | exit codes and signals |
//! | [`advice`] | the flag that remedies an error of the library |
//! | [`help`] | headings, formats and examples of the help texts |
//! | [`inputs`] | spheres, surfaces and signals from files, with their warnings |
//! | [`monitor`] | the progress of the library on the console |
//! | [`surfaces`] | the surfaces named by arguments: files, and labels of volumes |
//! | [`names`] | names of outputs, from each input's path alone |
//! | [`printable`] | escaping text from outside before it is printed |
//! | [`roles`] | roles of arguments: inputs and outputs |
//! | [`values`] | numbers in arguments |
//! | [`volumes`] | how to read volumes, and the surface of a label |
//! | [`usage`] | errors of conflicting, missing or invalid arguments |
//! | [`paths`] | lists and folders of inputs, names of models |
//! | [`output`] | checks of output files; results to stdout, reports to files |
//! | [`machine`] | memory use, the limit on open files, versions |
//! | [`memory`] | `--memory`: comparison of memory plans with the budget |

pub mod advice;
pub mod cells;
pub mod console;
pub mod exit;
pub mod freesurfer;
pub mod help;
pub mod inputs;
pub mod machine;
pub mod memory;
pub mod models;
pub mod monitor;
pub mod names;
pub mod output;
pub mod paths;
pub mod printable;
pub mod roles;
pub mod size;
pub mod surfaces;
pub mod threads;
pub mod usage;
pub mod values;
pub mod volumes;

use clap::Args;

pub use usage::Usage;

/// Flags of every verb.
#[derive(Debug, Clone, Copy, Args)]
pub struct Common {
    /// Print more details
    #[arg(short, long, global = true, help_heading = None)]
    pub verbose: bool,
    /// Print only results, warnings and errors
    #[arg(short, long, global = true, conflicts_with = "verbose", help_heading = None)]
    pub quiet: bool,
}

impl Common {
    /// Returns the console for these flags.
    pub fn console(self) -> console::Console {
        console::Console::new(self.verbose, self.quiet)
    }
}
