//! Generates surfaces: icospheres, double pyramids, folded closed surfaces with known parameterisation, surfaces with
//! handles, groups with a known difference or known correspondence, subdivisions of meshes, and voxels of surfaces.

mod bipyramid;
mod cortex;
mod group;
mod handles;
mod icosphere;
mod random;
mod study;
mod subdivide;
mod voxels;

pub use bipyramid::bipyramid;
pub use cortex::{Cortex, cortex, cortex_bytes};
pub use group::{Family, Group, Member};
pub use handles::{Torus, double_torus, torus};
pub use icosphere::{icosphere, icosphere_bytes, icosphere_counts};
pub use random::SplitMix64;
pub use study::Study;
pub use subdivide::{subdivide, subdivide_sphere};
pub use voxels::Voxels;
