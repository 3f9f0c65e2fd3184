//! The code of the command line that the verbs (subcommands) of `spharm` share.
//!
//! All code that reads flags, prints, handles signals or ends the process is here or in the verbs; the library does
//! none of this.
//!
//! | module | contents |
//! |---|---|
//! | [`cells`] | check of the number of cells in the rows of tables |
//! | [`freesurfer`] | names of files in FreeSurfer's folders |
//! | [`models`] | the surface to which a model was fitted |
//! | [`size`] | sizes in arguments, such as `512MiB` |
//! | [`threads`] | the number of threads, and the pool |
//! | [`console`] | notes, warnings and progress on stderr |
//! | [`exit`] | exit codes and signals |
//! | [`advice`] | advice on errors of the library: which flags to change |
//! | [`help`] | headings, formats and examples of the help texts |
//! | [`inputs`] | spheres, surfaces and signals from files, with their warnings |
//! | [`monitor`] | the progress of the library on the console |
//! | [`surfaces`] | the surfaces that arguments name: mesh files, and labels of volumes |
//! | [`names`] | names of outputs, derived from each input's path alone |
//! | [`printable`] | escaping of text from files and arguments before it is printed |
//! | [`roles`] | roles of arguments: inputs and outputs |
//! | [`values`] | numbers in arguments |
//! | [`volumes`] | how to read volumes, and the surface of a label |
//! | [`usage`] | errors for conflicting, missing or invalid arguments |
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
