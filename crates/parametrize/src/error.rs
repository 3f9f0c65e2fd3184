//! The one error type of this crate.

use std::io;
use std::path::PathBuf;

use spharm_surface::SurfaceError;

/// Errors of parameterisation.
///
/// Each message is one line: what was expected, what was found, what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ParametrizeError {
    /// The mesh isn't a closed surface of genus zero, or has defects.
    #[error("not a closed, clean surface of genus zero: {problems}; {remedy}")]
    BadSurface {
        /// The problems with their counts, one phrase each, joined by semicolons.
        problems: String,
        /// Handles of a closed surface, its genus; 0 if it isn't closed.
        handles: usize,
        /// Advice.
        remedy: &'static str,
    },

    /// The map has folds.
    #[error(
        "the {method} map is not one to one: {flipped} of {triangles} triangles are flipped and {degenerate} have no \
         area; {remedy}"
    )]
    NotBijective {
        /// The method.
        method: &'static str,
        /// Number of flipped triangles.
        flipped: usize,
        /// Number of triangles without area.
        degenerate: usize,
        /// Number of all triangles.
        triangles: usize,
        /// Advice.
        remedy: &'static str,
    },

    /// A vertex can't be inserted: the cells around it on the sphere are smaller than f64 resolves.
    #[error(
        "vertex {vertex} (counted from 0) can't be placed on the sphere: the triangles around it are smaller than \
         64-bit numbers resolve; repair the thin triangles there, or remesh the surface"
    )]
    NoPlace {
        /// The vertex.
        vertex: usize,
    },

    /// Values that can't be filled in from any others.
    #[error("{vertices} vertices have no value, and some of them aren't connected to a vertex with one")]
    Unfilled {
        /// Number of vertices without a value.
        vertices: usize,
    },

    /// The operating system reported an error.
    #[error("{}: cannot read: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's error.
        cause: io::Error,
    },

    /// A file that isn't a label volume.
    #[error("{}: expected {expected}, found {found}", path.display())]
    NotAVolume {
        /// The file.
        path: PathBuf,
        /// What the file should be or contain.
        expected: &'static str,
        /// What the file is or contains.
        found: String,
    },

    /// A volume whose file doesn't specify the size of its voxels.
    #[error("{}: {format} doesn't say how large its voxels are", path.display())]
    NoVoxelSize {
        /// The file.
        path: PathBuf,
        /// Its format, with an article.
        format: &'static str,
    },

    /// A file in a volume format that holds a map: values on the vertices of a surface.
    #[error("{}: expected a volume of labels, found values on {vertices} vertices", path.display())]
    VertexMap {
        /// The file.
        path: PathBuf,
        /// Number of vertices: the one size that isn't 1.
        vertices: usize,
    },

    /// The volume doesn't have the label, or has several and none was chosen.
    #[error(
        "{}: {}; the volume's labels: {there}; choose one of them",
        path.display(),
        label.map_or_else(|| "expected one label".to_owned(), |label| format!("no voxel has label {label}"))
    )]
    NoLabel {
        /// The file.
        path: PathBuf,
        /// The label that was chosen.
        label: Option<i64>,
        /// The labels of the volume, with their numbers of voxels.
        there: String,
    },

    /// A label whose surface isn't closed and of genus zero.
    #[error(
        "{}: label {label} is not a single ball of voxels: {problems}; {}",
        path.display(),
        if *repairable { "repair it, or edit the label" } else { "edit the label" }
    )]
    BadVolume {
        /// The file.
        path: PathBuf,
        /// The label.
        label: i64,
        /// The problems with their counts, one phrase each, joined by semicolons.
        problems: String,
        /// Number of handles among the problems, which can be cut if there are no other problems.
        handles: usize,
        /// Whether a repair can make it one ball.
        repairable: bool,
    },

    /// An error of `spharm-surface`.
    #[error(transparent)]
    Surface(SurfaceError),

    /// An error of the fit whose residual the areas adapt to.
    #[error(transparent)]
    Solver(#[from] spharm_solver::SolverError),

    /// Rounded to 32-bit numbers, the sphere would have folds.
    #[error("32-bit numbers would flip {flipped} of the sphere's triangles; write a format of 64-bit numbers")]
    SinglePrecision {
        /// Triangles that would be flipped or degenerate.
        flipped: usize,
    },

    /// The monitor asked to stop.
    #[error("interrupted")]
    Interrupted(#[from] spharm_monitor::Interrupted),

    /// An argument out of its range.
    #[error("{what}: expected {expected}, found {found}")]
    Argument {
        /// The argument.
        what: &'static str,
        /// Accepted values.
        expected: &'static str,
        /// The value given.
        found: String,
    },
}

impl From<SurfaceError> for ParametrizeError {
    fn from(error: SurfaceError) -> Self {
        match error {
            SurfaceError::Interrupted(interrupted) => Self::Interrupted(interrupted),
            error => Self::Surface(error),
        }
    }
}
