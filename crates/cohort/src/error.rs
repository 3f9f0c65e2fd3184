//! What can go wrong with manifests, shards and status files.

use std::io;
use std::path::PathBuf;

/// Errors of this crate. Lines of tables are counted from 1, with the header.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CohortError {
    /// The operating system refused something.
    #[error("{}: cannot {action}: {source}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was being done.
        action: &'static str,
        /// Why it failed.
        source: io::Error,
    },
    /// A table that isn't UTF-8 text.
    #[error("{}: line {line}: expected UTF-8 text, found {found}; save the table as UTF-8", .path.display())]
    Encoding {
        /// The table.
        path: PathBuf,
        /// Line.
        line: usize,
        /// What is there.
        found: String,
    },
    /// A table without any row below its header.
    #[error("{}: the table has no rows; expected a header and one row per surface", .path.display())]
    NoRows {
        /// The table.
        path: PathBuf,
    },
    /// A column that is needed and isn't there.
    #[error("{}: line {line}: missing column {column}; found {}{hint}", .path.display(), .found.join(", "))]
    NoColumn {
        /// The table.
        path: PathBuf,
        /// Line of the header.
        line: usize,
        /// The column.
        column: &'static str,
        /// The columns that are there.
        found: Vec<String>,
        /// What may be the reason, from a semicolon on; or nothing.
        hint: &'static str,
    },
    /// Two columns of one name.
    #[error("{}: line {line}: duplicate column {column}; rename one", .path.display())]
    ColumnTwice {
        /// The table.
        path: PathBuf,
        /// Line of the header.
        line: usize,
        /// The column.
        column: String,
    },
    /// A column whose name is almost one that means something.
    #[error(
        "{}: line {line}: unknown column {column:?}; rename it to {nearest}, or to something less similar",
        .path.display()
    )]
    NearlyColumn {
        /// The table.
        path: PathBuf,
        /// Line of the header.
        line: usize,
        /// The column.
        column: String,
        /// The one that it is almost.
        nearest: &'static str,
    },
    /// A row with more or fewer cells than the header.
    #[error("{}: line {line}: expected {expected} cells as in the header, found {found}", .path.display())]
    Cells {
        /// The table.
        path: PathBuf,
        /// Line.
        line: usize,
        /// Cells of the header.
        expected: usize,
        /// Cells of the row.
        found: usize,
    },
    /// A cell that can't be what it has to be.
    #[error("{}: line {line}: column {column}: expected {expected}, found {found}", .path.display())]
    Cell {
        /// The table.
        path: PathBuf,
        /// Line.
        line: usize,
        /// The column.
        column: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it is, with control characters escaped.
        found: String,
    },
    /// Two rows of one id, or with one output.
    #[error("{}: line {line}: duplicate {what} {value}, first used on line {first}", .path.display())]
    Twice {
        /// The table.
        path: PathBuf,
        /// Line.
        line: usize,
        /// `id` or `output`.
        what: &'static str,
        /// The value.
        value: String,
        /// Line of the other.
        first: usize,
    },
    /// A status file that another process writes to.
    #[error("{}: another process is writing to this status file; give each shard its own status file", .path.display())]
    Locked {
        /// The file.
        path: PathBuf,
    },
    /// A file that exists and isn't a status file.
    #[error("{}: not a status file: expected {expected:?} as the first line, found {found:?}", .path.display())]
    NotStatus {
        /// The file.
        path: PathBuf,
        /// The header.
        expected: String,
        /// Its first line.
        found: String,
    },
    /// A shard that isn't one.
    #[error("invalid shard {found}; expected INDEX/COUNT, such as 0/10 for the first of ten, or slurm")]
    NotAShard {
        /// What was given.
        found: String,
    },
    /// Slurm's environment, where it doesn't tell which task of an array this is.
    #[error("--shard slurm: {problem}")]
    Slurm {
        /// What is wrong, and what to do.
        problem: String,
    },
}
