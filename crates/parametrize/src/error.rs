//! The one error type of this crate.

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
