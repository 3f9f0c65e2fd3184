//! Fits cohorts: reads lists of surfaces, fits the surfaces, and writes tables of outcomes.
//!
//! A cohort may have thousands of surfaces, fitted by many processes that may be killed at any time. A [`Manifest`] is
//! a table with one row per surface; each process fits the rows of its [`Shard`] with [`run()`](run::run). Each process
//! has its own table of outcomes, a [`StatusFile`]. Whenever a row is finished, the process appends a line to its
//! table, so that no outcome is lost if the process is killed. [`Merged`] merges the tables of all processes.
//!
//! ```
//! use spharm_cohort::{Entry, Manifest, Merged, Shard, State, StatusFile};
//!
//! let folder = tempfile::tempdir()?;
//! let path = folder.path().join("subjects.tsv");
//! std::fs::write(&path, "id\tsurface\tgroup\na\ta.ply\t1\nb\tb.ply\t2\n")?;
//! let manifest = Manifest::read(&path)?;
//! assert_eq!(manifest.rows[1].surface, folder.path().join("b.ply"));
//!
//! let shard: Shard = "1/2".parse()?;
//! let status = folder.path().join("1.tsv");
//! let mut file = StatusFile::open(&status)?;
//! for row in shard.of(&manifest.rows) {
//!     file.append(&Entry { seconds: Some(0.5), ..Entry::new(&row.id, State::Done) })?;
//! }
//! let merged = Merged::read([status])?;
//! assert_eq!(merged.count(State::Done), 1);
//! assert!(merged.entry("b").is_some() && merged.entry("a").is_none());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`Manifest`], [`Row`] | the surfaces to fit, from a table |
//! | [`rows_of_folder`], [`meshes_of_folder`] | the surfaces to fit, from a folder |
//! | [`Shard`] | the rows of one process |
//! | [`StatusFile`], [`Entry`], [`State`] | outcomes of one process, a line at a time |
//! | [`Merged`] | outcomes of all processes |
//! | [`mod@run`] | [`run()`](run::run): fits all rows; the memory doesn't grow with the number of rows |
//! | [`files`] | the files of a model |
//! | [`rerun`] | decisions about existing outputs |
//! | [`reader`] | reading of meshes, and of labels in volumes |
//! | [`equal`] | inputs that occur twice |
//! | [`mod@check`] | quality control of a group: flags subjects to look at |
//! | [`mod@degree`] | one degree for the models of many surfaces |
//! | [`evaluate`] | models evaluated on one sphere |
//! | `table` | TSV and CSV tables, read with line numbers |

#![forbid(unsafe_code)]

pub mod check;
pub mod degree;
pub mod equal;
mod error;
pub mod evaluate;
pub mod files;
mod folder;
mod formulas;
mod manifest;
mod merge;
mod origin;
pub mod reader;
pub mod rerun;
pub mod run;
mod shard;
mod status;
mod table;

pub use error::{CohortError, volumes_hint, wrong_cells};
pub use folder::{FolderMeshes, file_stem, is_named_sphere, meshes_of_folder, rows_of_folder};
pub use formulas::{cell, guarded, unguarded};
pub use manifest::{Manifest, Row, check_id, is_model};
pub use merge::Merged;
pub use shard::Shard;
pub use status::{Entry, State, StatusFile};
pub use table::line_of_record;
