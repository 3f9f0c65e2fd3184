//! What can go wrong with samples and with files of moments.

use std::io;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use spharm_monitor::Interrupted;
use spharm_surface::SurfaceError;
use spharm_transform::TransformError;

/// Errors of this crate. Rows of tables are counted from 1, as the data have them, without a header.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MomentsError {
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
    /// A table whose bytes break the rules of its format.
    #[error("{}: {format}: expected {expected}, found {found}", .path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The format.
        format: &'static str,
        /// What its rules demand.
        expected: String,
        /// What is there.
        found: String,
    },
    /// A file whose name has the ending of no format that is read.
    #[error("{}: expected a file whose name ends in {}, found another ending", .path.display(), .expected.join(", "))]
    UnknownFormat {
        /// The file.
        path: PathBuf,
        /// The endings.
        expected: Vec<&'static str>,
    },
    /// A table without the columns that are needed.
    #[error("{}: no column {wanted}; it has {}", .path.display(), named(.there))]
    NoColumn {
        /// The file.
        path: PathBuf,
        /// What was looked for.
        wanted: String,
        /// The columns that it has.
        there: Vec<String>,
    },
    /// Columns that don't say where the samples are, or what they are.
    #[error("{}: {problem}; it has {}", .path.display(), named(.there))]
    Columns {
        /// The file.
        path: PathBuf,
        /// What is unclear.
        problem: &'static str,
        /// The columns that it has.
        there: Vec<String>,
    },
    /// A row that can't be used.
    #[error("{}: row {row}: {column}: expected {expected}, found {found}", .path.display())]
    Row {
        /// The file.
        path: PathBuf,
        /// The row, counted from 1.
        row: u64,
        /// The column.
        column: String,
        /// What it may hold.
        expected: &'static str,
        /// What it holds.
        found: String,
    },
    /// A sample in memory that can't be used.
    #[error("sample {row}: {what}: expected {expected}, found {found}")]
    Sample {
        /// Its number, counted from 0.
        row: usize,
        /// What of it.
        what: &'static str,
        /// What that may be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// Arrays that don't belong together.
    #[error("{what}: expected {expected}, found {found}")]
    Arrays {
        /// What doesn't fit.
        what: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many there are.
        found: usize,
    },
    /// Values, or weights, whose sum of squares leaves the range of f64.
    #[error(
        "column {channel}: expected values whose weighted squares sum to 1e-307 to 1e308, found others; scale the values, or the weights"
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
    /// A table over a sampling scheme that hasn't a row for each of its vertices.
    #[error("{}: expected {expected} rows, one for each vertex of the sphere, found {found}; give the sphere that the values are of", .path.display())]
    Rows {
        /// The file.
        path: PathBuf,
        /// Vertices of the sphere.
        expected: u64,
        /// Rows of the whole table.
        found: u64,
    },
    /// Values on vertices that can't be read.
    #[error(transparent)]
    Signal(SurfaceError),
    /// A file that grew or shrank while it was read.
    #[error("{}: {was} bytes when it was opened, {now} when it had been read; wait until nobody writes to it", .path.display())]
    Changed {
        /// The file.
        path: PathBuf,
        /// Bytes at first.
        was: u64,
        /// Bytes in the end.
        now: u64,
    },
    /// A shard that isn't one of its number.
    #[error("shard {index} of {of}: expected 0 to {} of at most {}", .of.saturating_sub(1), crate::moments::MOST_SHARDS)]
    Shard {
        /// The shard, counted from 0.
        index: u32,
        /// The number of shards.
        of: u32,
    },
    /// A shard of what can be read only once, from its beginning.
    #[error("standard input can't be read in shards; write it to a file, or give each shard its own part")]
    ShardOfStream,
    /// A memory budget that is too small.
    #[error("moments to degree {max_degree} take {} MiB, the budget is {} MiB; choose a lower degree or allow for more", .needed.div_ceil(1 << 20), .budget >> 20)]
    Memory {
        /// The degree.
        max_degree: usize,
        /// Bytes needed.
        needed: usize,
        /// Bytes allowed.
        budget: usize,
    },
    /// A file that isn't one of moments, or is damaged.
    #[error("{}: damaged or not a file of moments: {what}: expected {expected}, found {found}; make this part again", .path.display())]
    Corrupt {
        /// The file.
        path: PathBuf,
        /// The field or check.
        what: &'static str,
        /// What the format demands.
        expected: String,
        /// What the file has.
        found: String,
    },
    /// A version of the format that this program doesn't know.
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
    #[error("{second} and {first}: {what} differ: {found}, not {expected}; only parts of one kind add up")]
    Differ {
        /// What differs.
        what: &'static str,
        /// Name of the part that the other was compared with.
        first: String,
        /// Name of the part that differs.
        second: String,
        /// What the first has.
        expected: String,
        /// What the second has.
        found: String,
    },
    /// Parts that have samples in common.
    #[error("{first} and {second}: both have {what}; leave one of them out")]
    Overlap {
        /// Name of one part.
        first: String,
        /// Name of the other.
        second: String,
        /// What both have.
        what: String,
    },
    /// Parts of which some aren't there.
    #[error("{} missing: {}", .missing.len(), .missing.join(", "))]
    Missing {
        /// The shards that no part has.
        missing: Vec<String>,
    },
    /// A table of Parquet, Arrow or LAS, in a program that was built without them.
    #[error("{}: this build doesn't read Parquet, Arrow and LAS; the program that cargo installs does, and all read .npy and .csv", .path.display())]
    LeftOut {
        /// The file.
        path: PathBuf,
    },
    /// No parts at all.
    #[error("no parts to add")]
    NoParts,
    /// A degree that transforms can't be made to.
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
