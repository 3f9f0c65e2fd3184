//! Errors of samples and files of moments.

use std::io;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use spharm_monitor::Interrupted;
use spharm_surface::SurfaceError;
use spharm_transform::TransformError;

/// Errors of this crate. Rows of tables are counted from 1, in the order of the data, without a header.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MomentsError {
    /// The operating system reported an error.
    #[error("{}: cannot {action}: {source}", .path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The attempted action.
        action: &'static str,
        /// The system's error.
        source: io::Error,
    },
    /// A table whose bytes violate its format.
    #[error("{}: {format}: expected {expected}, found {found}", .path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The format.
        format: &'static str,
        /// The format's requirement.
        expected: String,
        /// What the file contains there.
        found: String,
    },
    /// A file whose name has no supported ending.
    #[error("{}: expected a file whose name ends in {}", .path.display(), .expected.join(", "))]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// The supported endings.
        expected: Vec<&'static str>,
    },
    /// A table without a required column.
    #[error("{}: no column {wanted}; it has {}", .path.display(), named(.there))]
    NoColumn {
        /// The file.
        path: PathBuf,
        /// The column that is missing.
        wanted: String,
        /// The table's columns.
        there: Vec<String>,
    },
    /// Columns that don't determine the samples' positions or values.
    #[error("{}: {problem}; it has {}", .path.display(), named(.there))]
    Columns {
        /// The file.
        path: PathBuf,
        /// What the columns leave unclear.
        problem: &'static str,
        /// The table's columns.
        there: Vec<String>,
    },
    /// An invalid row.
    #[error("{}: row {row}: {column}: expected {expected}, found {found}", .path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// The row, counted from 1.
        row: u64,
        /// The column.
        column: String,
        /// Accepted values.
        expected: &'static str,
        /// The value found.
        found: String,
    },
    /// An invalid sample in memory.
    #[error("sample {row}: {what}: expected {expected}, found {found}")]
    Sample {
        /// Index of the sample, counted from 0.
        row: usize,
        /// The invalid part of the sample.
        what: &'static str,
        /// Accepted values.
        expected: &'static str,
        /// The value found.
        found: String,
    },
    /// Arrays that don't belong together.
    #[error("{what}: expected {expected}, found {found}")]
    Arrays {
        /// The array or size that doesn't match.
        what: &'static str,
        /// The required size.
        expected: usize,
        /// The size found.
        found: usize,
    },
    /// Values, or weights, whose sum of squares leaves the range of f64.
    #[error(
        "column {channel}: expected values whose weighted squares sum to 1e-307 to 1e308; scale the values or the weights"
    )]
    Range {
        /// The column.
        channel: String,
    },
    /// A table without rows.
    #[error("{}: expected samples, found none", .path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A table over a sampling scheme whose number of rows isn't the number of vertices.
    #[error("{}: expected {expected} rows, one for each vertex of the sphere, found {found}; give the sphere that the values belong to", .path.display())]
    Rows {
        /// The file.
        path: PathBuf,
        /// Number of vertices of the sphere.
        expected: u64,
        /// Number of rows of the entire table.
        found: u64,
    },
    /// Values on vertices that can't be read.
    #[error(transparent)]
    Signal(SurfaceError),
    /// A file that grew or shrank while it was read.
    #[error("{}: the file changed while it was being read ({was} to {now} bytes); wait until nothing writes to it", .path.display())]
    Changed {
        /// The file.
        path: PathBuf,
        /// Bytes when it was opened.
        was: u64,
        /// Bytes after it was read.
        now: u64,
    },
    /// A shard whose index isn't below the number of shards.
    #[error("shard {index} of {of}: expected an index from 0 to {}, and at most {} shards", .of.saturating_sub(1), crate::moments::MOST_SHARDS)]
    Shard {
        /// The shard, counted from 0.
        index: u32,
        /// The number of shards.
        of: u32,
    },
    /// A shard of a stream, which can only be read once, from its beginning.
    #[error("standard input can't be read in shards; write it to a file, or give each shard its own part")]
    ShardOfStream,
    /// A memory budget that is too small.
    #[error("moments to degree {max_degree} take {} MiB, the budget is {} MiB; choose a lower degree or raise the budget", .needed.div_ceil(1 << 20), .budget >> 20)]
    Memory {
        /// The degree.
        max_degree: usize,
        /// Bytes needed.
        needed: usize,
        /// Bytes allowed.
        budget: usize,
    },
    /// A file that isn't a file of moments, or is damaged.
    #[error("{}: damaged or not a file of moments: {what}: expected {expected}, found {found}; make this part again", .path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// The field or check.
        what: &'static str,
        /// The format's requirement.
        expected: String,
        /// What the file contains.
        found: String,
    },
    /// A version of the format that this program doesn't support.
    #[error("{}: moments of format version {found}, this program reads versions {} to {}; use the program that wrote it, or make this part again", .path.display(), .expected.start(), .expected.end())]
    Version {
        /// The file.
        path: PathBuf,
        /// The versions that can be read.
        expected: RangeInclusive<u32>,
        /// The version found.
        found: u32,
    },
    /// Parts that can't be added.
    #[error(
        "{second} and {first}: {what} differ: {found}, not {expected}; only parts of the same degree and channels can be added"
    )]
    Differ {
        /// The property that differs.
        what: &'static str,
        /// Name of the part that the other part was compared with.
        first: String,
        /// Name of the part that differs.
        second: String,
        /// The property of the first part.
        expected: String,
        /// The property of the second part.
        found: String,
    },
    /// Parts that have samples in common.
    #[error("{first} and {second}: both have {what}; leave one of them out")]
    Overlap {
        /// Name of one part.
        first: String,
        /// Name of the other.
        second: String,
        /// The samples in common.
        what: String,
    },
    /// Parts that don't make up the whole.
    #[error("{} missing: {}", .missing.len(), .missing.join(", "))]
    Missing {
        /// The missing shards.
        missing: Vec<String>,
    },
    /// A table in Parquet, Arrow or LAS format, in a program built without support for them.
    #[error("{}: this build doesn't read Parquet, Arrow and LAS; the program installed by cargo does, and every build reads .npy and .csv", .path.display())]
    LeftOut {
        /// The file.
        path: PathBuf,
    },
    /// An empty list of parts.
    #[error("no parts to add")]
    NoParts,
    /// A degree that transforms don't support.
    #[error(transparent)]
    Transform(#[from] TransformError),
    /// A file of moments that can't be written.
    #[error(transparent)]
    Output(#[from] SurfaceError),
    /// The computation was asked to stop.
    #[error("{0}")]
    Interrupted(#[from] Interrupted),
}

fn named(columns: &[String]) -> String {
    match columns.len() {
        0 => "none".to_owned(),
        1 => format!("the column {}", columns[0]),
        _ => format!("the columns {}", columns.join(", ")),
    }
}

impl MomentsError {
    pub(crate) fn io(path: &std::path::Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }
}
