//! Fast synthesis and adjoint synthesis of spherical harmonics at scattered directions.
//!
//! # Map
//!
//! | module | what |
//! |---|---|
//! | [`gram`] | the Gram matrix of the basis at scattered weighted directions, from their moments |

mod error;
pub mod gram;

pub use error::TransformError;
pub use gram::MomentGram;
