//! Defines the errors of manifests, shards and status files.

use std::io;
use std::path::{Path, PathBuf};

/// Errors of this crate. Lines of tables are counted from 1; the header counts as a line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CohortError {
    /// An operation on a file failed.
    #[error("{}: cannot {action}: {source}", .path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// The operation that failed, such as "read".
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The table isn't UTF-8 text.
    #[error("{}: line {line}: expected UTF-8 text, found {found}; save the table as UTF-8", .path.display())]
    Encoding {
        /// Path of the table.
        path: PathBuf,
        /// Number of the line.
        line: usize,
        /// The bytes found, in printable form.
        found: String,
    },
    /// The table has no row below its header.
    #[error("{}: the table has no rows; expected a header and one row per surface", .path.display())]
    NoRows {
        /// Path of the table.
        path: PathBuf,
    },
    /// The table lacks a required column.
    #[error("{}: line {line}: missing column {column}; found {}{hint}", .path.display(), .found.join(", "))]
    NoColumn {
        /// Path of the table.
        path: PathBuf,
        /// Number of the header's line.
        line: usize,
        /// Name of the missing column.
        column: &'static str,
        /// Names of the table's columns.
        found: Vec<String>,
        /// Text about a possible reason for the missing column, beginning with a semicolon. Empty if the reason is
        /// unknown.
        hint: &'static str,
    },
    /// Two columns have the same name.
    #[error("{}: line {line}: duplicate column {column}; rename one of the two", .path.display())]
    ColumnTwice {
        /// Path of the table.
        path: PathBuf,
        /// Number of the header's line.
        line: usize,
        /// Name of both columns.
        column: String,
    },
    /// An unknown column has nearly the same name as a known column.
    #[error(
        "{}: line {line}: unknown column {column:?}; rename the column to {nearest}, or to a name less similar to \
         {nearest}",
        .path.display()
    )]
    NearlyColumn {
        /// Path of the table.
        path: PathBuf,
        /// Number of the header's line.
        line: usize,
        /// Name of the column.
        column: String,
        /// Name of the most similar known column.
        nearest: &'static str,
    },
    /// A row has more or fewer cells than the header.
    #[error("{}: {}", path.display(), wrong_cells(*line, *expected, *found))]
    Cells {
        /// Path of the table.
        path: PathBuf,
        /// Number of the row's line.
        line: usize,
        /// Number of cells in the header.
        expected: usize,
        /// Number of cells in the row.
        found: usize,
    },
    /// A cell has an invalid value.
    #[error("{}: line {line}: column {column}: expected {expected}, found {found}", .path.display())]
    Cell {
        /// Path of the table.
        path: PathBuf,
        /// Number of the cell's line.
        line: usize,
        /// Name of the column.
        column: &'static str,
        /// Description of the valid values.
        expected: &'static str,
        /// Value of the cell, with control characters escaped.
        found: String,
    },
    /// Two rows have the same id or the same output.
    #[error("{}: line {line}: duplicate {what} {value}, first used on line {first}", .path.display())]
    Twice {
        /// Path of the table.
        path: PathBuf,
        /// Line number of the second of the two rows.
        line: usize,
        /// The duplicated property: `id` or `output`.
        what: &'static str,
        /// The duplicated value.
        value: String,
        /// Line number of the first of the two rows.
        first: usize,
    },
    /// The folder has no surfaces.
    #[error(
        "{}: the folder has no meshes (such as .ply, .obj, .surf.gii) or label volumes (such as .nii.gz); list files \
         with other names, such as lh.pial, in a table",
        .path.display()
    )]
    NoSurfaces {
        /// Path of the folder.
        path: PathBuf,
    },
    /// The folder has no meshes to fit.
    #[error(
        "{}: the folder has no meshes to fit (such as .ply, .obj, .surf.gii); give other files, such as volumes or \
         lh.pial, by name{}",
        .path.display(), volumes_hint(.path, *.volumes)
    )]
    NoMeshes {
        /// Path of the folder.
        path: PathBuf,
        /// Number of volumes in the folder.
        volumes: usize,
    },
    /// The name of a surface's file can't be an id.
    #[error("{}: the id of this file would be {id:?}, but {problem}; rename the file", .path.display())]
    FileId {
        /// Path of the file.
        path: PathBuf,
        /// The file's name without the extension of its format, which would be the id.
        id: String,
        /// Reason why this name can't be the id.
        problem: String,
    },
    /// Another process is writing to the status file.
    #[error("{}: another process is writing to this status file; give each shard its own status file", .path.display())]
    Locked {
        /// Path of the file.
        path: PathBuf,
    },
    /// The file exists but isn't a status file.
    #[error("{}: not a status file: expected {expected:?} as the first line, found {found:?}", .path.display())]
    NotStatus {
        /// Path of the file.
        path: PathBuf,
        /// The header of a status file.
        expected: String,
        /// First line of the file.
        found: String,
    },
    /// A string isn't a valid shard.
    #[error("invalid shard {found}; expected INDEX/COUNT, such as 0/10 for the first of ten, or slurm")]
    NotAShard {
        /// The invalid string.
        found: String,
    },
    /// The environment variables of Slurm are missing or invalid, or describe an array with gaps.
    #[error("--shard slurm: {problem}")]
    Slurm {
        /// Description of the problem and its remedy.
        problem: String,
    },
}

/// Returns the message about a row whose number of cells differs from that of the header, without the table's path.
#[must_use]
pub fn wrong_cells(line: usize, expected: usize, found: usize) -> String {
    let reason = if found > expected { " (decimal comma or missing quotes?)" } else { "" };
    format!("line {line}: expected {expected} cells as in the header, found {found}{reason}")
}

/// Returns a hint for the end of a message: the command `spharm volumes` fits the volumes in a folder. `volumes` is the
/// number of volumes in the folder. If this number is 0, the hint is empty.
#[must_use]
pub fn volumes_hint(folder: &Path, volumes: usize) -> String {
    let noun = if volumes == 1 { "volume" } else { "volumes" };
    match volumes {
        0 => String::new(),
        _ => format!("; `spharm volumes {}` fits the {volumes} {noun} in it", folder.display()),
    }
}
