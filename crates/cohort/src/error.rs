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
    #[error("{}: expected a header and a row for each surface, found no row", .path.display())]
    NoRows {
        /// The table.
        path: PathBuf,
    },
    /// A column that is needed and isn't there.
    #[error("{}: line {line}: expected a column {column}, found {}{hint}", .path.display(), .found.join(", "))]
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
    #[error("{}: line {line}: column {column} is there twice; rename one", .path.display())]
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
        "{}: line {line}: column {column:?} is not known; expected {nearest}, or a name that is less like it",
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
    #[error("{}: line {line}: expected {expected} cells, as the header has, found {found}", .path.display())]
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
    #[error("{}: line {line}: the {what} {value} is that of line {first}; give each row its own", .path.display())]
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
    #[error("{}: another process writes to this status file; give each shard one of its own", .path.display())]
    Locked {
        /// The file.
        path: PathBuf,
    },
    /// A file that exists and isn't a status file.
    #[error("{}: expected a status file, whose first line is {expected:?}, found {found:?}", .path.display())]
    NotStatus {
        /// The file.
        path: PathBuf,
        /// The header.
        expected: String,
        /// Its first line.
        found: String,
    },
    /// A shard that isn't one.
    #[error("expected a shard such as 0/10, the first of ten, or slurm, found {found}")]
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
