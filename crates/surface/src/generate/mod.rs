//! Generates surfaces: icospheres, double pyramids, folded closed surfaces with a known parameterisation, surfaces with
//! handles, and groups of surfaces with a known difference or known correspondence. Also subdivides meshes, and
//! converts surfaces to voxels.

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
