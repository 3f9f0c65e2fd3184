//! The error type of this crate.

use spharm_surface::SurfaceError;

/// Errors of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A picture has no panels.
    #[error("a picture needs at least one panel, found none")]
    NoPanels,
    /// A picture is too small or too large.
    #[error("the picture is {width} x {height} pixels, expected 16 to 16384 on each side")]
    Size {
        /// Width, in pixels.
        width: usize,
        /// Height, in pixels.
        height: usize,
    },
    /// The number of values or colours of a mesh differs from its number of vertices.
    #[error(
        "expected one value or colour per vertex ({expected}), found {found}; the values or colours must belong to the \
         vertices of this mesh"
    )]
    ValueCount {
        /// Number of vertices of the mesh.
        expected: usize,
        /// Number of values or colours.
        found: usize,
    },
    /// An end of a colour bar isn't finite.
    #[error("the range of a colour bar must be two finite numbers, found {low} and {high}")]
    Range {
        /// Value at the lower end of the colour bar.
        low: f64,
        /// Value at the upper end of the colour bar.
        high: f64,
    },
    /// The file of the picture can't be written.
    #[error(transparent)]
    Write(#[from] SurfaceError),
}
