//! Icospheres, folded closed surfaces with known parameterisation, groups that differ in a known way, and subdivision.

mod cortex;
mod icosphere;
mod random;
mod study;
mod subdivide;

pub use cortex::{Cortex, cortex};
pub use icosphere::icosphere;
pub use random::SplitMix64;
pub use study::Study;
pub use subdivide::{subdivide, subdivide_sphere};
