//! Defines the errors of registrations.

use spharm_monitor::Interrupted;

/// Errors of preparing or computing a registration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RegisterError {
    /// A mesh has no area, or coordinates that aren't finite.
    #[error("{what} has no area to register: expected triangles with finite coordinates and an area above 0")]
    NoArea {
        /// Name of the mesh in the message: "the template" or "the subject".
        what: &'static str,
    },
    /// A triangle of the template has a vertex that doesn't exist, or the same vertex twice.
    #[error(
        "triangle {face} of the template has the vertices {found:?}: expected three different indices below {vertices}"
    )]
    Triangle {
        /// Index of the triangle, from 0.
        face: usize,
        /// Corners of the triangle.
        found: [u32; 3],
        /// Number of the template's vertices.
        vertices: usize,
    },
    /// A list of values per vertex has the wrong length.
    #[error("expected {expected} values, one per vertex of the template, found {found}")]
    Values {
        /// Number of vertices of the template.
        expected: usize,
        /// Number of values in the list.
        found: usize,
    },
    /// A landmark has coordinates that aren't finite, or a vertex that the template doesn't have.
    #[error(
        "landmark {index}: expected finite coordinates and a position on the template, which has {vertices} vertices"
    )]
    Guide {
        /// Index of the landmark, from 0.
        index: usize,
        /// Number of the template's vertices.
        vertices: usize,
    },
    /// Every triangle of the template has a masked vertex.
    #[error("every triangle of the template is masked: unmask the triangles that have a counterpart on the subjects")]
    AllMasked,
    /// The equations of the registration have no finite solution.
    #[error("the registration's equations have no finite solution: coordinates may be too large or too small")]
    Singular,
    /// The monitor cancelled the registration.
    #[error(transparent)]
    Interrupted(#[from] Interrupted),
}
