//! Measures distances between a surface and its reconstruction, and maps them to colours.

mod colormap;
mod distance;
mod grid;
mod pointwise;
mod unpaired;
mod vertexwise;

pub use colormap::{DIVERGING, colors, colors_by, diverging, viridis};
pub use distance::{
    Directed, FarSample, SurfaceDistance, SurfaceDistanceParams, directed_distance, surface_distance,
    surface_distance_at, surface_distance_bytes,
};
pub use pointwise::{correspond, distances_to_surface, distances_to_surface_bytes, vertex_distances};
pub use unpaired::Unpaired;
pub use vertexwise::{Distances, bounding_box_scale, compare, compare_at, squared_distances};
