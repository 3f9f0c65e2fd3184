//! Measures distances between a model and its surface: over the whole area, at vertices, at centres of triangles, and
//! at held-out vertices.

mod hold_out;
mod model_surface;
mod off_vertex;

pub use hold_out::HeldOut;
pub(crate) use hold_out::HoldOut;
pub use model_surface::SurfaceDistances;
pub(crate) use model_surface::{ModelSurface, ReadSurface};
pub(crate) use off_vertex::OffVertex;
pub use spharm_model::Distances;

use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::{Kind, Target};

/// Returns the cube root of the volume of a surface's bounding box, in the surface's unit; `None` for signals and flat
/// surfaces.
pub(crate) fn scale_of(target: &Target) -> Option<f64> {
    if target.kind != Kind::Surface {
        return None;
    }
    bounding_box_scale(target.values.as_chunks().0).ok()
}
