//! The one error type of this crate.

use std::io;
use std::path::PathBuf;

/// What can go wrong on the way to the sphere.
///
/// Each message is one line: what was expected, what was found, what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ParametrizeError {
    /// The mesh is no closed surface of genus zero, or no clean one.
    #[error("not a closed, clean surface of genus zero: {problems}; {remedy}")]
    BadSurface {
        /// The problems with their counts, a phrase each, joined by semicolons.
        problems: String,
        /// What to do about them.
        remedy: &'static str,
    },

    /// The map came out with folds that could not be mended.
    #[error(
        "the {method} map is not one to one: {flipped} of {triangles} triangles are flipped and {degenerate} have no \
         area; {remedy}"
    )]
    NotBijective {
        /// The method.
        method: &'static str,
        /// Triangles turned over.
        flipped: usize,
        /// Triangles without area.
        degenerate: usize,
        /// All triangles.
        triangles: usize,
        /// What to do.
        remedy: &'static str,
    },

    /// A vertex found no place on the sphere: the cells around it are smaller than f64 can tell apart.
    #[error(
        "vertex {vertex} (counted from 0) finds no place on the sphere: the triangles around it shrink below what \
         64-bit numbers tell apart; mend the thin triangles there, or remesh the surface"
    )]
    NoPlace {
        /// The vertex.
        vertex: usize,
    },

    /// The operating system refused.
    #[error("{}: cannot read: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        cause: io::Error,
    },

    /// A file that isn't a label volume.
    #[error("{}: expected {expected}, found {found}", path.display())]
    NotAVolume {
        /// The file.
        path: PathBuf,
        /// What it should be or have.
        expected: &'static str,
        /// What it is or has.
        found: String,
    },

    /// The volume doesn't have the label, or several, of which none was chosen.
    #[error(
        "{}: {}; the labels there are: {there}; give one of them with --label",
        path.display(),
        label.map_or_else(|| "expected one label".to_owned(), |label| format!("no voxel has label {label}"))
    )]
    NoLabel {
        /// The file.
        path: PathBuf,
        /// The label asked for.
        label: Option<i64>,
        /// The labels there are, with their voxels.
        there: String,
    },

    /// A label whose surface isn't closed and of genus zero.
    #[error("the label is not one ball of voxels: {problems}; {remedy}")]
    BadVolume {
        /// The problems with their counts, a phrase each, joined by semicolons.
        problems: String,
        /// What to do.
        remedy: &'static str,
    },

    /// What the surface's crate says.
    #[error(transparent)]
    Surface(#[from] spharm_surface::SurfaceError),

    /// What the solver's crate says of the fit that shows where a model errs.
    #[error(transparent)]
    Solver(#[from] spharm_solver::SolverError),

    /// An argument that makes no sense.
    #[error("{what}: expected {expected}, found {found}")]
    Argument {
        /// Which argument.
        what: &'static str,
        /// What it may be.
        expected: &'static str,
        /// What it was.
        found: String,
    },
}
