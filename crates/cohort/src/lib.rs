//! Lists of surfaces to fit, their shards, and tables of what became of each.
//!
//! A cohort is thousands of surfaces that are fitted by many processes, some of which are killed. What is to be done is
//! one table, a [`Manifest`] with a row for each surface; a process takes the rows of its [`Shard`]. What has been done
//! is another table for each process, a [`StatusFile`], to which a line is appended when a row is finished, so that a
//! kill loses nothing. [`Merged`] puts those together.
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
//! | [`Manifest`], [`Row`] | what is to be done |
//! | [`Shard`] | the rows of one process |
//! | [`StatusFile`], [`Entry`], [`State`] | what one process has done, a line at a time |
//! | [`Merged`] | what all of them have done |
//! | `table` | TSV and CSV with the numbers of lines |

#![forbid(unsafe_code)]

mod error;
mod formulas;
mod manifest;
mod merge;
mod shard;
mod status;
mod table;

pub use error::CohortError;
pub use formulas::{guarded, unguarded};
pub use manifest::{Manifest, Row, check_id};
pub use merge::Merged;
pub use shard::Shard;
pub use status::{Entry, State, StatusFile};
