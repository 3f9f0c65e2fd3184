//! What can go wrong with shapes.

use std::path::PathBuf;

use spharm_harmonics::HarmonicsError;
use spharm_monitor::Interrupted;
use spharm_transform::TransformError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ShapeError {
    /// A value that is NaN or infinite.
    #[error("{what}: expected finite values, found NaN or infinity in row {}, column {}", .row + 1, .column + 1)]
    NotFiniteValue {
        /// What has it.
        what: &'static str,
        /// Its row, from 0.
        row: usize,
        /// Its column, from 0.
        column: usize,
    },
    /// Too few subjects, or other ones.
    #[error("{what}: expected {expected} subjects{}, found {found}", if *.what == "covariates" || *.expected == 0 { "" } else { " or more, one row each" })]
    Subjects {
        /// What has them.
        what: &'static str,
        /// Number of subjects it has to have.
        expected: usize,
        /// Number of subjects it has.
        found: usize,
    },
    /// A group without subjects.
    #[error("group {group} has no subjects")]
    EmptyGroup {
        /// Its number, from 1.
        group: usize,
    },
    /// A column of a design that depends on others, so that its effect can't be separated from theirs.
    #[error("the design's column {column:?} is a combination of the columns before it: leave one of them out")]
    Rank {
        /// The column's name.
        column: String,
    },
    /// A column of a study whose levels can't be compared.
    #[error(
        "column {column:?}: expected {}",
        match found.len() {
            2.. if !order.is_empty() => format!("an order of all its levels, {}, found {}", found.join(", "), order.join(", ")),
            _ => format!("two levels or more, found {}", found.join(", ")),
        }
    )]
    Levels {
        /// The column's name.
        column: String,
        /// Its levels.
        found: Vec<String>,
        /// The order asked for.
        order: Vec<String>,
    },
    /// A contrast that doesn't fit its design.
    #[error("contrast: expected {expected}, found {found}")]
    Contrast {
        /// What it has to be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// Welch's test of something else than the difference of two groups.
    #[error("Welch's test is of the difference of two groups without covariates: use pooled variances")]
    NotTwoGroups,
    /// Columns that aren't whole vertices.
    #[error("{columns} columns are no whole number of vertices of {components} components")]
    Components {
        /// Number of columns.
        columns: usize,
        /// Components at a vertex.
        components: usize,
    },
    /// A share that isn't between 0 and 1.
    #[error("{what}: expected a number between 0 and 1, found {found}")]
    Share {
        /// What it is.
        what: &'static str,
        /// Its value.
        found: f64,
    },
    /// Models of different degrees where they have to be the same.
    #[error("model {}: expected {expected} coefficients a coordinate, as the first one has, found {found}", .index + 1)]
    Degrees {
        /// Index of the model.
        index: usize,
        /// Number of coefficients of the others, K.
        expected: usize,
        /// Its number.
        found: usize,
    },
    /// A mode that isn't there.
    #[error("mode {found}: there are {modes} modes")]
    Mode {
        /// Its number, from 1.
        found: usize,
        /// Number of modes.
        modes: usize,
    },
    /// A singular value decomposition that doesn't converge.
    #[error("the singular value decomposition of the group did not converge")]
    NoDecomposition,
    /// Stopped by the monitor.
    #[error("{0}")]
    Interrupted(#[from] Interrupted),
    /// Something else was given for a rotation.
    #[error("not a rotation: {problem}")]
    NotARotation {
        /// What is wrong.
        problem: String,
    },
    /// A coefficient that is NaN or infinite.
    #[error("coefficient {row} of channel {channel} is {value}; it must be finite")]
    NotFinite {
        /// Row of the coefficients, `l^2 + l + m`.
        row: usize,
        /// Channel, counted from 0.
        channel: usize,
        /// The value.
        value: f64,
    },
    /// A model that is no surface: a point, or a curve on a line.
    #[error(
        "the model is {found}, not a surface: the degrees from 1 on have a coordinate rank of {rank}, at least 2 is needed"
    )]
    NoExtent {
        /// `a point` or `a line`.
        found: &'static str,
        /// Rank of the coefficients without degree 0.
        rank: usize,
    },
    /// Coefficients of a signal where a surface is needed.
    #[error("expected a surface, whose coefficients have 3 columns, found a signal of {channels} channels")]
    NotASurface {
        /// Channels found.
        channels: usize,
    },
    /// Models that don't have the same shape.
    #[error("{what}: expected {expected}, found {found}")]
    Differ {
        /// What differs.
        what: &'static str,
        /// What the others have.
        expected: usize,
        /// What this one has.
        found: usize,
    },
    /// A degree that some models don't go to.
    #[error(
        "the models go to degrees from {lowest} to {highest}: expected a degree of at most {lowest}, found {asked}"
    )]
    DegreeAbove {
        /// Lowest degree of the models.
        lowest: usize,
        /// Highest one.
        highest: usize,
        /// The degree asked for.
        asked: usize,
    },
    /// Coefficients whose products leave the range of numbers.
    #[error(
        "coefficients of up to {largest:.1e}: areas, volumes and variances of them leave the range of numbers; scale the \
         surface to another unit"
    )]
    Range {
        /// The largest absolute value, without row 0 where that is only a place.
        largest: f64,
    },
    /// A column of a study that has the same value in all rows: its effect can't be estimated.
    #[error("column {column:?}: the value is {value} in all rows, so that it tells nothing: leave the column out")]
    Constant {
        /// The column's name.
        column: String,
        /// The value.
        value: f64,
    },
    /// A setting out of its range.
    #[error("{name} is {found}; {expected}")]
    Setting {
        /// What it is called.
        name: &'static str,
        /// Its value.
        found: String,
        /// What it has to be.
        expected: &'static str,
    },
    /// Directions or coefficients that are refused.
    #[error("{0}")]
    Harmonics(#[from] HarmonicsError),
    /// A transform that can't be made.
    #[error("{0}")]
    Transform(#[from] TransformError),
    /// A group that is too small for what was asked.
    #[error("the group has {found} members, at least {least} are needed")]
    TooFewMembers {
        /// Members found.
        found: usize,
        /// Members needed.
        least: usize,
    },
    /// The file of a group's alignment can't be read or written.
    #[error("{}: cannot keep the state of the alignment: {cause}", path.display())]
    Journal {
        /// The file.
        path: PathBuf,
        /// Why.
        cause: std::io::Error,
    },
    /// A file that isn't that of a group's alignment.
    #[error(
        "{}: expected the state of an alignment of these models with these settings, found {}",
        path.display(),
        if *is_one { "that of another one: name another file, or remove this one" } else { "something else: name another file" }
    )]
    OtherJournal {
        /// The file.
        path: PathBuf,
        /// Whether it is that of another alignment.
        is_one: bool,
    },
    /// The file of a group's alignment is that of a run which hasn't ended.
    #[error("{}: another process aligns this group: wait for it, or name another file", path.display())]
    JournalInUse {
        /// The file.
        path: PathBuf,
    },
    /// An error in one member of a group.
    #[error("member {index}: {source}")]
    Member {
        /// Its place in the group, counted from 0.
        index: usize,
        /// What is wrong.
        source: Box<ShapeError>,
    },
}
