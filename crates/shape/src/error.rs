//! The error type of this crate.

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
        /// Name of the array.
        what: &'static str,
        /// Row of the value, from 0.
        row: usize,
        /// Column of the value, from 0.
        column: usize,
    },
    /// The number of subjects is too small or differs from the expected number.
    #[error(
        "{what}: expected {expected} {}; found {found}",
        if *.what == "the design" || *.what == "a group" { "subjects or more" } else { "rows, one per subject" }
    )]
    Subjects {
        /// Name of the array or table.
        what: &'static str,
        /// Expected number of subjects.
        expected: usize,
        /// Number of subjects found.
        found: usize,
    },
    /// A group without subjects.
    #[error("group {group} has no subjects")]
    EmptyGroup {
        /// Number of the group, from 1.
        group: usize,
    },
    /// A variance group whose variance can't be estimated, because the design fits all of the group's rows exactly.
    #[error(
        "the variance within variance group {group} (in order of occurrence; rows: {subjects}) can't be estimated, \
         because the design fits all of its rows exactly; merge this group with another group, or leave out columns of \
         the design"
    )]
    VarianceGroup {
        /// Number of the group, from 1.
        group: usize,
        /// Number of subjects in the group.
        subjects: usize,
    },
    /// Sign flips of single rows were requested, although the rows of a block depend on each other.
    #[error(
        "the rows of a block depend on each other, so {} of single rows aren't valid: exchange whole blocks \
         (--whole-blocks, whole_blocks), or assume exchangeable errors (--errors exchangeable)",
        .resampling.name()
    )]
    FlippedRows {
        /// The kind of relabelling.
        resampling: crate::stats::Resampling,
    },
    /// The requested relabellings leave the statistics unchanged.
    #[error(
        "{}{} leave the statistics of this contrast unchanged; {}",
        .resampling.name(),
        if *.blocks { " in these blocks" } else { "" },
        if *.blocks {
            "the tested columns must vary within blocks or, if whole blocks are exchanged, from block to block"
        } else {
            "choose another assumption about the errors"
        }
    )]
    NoRelabelling {
        /// The kind of relabelling.
        resampling: crate::stats::Resampling,
        /// Whether exchangeability blocks were given.
        blocks: bool,
    },
    /// A column of a design that is a linear combination of other columns, so that its effect can't be separated from
    /// their effects.
    #[error(
        "the design's column {column:?} is a linear combination of the columns before it; omit one of these columns"
    )]
    Rank {
        /// The column's name.
        column: String,
    },
    /// A column of a study has fewer than two levels, or the requested order doesn't list all of its levels.
    #[error(
        "column {column:?}: expected {}",
        match found.len() {
            2.. if !order.is_empty() =>
                format!("an order of all levels ({}), found {}", found.join(", "), order.join(", ")),
            _ => format!("two levels or more, found {}", found.join(", ")),
        }
    )]
    Levels {
        /// The column's name.
        column: String,
        /// Levels found in the column.
        found: Vec<String>,
        /// The requested order of the levels.
        order: Vec<String>,
    },
    /// The requested order of a column's levels lists a level twice.
    #[error("levels: expected each level of {column:?} once, found the duplicate level {level:?}")]
    DuplicateLevel {
        /// The column's name.
        column: String,
        /// The duplicate level.
        level: String,
    },
    /// A contrast that doesn't match its design.
    #[error("contrast: expected {expected}, found {found}")]
    Contrast {
        /// Expected form of the contrast.
        expected: &'static str,
        /// The contrast found.
        found: String,
    },
    /// A name in a contrast that isn't a column of its design.
    #[error("contrast: expected columns of the design, which are {}; found {found:?}", columns.join(", "))]
    NoColumn {
        /// The unknown name.
        found: String,
        /// Names of the design's columns.
        columns: Vec<String>,
    },
    /// A name in a contrast that can also be read as a combination of other columns.
    #[error(
        "contrast: {name:?} is the name of a column and also a combination of other columns; put this name, or the \
         names of the other columns, in double quotes; found {found:?}"
    )]
    AmbiguousName {
        /// The name.
        name: String,
        /// The contrast found.
        found: String,
    },
    /// A contrast that tests a mean, although the values are differences from the mean of all subjects.
    #[error(
        "contrast {tested:?} tests a mean, but the values are differences from the mean of all subjects; test a \
         difference, whose weights add up to zero, or give two \
         models of each subject and test the differences between them"
    )]
    MeanOfDisplacements {
        /// Name of the contrast.
        tested: String,
    },
    /// An interaction of two levels that never occur together.
    #[error(
        "the interaction {interaction} can't be estimated: no subject is both {:?} and {:?}; leave out a level, or the \
         interaction", levels[0], levels[1]
    )]
    EmptyCell {
        /// The interaction, with the names of its columns.
        interaction: String,
        /// The two levels that don't occur together, one from each column.
        levels: [String; 2],
    },
    /// Welch's test was requested for something other than the difference between two groups.
    #[error("Welch's test needs exactly two groups and no covariates")]
    NotTwoGroups,
    /// The number of columns isn't a multiple of the number of components per vertex.
    #[error("{columns} columns: expected a multiple of {components}, the number of components per vertex")]
    Components {
        /// Number of columns.
        columns: usize,
        /// Number of components per vertex.
        components: usize,
    },
    /// A fraction outside the range from 0 to 1.
    #[error("{what}: expected a number between 0 and 1, found {found}")]
    Share {
        /// Name of the setting, which is a fraction.
        what: &'static str,
        /// Value of the setting.
        found: f64,
    },
    /// The models have different degrees, but must have equal degrees.
    #[error("model {}: expected {expected} coefficients per coordinate, as in the first model, found {found}", .index + 1)]
    Degrees {
        /// Index of the model whose degree differs, from 0.
        index: usize,
        /// Expected number of coefficients, K.
        expected: usize,
        /// Number of coefficients found.
        found: usize,
    },
    /// The requested mode doesn't exist.
    #[error("mode {found} doesn't exist; the group has {modes} modes")]
    Mode {
        /// Number of the mode, from 1.
        found: usize,
        /// Number of modes.
        modes: usize,
    },
    /// The singular value decomposition didn't converge.
    #[error("the singular value decomposition of the group did not converge")]
    NoDecomposition,
    /// The monitor cancelled the computation.
    #[error("{0}")]
    Interrupted(#[from] Interrupted),
    /// Input that isn't a rotation.
    #[error("not a rotation: {problem}")]
    NotARotation {
        /// Reason for the rejection.
        problem: String,
    },
    /// A coefficient that is NaN or infinite.
    #[error("coefficient {row} of channel {channel} is {value}; it must be finite")]
    NotFinite {
        /// Row of the coefficient, `l^2 + l + m`.
        row: usize,
        /// Channel, from 0.
        channel: usize,
        /// Value of the coefficient.
        value: f64,
    },
    /// The model is degenerate: it is a point or lies on a line.
    #[error(
        "the model is {found}, not a surface: its coefficients of degrees 1 and above have rank {rank}, but a surface \
         needs rank 2 or 3"
    )]
    NoExtent {
        /// `a point` or `a line`.
        found: &'static str,
        /// Rank of the coefficients without degree 0.
        rank: usize,
    },
    /// The surface has no area at the directions whose weight is above 0.
    #[error("the surface has no area at the directions with a weight above 0")]
    NoArea,
    /// The coefficients describe a signal, but a surface is needed.
    #[error("expected a surface, whose coefficients have 3 columns, found a signal of {channels} channels")]
    NotASurface {
        /// Number of channels found.
        channels: usize,
    },
    /// A quantity, such as the number of channels, differs from its expected value.
    #[error("{what}: expected {expected}, found {found}")]
    Differ {
        /// Name of the quantity that differs.
        what: &'static str,
        /// Expected value.
        expected: usize,
        /// Value found.
        found: usize,
    },
    /// The requested degree is above the degree of at least one model.
    #[error("the models have degrees from {lowest} to {highest}: expected a degree of at most {lowest}, found {asked}")]
    DegreeAbove {
        /// Lowest degree of the models.
        lowest: usize,
        /// Highest degree of the models.
        highest: usize,
        /// The requested degree.
        asked: usize,
    },
    /// The coefficients are so large or small that their products overflow or underflow.
    #[error(
        "the coefficients have magnitudes up to {largest:.1e}: areas, volumes and variances computed from these \
         coefficients overflow or underflow; scale the surface to another unit"
    )]
    Range {
        /// Largest absolute value, or the norm, of the coefficients without row 0.
        largest: f64,
    },
    /// A column of a study that has the same value in all rows: its effect can't be estimated.
    #[error(
        "column {column:?}: the value is {value} in all rows, so the effect of the column can't be estimated; omit the \
         column"
    )]
    Constant {
        /// The column's name.
        column: String,
        /// The value in all rows.
        value: f64,
    },
    /// A setting is out of range.
    #[error("{name} is {found}; {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// Value of the setting.
        found: String,
        /// Expected range.
        expected: &'static str,
    },
    /// Invalid directions or coefficients.
    #[error("{0}")]
    Harmonics(#[from] HarmonicsError),
    /// An error from the spherical-harmonic transform.
    #[error("{0}")]
    Transform(#[from] TransformError),
    /// The group is too small.
    #[error("the group has {found} members, but at least {least} are needed")]
    TooFewMembers {
        /// Number of members found.
        found: usize,
        /// Minimum number of members.
        least: usize,
    },
    /// The journal of a group's alignment can't be read or written.
    #[error("{}: cannot read or write the state of the alignment: {cause}", path.display())]
    Journal {
        /// Path of the file.
        path: PathBuf,
        /// Underlying I/O error.
        cause: std::io::Error,
    },
    /// The file isn't the journal of this group's alignment.
    #[error(
        "{}: expected the state of an alignment of these models with these settings, found {}; choose another file",
        path.display(),
        if *is_one { "the state of another alignment" } else { "a file of another kind" }
    )]
    OtherJournal {
        /// Path of the file.
        path: PathBuf,
        /// Whether the file is the journal of another alignment.
        is_one: bool,
    },
    /// The journal is in use by another process.
    #[error("{}: another process is aligning this group; wait until that process ends, or choose another file", path.display())]
    JournalInUse {
        /// Path of the file.
        path: PathBuf,
    },
    /// An error in one member of a group.
    #[error("member {index}: {source}")]
    Member {
        /// Index of the member, from 0.
        index: usize,
        /// The member's error.
        source: Box<ShapeError>,
    },
}
