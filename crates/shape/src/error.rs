//! What can go wrong with shapes.

use spharm_monitor::Interrupted;

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
    /// A column of a design that depends on others, so that its effect can't be told from theirs.
    #[error("the design's column {column:?} is a combination of the columns before it: leave one of them out")]
    Rank {
        /// The column's name.
        column: String,
    },
    /// A contrast that doesn't fit its design.
    #[error("contrast: expected {expected}, found {found}")]
    Contrast {
        /// What it has to be.
        expected: &'static str,
        /// What it is.
        found: String,
    },
    /// Welch's test of something else than the difference of two groups of scalars.
    #[error(
        "Welch's t is of the difference of two groups without covariates, one component at a vertex: use the pooled one"
    )]
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
    /// A group of too few models.
    #[error("group: expected {expected} models or more, found {found}")]
    Group {
        /// Number of models it has to have.
        expected: usize,
        /// Number of models it has.
        found: usize,
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
    /// A number of relabellings of zero.
    #[error("relabellings: expected at least 1, found 0")]
    NoRelabellings,
    /// Stopped by the monitor.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}
