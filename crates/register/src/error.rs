//! What can go wrong with a registration.

use spharm_monitor::Interrupted;

/// A registration that couldn't be done.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RegisterError {
    /// A mesh without area, or with coordinates that aren't finite.
    #[error("{what} has no area to register: expected triangles with finite coordinates and an area above 0")]
    NoArea {
        /// Which mesh, in words.
        what: &'static str,
    },
    /// A triangle of the template that names a vertex that isn't there, or one twice.
    #[error("triangle {face} of the template is {found:?}: expected three different vertices below {vertices}")]
    Triangle {
        /// The triangle, counted from 0.
        face: usize,
        /// Its corners.
        found: [u32; 3],
        /// The number of the template's vertices.
        vertices: usize,
    },
    /// A number per vertex, of another number of vertices.
    #[error("expected {expected} values, one a vertex of the template, found {found}")]
    Values {
        /// The number of vertices.
        expected: usize,
        /// The number of values.
        found: usize,
    },
    /// A landmark that isn't finite, or is at a vertex of the template that isn't there.
    #[error(
        "landmark {index} of a registration: expected finite coordinates and a place of a template of {vertices} vertices"
    )]
    Guide {
        /// The landmark, counted from 0.
        index: usize,
        /// The number of the template's vertices.
        vertices: usize,
    },
    /// Nothing of the template is to be registered.
    #[error("every triangle of the template is masked: expected some that have a counterpart on subjects")]
    AllMasked,
    /// Equations without a solution in the range of numbers.
    #[error("the registration's equations have no finite solution: coordinates may be too large or too small")]
    Singular,
    /// Cancelled.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}
