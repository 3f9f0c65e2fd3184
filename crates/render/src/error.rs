//! What can go wrong with a picture.

use spharm_surface::SurfaceError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A picture of nothing.
    #[error("a picture needs at least one panel, found none")]
    NoPanels,
    /// A picture that is too small or too large.
    #[error("the picture is {width} x {height} pixels, expected 16 to 16384 on a side")]
    Size {
        /// Width, in pixels.
        width: usize,
        /// Height, in pixels.
        height: usize,
    },
    /// Values to colour a mesh by, which aren't one for each vertex.
    #[error("values to colour a mesh by: expected {expected}, found {found}: both must come from the same surface")]
    ValueCount {
        /// The mesh's number of vertices.
        expected: usize,
        /// The number of values.
        found: usize,
    },
    /// A colour bar without finite ends.
    #[error("the range of a colour bar must be two finite numbers, found {low} and {high}")]
    Range {
        /// The value at its lower end.
        low: f64,
        /// The value at its upper end.
        high: f64,
    },
    /// The file can't be written.
    #[error(transparent)]
    Write(#[from] SurfaceError),
}
