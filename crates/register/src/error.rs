//! Errors of a registration.

use spharm_monitor::Interrupted;

/// Errors of preparing or computing a registration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RegisterError {
    /// A mesh without area, or with coordinates that aren't finite.
    #[error("{what} has no area to register: expected triangles with finite coordinates and an area above 0")]
    NoArea {
        /// Description of the mesh.
        what: &'static str,
    },
    /// A triangle of the template whose index is out of range, or that uses a vertex twice.
    #[error("triangle {face} of the template is {found:?}: expected three different vertices below {vertices}")]
    Triangle {
        /// Index of the triangle, from 0.
        face: usize,
        /// Corners of the triangle.
        found: [u32; 3],
        /// Number of the template's vertices.
        vertices: usize,
    },
    /// A list of numbers per vertex whose length isn't the number of vertices.
    #[error("expected {expected} values, one per vertex of the template, found {found}")]
    Values {
        /// Number of vertices of the template.
        expected: usize,
        /// Number of values in the list.
        found: usize,
    },
    /// A landmark with coordinates that aren't finite, or on a vertex that the template doesn't have.
    #[error(
        "landmark {index} of a registration: expected finite coordinates and a place on the template, which has {vertices} vertices"
    )]
    Guide {
        /// Index of the landmark, from 0.
        index: usize,
        /// Number of the template's vertices.
        vertices: usize,
    },
    /// All of the template is masked.
    #[error("every triangle of the template is masked: unmask the triangles with a counterpart on the subjects")]
    AllMasked,
    /// Equations without a finite solution.
    #[error("the registration's equations have no finite solution: coordinates may be too large or too small")]
    Singular,
    /// The monitor asked to stop.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}
