//! Surfaces made by formula: icospheres, and folded closed surfaces whose parameterisation is known; and more of the
//! vertices that a mesh has.

mod cortex;
mod icosphere;
mod random;
mod subdivide;

pub use cortex::{Cortex, cortex};
pub use icosphere::icosphere;
pub use random::SplitMix64;
pub use subdivide::{subdivide, subdivide_sphere};
