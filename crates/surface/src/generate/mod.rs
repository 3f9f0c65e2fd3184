//! Icospheres, folded closed surfaces with known parameterisation, and subdivision.

mod cortex;
mod icosphere;
mod random;
mod subdivide;

pub use cortex::{Cortex, cortex};
pub use icosphere::icosphere;
pub use random::SplitMix64;
pub use subdivide::{subdivide, subdivide_sphere};
