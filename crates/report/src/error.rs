//! What can go wrong with a page.

use spharm_model::ModelError;
use spharm_render::RenderError;
use spharm_shape::ShapeError;
use spharm_surface::SurfaceError;

/// Errors of this crate; `name` is the item's name in the page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// A page of nothing.
    #[error("a page needs a model, modes, a test, a quality or a table; found none")]
    Empty,
    /// Values that aren't one for each vertex.
    #[error("{name}: map {map} has {found} values, expected one for each of {expected} vertices")]
    ValueCount {
        /// The test.
        name: String,
        /// The map.
        map: String,
        /// Vertices.
        expected: usize,
        /// Values.
        found: usize,
    },
    /// A table whose rows are of different lengths.
    #[error("{name}: row {row} has {found} cells, expected {expected}, as many as the header")]
    Cells {
        /// The table.
        name: String,
        /// The row, counted from 1, without the header.
        row: usize,
        /// Columns.
        expected: usize,
        /// Cells.
        found: usize,
    },
    /// More vertices than are let into a page.
    #[error("{name}: the mesh has {found} vertices, expected at most {most}")]
    TooLarge {
        /// The mesh.
        name: String,
        /// Vertices.
        found: usize,
        /// Most vertices.
        most: usize,
    },
    /// A model that can't be evaluated, or is of no surface.
    #[error("{name}: {source}")]
    Model {
        /// The model.
        name: String,
        /// Why.
        source: ModelError,
    },
    /// A surface that distances can't be measured from.
    #[error("{name}: {source}")]
    Surface {
        /// The model.
        name: String,
        /// Why.
        source: SurfaceError,
    },
    /// Modes that make no shape.
    #[error("{name}: {source}")]
    Shape {
        /// The modes.
        name: String,
        /// Why.
        source: ShapeError,
    },
    /// A picture that can't be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The bytes of a picture.
    #[error("the picture can't be encoded: {0}")]
    Picture(std::io::Error),
    /// What was built into the library is damaged.
    #[error("the page's script can't be unpacked: {0}; build the program again")]
    Assets(std::io::Error),
    /// Data that JSON has no form for.
    #[error("the page's data can't be written: {0}")]
    Data(#[from] serde_json::Error),
}
