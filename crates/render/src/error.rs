//! The error type of this crate.

use spharm_surface::SurfaceError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// No panels to draw.
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
    /// The number of values to colour a mesh by differs from its number of vertices.
    #[error("values to colour a mesh by: expected {expected}, found {found}: both must come from the same surface")]
    ValueCount {
        /// The mesh's number of vertices.
        expected: usize,
        /// The number of values.
        found: usize,
    },
    /// A colour bar whose ends aren't finite.
    #[error("the range of a colour bar must be two finite numbers, found {low} and {high}")]
    Range {
        /// The value at the bar's lower end.
        low: f64,
        /// The value at the bar's upper end.
        high: f64,
    },
    /// The file can't be written.
    #[error(transparent)]
    Write(#[from] SurfaceError),
}
