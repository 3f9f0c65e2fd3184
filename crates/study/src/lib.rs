//! The verb `study` of the program, which makes a page from a table of subjects. Each stage is a command of spharm. The
//! program passes this crate a function that runs commands, so that the crate doesn't depend on the program.
//!
//! | module | contents |
//! |---|---|
//! | `run`, `call`, `commands` | a call of the verb: its arguments and checks, its state, its commands |
//! | `config`, `keys`, `subjects` | the study's file, its keys and its table of subjects |
//! | `sides` | both sides of each subject, such as hemispheres |
//! | `surfaces` | the table of meshes that are made to correspond |
//! | `fits` | the fits of the subjects' surfaces and signals |
//! | `plan`, `lists` | the study's files and their locations, and the lists that stages read |
//! | `paths` | paths that don't depend on the current folder |
//! | `provenance`, `methods` | the record of the study, and the paragraph for a paper |
//! | `stages` | the commands of the study |
//! | `check`, `emptied` | checks before any command is run, and after the fits |
//! | `ending` | the output of a study at its end |
//! | `stage` | one command, and the decision whether it must run |
//! | `foreign` | refusal to replace files that the study hasn't written |
//! | `tidy` | removal of files that no longer belong to the study |
//! | `hemispheres` | warning about fits with a sphere or mask of the other hemisphere |
//! | `voxels` | warning about groups with voxels of different sizes |
//! | `warnings` | the warnings at the head of the page |

mod args;
mod call;
mod check;
mod commands;
mod config;
mod emptied;
mod ending;
mod exclusion;
mod fits;
mod foreign;
mod hemispheres;
mod init;
mod keys;
mod lists;
mod methods;
mod paths;
mod plan;
mod provenance;
mod run;
mod sides;
mod stage;
mod stages;
mod subjects;
mod surfaces;
mod test;
mod tidy;
mod voxels;
mod warnings;

pub use self::args::Cli;
pub use self::call::{Preview, PreviewFit};
pub use self::run::run;
