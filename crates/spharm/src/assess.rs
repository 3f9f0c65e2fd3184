//! How far a model is from its surface: at the vertices, between them, and at vertices that the fit didn't see.

mod hold_out;
mod off_vertex;

pub use hold_out::HeldOut;
pub(crate) use hold_out::HoldOut;
pub(crate) use off_vertex::OffVertex;

use serde::Serialize;
use spharm_surface::metrics::bounding_box_scale;
use spharm_surface::{Kind, Target};

/// Mean and maximal squared distance of a model from its target.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Distances {
    /// Whether they are those after a sweep beyond the passes asked for, which reduces the error left by rounding.
    pub refinement: bool,
    /// Mean squared distance with the surface's bounding box scaled to volume 1; none for what has no volume.
    pub msd: Option<f64>,
    /// Maximal squared distance, scaled likewise.
    pub xsd: Option<f64>,
    /// Mean squared distance in the target's unit, squared.
    pub msd_raw: f64,
    /// Maximal squared distance in the target's unit, squared.
    pub xsd_raw: f64,
}

/// Returns the cube root of the bounding box's volume of a surface, in its unit; none for signals and flat surfaces.
pub(crate) fn scale_of(target: &Target) -> Option<f64> {
    if target.kind != Kind::Surface {
        return None;
    }
    bounding_box_scale(target.values.as_chunks().0).ok()
}

impl Distances {
    /// From the mean and the maximum of the squared distances, and the scale of the surface.
    pub(crate) fn new(mean_square: f64, max_square: f64, refinement: bool, scale: Option<f64>) -> Self {
        let normalised = |value: f64| scale.map(|scale| value / (scale * scale));
        Self {
            refinement,
            msd: normalised(mean_square),
            xsd: normalised(max_square),
            msd_raw: mean_square,
            xsd_raw: max_square,
        }
    }
}
