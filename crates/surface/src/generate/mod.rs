//! Surfaces made by formula: icospheres, and folded closed surfaces whose parameterisation is known.

mod cortex;
mod icosphere;
mod random;

pub use cortex::{Cortex, cortex};
pub use icosphere::icosphere;
