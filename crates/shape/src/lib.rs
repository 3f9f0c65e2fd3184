//! What is done with spherical-harmonic surface models: rotation, alignment, statistics of groups, geometry, compression.
//!
//! Coefficients are (K, 3) arrays over the canonical basis, row `l^2 + l + m` (see `spharm_harmonics`); K = (L+1)^2.
//! The distance between two surfaces f and g with coefficients a and b is `|a - b| / sqrt(4 pi)`, the root mean square
//! over the sphere of |f(u) - g(u)| by Parseval's identity; it is in the surface's unit of length.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`pca`] | mean and modes of a group, and their quality |
//! | [`stats`] | tests of groups and covariates at every vertex |
//! | [`error`] | [`ShapeError`] |

pub mod error;
pub mod pca;
pub mod stats;

pub use error::ShapeError;
