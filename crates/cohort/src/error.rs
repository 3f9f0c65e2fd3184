//! Errors of manifests, shards and status files.

use std::io;
use std::path::PathBuf;

/// Errors of this crate. Lines of tables are counted from 1, including the header.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CohortError {
    /// An operation on a file failed.
    #[error("{}: cannot {action}: {source}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The operation.
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
        /// The bytes found.
        found: String,
    },
    /// A table without any row below its header.
    #[error("{}: the table has no rows; expected a header and one row per surface", .path.display())]
    NoRows {
        /// The table.
        path: PathBuf,
    },
    /// A missing required column.
    #[error("{}: line {line}: missing column {column}; found {}{hint}", .path.display(), .found.join(", "))]
    NoColumn {
        /// The table.
        path: PathBuf,
        /// Line of the header.
        line: usize,
        /// The column.
        column: &'static str,
        /// The existing columns.
        found: Vec<String>,
        /// A possible reason, beginning with a semicolon; or empty.
        hint: &'static str,
    },
    /// Two columns with the same name.
    #[error("{}: line {line}: duplicate column {column}; rename one", .path.display())]
    ColumnTwice {
        /// The table.
        path: PathBuf,
        /// Line of the header.
        line: usize,
        /// The column.
        column: String,
    },
    /// A column whose name is almost that of a known column.
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
        /// The most similar known column.
        nearest: &'static str,
    },
    /// A row with more or fewer cells than the header.
    #[error("{}: line {line}: expected {expected} cells as in the header, found {found}", .path.display())]
    Cells {
        /// The table.
        path: PathBuf,
        /// Line.
        line: usize,
        /// Number of cells of the header.
        expected: usize,
        /// Number of cells of the row.
        found: usize,
    },
    /// A cell with an invalid value.
    #[error("{}: line {line}: column {column}: expected {expected}, found {found}", .path.display())]
    Cell {
        /// The table.
        path: PathBuf,
        /// Line.
        line: usize,
        /// The column.
        column: &'static str,
        /// Valid values.
        expected: &'static str,
        /// Its value, with control characters escaped.
        found: String,
    },
    /// Two rows with the same id or the same output.
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
        /// Line of the first occurrence.
        first: usize,
    },
    /// A status file that another process is writing to.
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
    /// A malformed shard.
    #[error("invalid shard {found}; expected INDEX/COUNT, such as 0/10 for the first of ten, or slurm")]
    NotAShard {
        /// The given text.
        found: String,
    },
    /// An environment of Slurm that doesn't identify this process's task of an array.
    #[error("--shard slurm: {problem}")]
    Slurm {
        /// The problem and its remedy.
        problem: String,
    },
}
