//! Distances between a surface and its reconstruction.

mod colormap;
mod distance;
mod pointwise;
mod vertexwise;

pub use colormap::{colors, viridis};
pub use distance::{Directed, SurfaceDistance, SurfaceDistanceParams, surface_distance};
pub use pointwise::{correspond, distances_to_surface, vertex_distances};
pub use vertexwise::{Distances, bounding_box_scale, compare, squared_distances};
