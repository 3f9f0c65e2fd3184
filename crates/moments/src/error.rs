//! Defines the errors of reading tables of samples, and of reading, adding and writing moments.

use std::io;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use spharm_monitor::Interrupted;
use spharm_surface::SurfaceError;
use spharm_transform::TransformError;

/// Errors of this crate. Rows of tables are counted from 1, in the order of the data; a header line isn't counted.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MomentsError {
    /// The operating system reported an error.
    #[error("{}: cannot {action}: {source}", .path.display())]
    Io {
        /// Path of the file.
        path: PathBuf,
        /// The attempted action.
        action: &'static str,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The bytes of a table violate its format.
    #[error("{}: {format}: expected {expected}, found {found}", .path.display())]
    Malformed {
        /// Path of the file.
        path: PathBuf,
        /// Name of the format.
        format: &'static str,
        /// Content that the format requires.
        expected: String,
        /// Content found in the file.
        found: String,
    },
    /// The file name has no supported extension.
    #[error("{}: expected a file whose name ends in {}", .path.display(), .expected.join(", "))]
    UnknownFormat {
        /// Path of the file.
        path: PathBuf,
        /// Supported file-name extensions.
        expected: Vec<&'static str>,
    },
    /// A table lacks a required column.
    #[error("{}: no column {wanted}; the table has {}", .path.display(), named(.there))]
    NoColumn {
        /// Path of the file.
        path: PathBuf,
        /// Name of the missing column.
        wanted: String,
        /// Names of the table's columns.
        there: Vec<String>,
    },
    /// Two columns of a table have the name of a requested column.
    #[error(
        "{}: columns {} and {} both have the name {}; rename one of the two",
        .path.display(), .places[0], .places[1], cut(.column)
    )]
    ColumnTwice {
        /// Path of the file.
        path: PathBuf,
        /// Name of both columns.
        column: String,
        /// Positions of the two columns in the table, counted from 1.
        places: [usize; 2],
    },
    /// The requested columns don't determine the samples' positions or values.
    #[error("{}: {problem}; the table has {}", .path.display(), named(.there))]
    Columns {
        /// Path of the file.
        path: PathBuf,
        /// Description of the problem.
        problem: &'static str,
        /// Names of the table's columns.
        there: Vec<String>,
    },
    /// A row of a table is invalid.
    #[error("{}: row {row}: {column}: expected {expected}, found {found}", .path.display())]
    Row {
        /// Path of the file.
        path: PathBuf,
        /// The row, counted from 1.
        row: u64,
        /// Name of the column with the invalid value.
        column: String,
        /// Accepted values.
        expected: &'static str,
        /// The value found.
        found: String,
    },
    /// A sample in memory is invalid.
    #[error("sample {row}: {what}: expected {expected}, found {found}")]
    Sample {
        /// Index of the sample, counted from 0.
        row: usize,
        /// The invalid part of the sample: direction, value or weight.
        what: &'static str,
        /// Accepted values.
        expected: &'static str,
        /// The value found.
        found: String,
    },
    /// Arrays that belong together have sizes that don't match.
    #[error("{what}: expected {expected}, found {found}")]
    Arrays {
        /// Name of the array or size that doesn't match.
        what: &'static str,
        /// The required size.
        expected: usize,
        /// The size found.
        found: usize,
    },
    /// The sum of a channel's squared values, or of the weights, is outside the range of f64.
    #[error(
        "column {channel}: expected a sum of weighted squares from 1e-307 to 1e308; scale the values or the weights"
    )]
    Range {
        /// Name of the channel.
        channel: String,
    },
    /// A table has no rows.
    #[error("{}: expected samples, found none", .path.display())]
    Empty {
        /// Path of the file.
        path: PathBuf,
    },
    /// A table over a sampling scheme doesn't have exactly one row per vertex.
    #[error("{}: expected {expected} rows, one for each vertex of the sphere, found {found}; give the sphere that the values belong to", .path.display())]
    Rows {
        /// Path of the file.
        path: PathBuf,
        /// Number of vertices of the sampling scheme.
        expected: u64,
        /// Number of rows in the whole table.
        found: u64,
    },
    /// A per-vertex file couldn't be read.
    #[error(transparent)]
    Signal(SurfaceError),
    /// A file grew or shrank while it was read.
    #[error("{}: the file changed while it was being read ({was} to {now} bytes); wait until no program writes to the file", .path.display())]
    Changed {
        /// Path of the file.
        path: PathBuf,
        /// Size in bytes when the file was opened.
        was: u64,
        /// Size in bytes after the file was read.
        now: u64,
    },
    /// The index of a shard isn't below the number of shards, or there are too many shards.
    #[error("shard {index} of {of}: expected an index from 0 to {}, and at most {} shards", .of.saturating_sub(1), crate::moments::MOST_SHARDS)]
    Shard {
        /// Index of the shard, from 0.
        index: u32,
        /// The number of shards.
        of: u32,
    },
    /// A shard of standard input was requested. Standard input must be read from its start to its end, because the read
    /// position can't be moved.
    #[error(
        "standard input can't be divided into shards; write the data to a file, or give each process only its own part \
         of the data"
    )]
    ShardOfStream,
    /// The memory budget is too small.
    #[error("moments for fits of degree {max_degree} need {} MiB of memory, but the budget is {} MiB", .needed.div_ceil(1 << 20), .budget >> 20)]
    Memory {
        /// The degree of the fits, L.
        max_degree: usize,
        /// Needed memory in bytes.
        needed: usize,
        /// Memory budget in bytes.
        budget: usize,
    },
    /// The file isn't a file of moments, or is damaged.
    #[error("{}: damaged or not a file of moments: {what}: expected {expected}, found {found}; compute this part again", .path.display())]
    Corrupt {
        /// Path of the file.
        path: PathBuf,
        /// Name of the invalid field or failed check.
        what: &'static str,
        /// Content that the format requires.
        expected: String,
        /// Content found in the file.
        found: String,
    },
    /// The file has a format version that this program can't read.
    #[error("{}: the moments have format version {found}, but this program reads versions {} to {}; use the program version that wrote the file, or compute this part again", .path.display(), .expected.start(), .expected.end())]
    Version {
        /// Path of the file.
        path: PathBuf,
        /// The versions that can be read.
        expected: RangeInclusive<u32>,
        /// The version found.
        found: u32,
    },
    /// Two parts differ in degree or channels, so their moments can't be added.
    #[error(
        "{second} and {first}: {what} differ: {found} and {expected}; only parts of the same degree and channels can \
         be added"
    )]
    Differ {
        /// The property that differs.
        what: &'static str,
        /// Name of the first part.
        first: String,
        /// Name of the part that differs from the first part.
        second: String,
        /// Value of the property in the first part.
        expected: String,
        /// Value of the property in the second part.
        found: String,
    },
    /// Two parts contain the same samples.
    #[error("{first} and {second}: both contain {what}; omit one of the two")]
    Overlap {
        /// Name of one part.
        first: String,
        /// Name of the other part.
        second: String,
        /// The samples that both parts contain.
        what: String,
    },
    /// Shards are missing, so the parts don't contain all samples.
    #[error("{} missing: {}", ranges(.missing.len()), .missing.join(", "))]
    Missing {
        /// The missing shards.
        missing: Vec<String>,
    },
    /// The numbers of the shards fit together, but the shards belong to different tables or to different versions of a
    /// table.
    #[error(
        "{first} and {second}: the numbers of these shards fit together, but the shards were computed from different \
         tables or columns, or the file changed in between; compute all shards again from one file"
    )]
    Versions {
        /// Name of the part whose shard precedes that of `second`.
        first: String,
        /// Name of the part with the next shard, which belongs to another table or version than the shard of `first`.
        second: String,
    },
    /// A table has Parquet, Arrow or LAS format, and the program was built without support for these formats.
    #[error("{}: this build of the program can't read Parquet, Arrow or LAS files; use the program installed by cargo, or convert the table to .npy or .csv", .path.display())]
    LeftOut {
        /// Path of the file.
        path: PathBuf,
    },
    /// The list of parts is empty.
    #[error("there are no parts to add")]
    NoParts,
    /// The transforms don't support the requested degree.
    #[error(transparent)]
    Transform(#[from] TransformError),
    /// A file of moments couldn't be written.
    #[error(transparent)]
    Output(#[from] SurfaceError),
    /// The computation was cancelled.
    #[error("{0}")]
    Interrupted(#[from] Interrupted),
}

fn ranges(count: usize) -> String {
    if count == 1 { "1 range of shards is".to_owned() } else { format!("{count} ranges of shards are") }
}

fn named(columns: &[String]) -> String {
    match columns.len() {
        0 => "no columns".to_owned(),
        1 => format!("the column {}", cut(&columns[0])),
        count => {
            let shown: Vec<_> = columns.iter().take(MOST_NAMED).map(|name| cut(name)).collect();
            let more = if count > MOST_NAMED { format!(" and {} more", count - MOST_NAMED) } else { String::new() };
            format!("the columns {}{more}", shown.join(", "))
        }
    }
}

/// Largest number of columns that a message lists.
const MOST_NAMED: usize = 50;
/// Largest number of characters of a name or a cell that a message shows.
const LONGEST_SHOWN: usize = 80;

/// Returns text from a file, cut to the length that a message shows.
pub(crate) fn cut(text: &str) -> String {
    match text.char_indices().nth(LONGEST_SHOWN) {
        Some((end, _)) => format!("{}...", &text[..end]),
        None => text.to_owned(),
    }
}

impl MomentsError {
    pub(crate) fn io(path: &std::path::Path, action: &'static str) -> impl FnOnce(io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, action, source }
    }
}
