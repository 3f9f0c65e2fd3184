//! Icospheres, folded closed surfaces with known parameterisation, surfaces with handles, and subdivision.

mod cortex;
mod handles;
mod icosphere;
mod random;
mod subdivide;

pub use cortex::{Cortex, cortex};
pub use handles::{Torus, double_torus, torus};
pub use icosphere::icosphere;
pub use random::SplitMix64;
pub use subdivide::{subdivide, subdivide_sphere};
