//! The error type of this crate.

use spharm_model::ModelError;
use spharm_render::RenderError;
use spharm_shape::ShapeError;
use spharm_surface::SurfaceError;

/// Errors of this crate. The field `name` is the name of an item in the page.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ReportError {
    /// The page has no contents.
    #[error("a page needs a model, modes, a test, quality measures or a table; found none of these")]
    Empty,
    /// A map whose number of values differs from its mesh's number of vertices.
    #[error("{name}: map {map} has {found} values, expected one for each of the {expected} vertices")]
    ValueCount {
        /// Name of the test.
        name: String,
        /// Name of the map.
        map: String,
        /// Number of vertices.
        expected: usize,
        /// Number of values.
        found: usize,
    },
    /// A table with rows of different lengths.
    #[error("{name}: row {row} has {found} cells, expected {expected}, as in the header")]
    Cells {
        /// Name of the table.
        name: String,
        /// Number of the row, from 1, not counting the header.
        row: usize,
        /// Number of columns of the table.
        expected: usize,
        /// Number of cells of the row.
        found: usize,
    },
    /// A mesh with too many vertices for a page.
    #[error("{name}: the mesh has {found} vertices, expected at most {most}")]
    TooLarge {
        /// Name of the mesh.
        name: String,
        /// Number of vertices.
        found: usize,
        /// Maximum number of vertices.
        most: usize,
    },
    /// A model that can't be evaluated, or isn't a model of a surface.
    #[error("{name}: {source}")]
    Model {
        /// Name of the model.
        name: String,
        /// Underlying error.
        source: ModelError,
    },
    /// Distances from a surface can't be measured.
    #[error("{name}: {source}")]
    Surface {
        /// Name of the model.
        name: String,
        /// Underlying error.
        source: SurfaceError,
    },
    /// Modes of a group from which shapes can't be computed.
    #[error("{name}: {source}")]
    Shape {
        /// Name of the modes.
        name: String,
        /// Underlying error.
        source: ShapeError,
    },
    /// A picture that can't be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// A picture that can't be encoded.
    #[error("the picture can't be encoded: {0}")]
    Picture(std::io::Error),
    /// An asset embedded in the library is damaged.
    #[error("the page's script can't be unpacked: {0}; build the program again")]
    Assets(std::io::Error),
    /// Data that can't be represented in JSON.
    #[error("the page's data can't be written: {0}")]
    Data(#[from] serde_json::Error),
}
