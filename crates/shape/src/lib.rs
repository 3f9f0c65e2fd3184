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
//! | [`rotation`] | rotations from angles, axes, quaternions and matrices |
//! | [`rotate`] | coefficients rotated in their parameters |
//! | [`transform`] | surfaces and models moved in space and in their parameters |
//! | [`mod@align`] | one surface brought to another, by a search of all rotations of both spaces |
//! | [`foe`] | the frame of the first-order ellipsoid |
//! | [`mod@procrustes`] | a group of surfaces brought together, and its mean |
//! | [`error`] | [`ShapeError`] |
//! | `quarter`, `row_sums`, `half_turn` | Wigner's matrix at pi/2, sums with its rows, and the half turn made of them |
//! | `generators` | infinitesimal rotations |
//! | `matrix3` | 3 x 3 matrices |
//! | `kabsch` | 3 x 3 singular values, and the best rotation of space |
//! | `so3_grid`, `refine`, `pair` | all rotations of a grid; one of them refined; both together |
//! | `group` | a group while it is brought together |
//! | `templates` | the members that a group's alignment starts from |

#![forbid(unsafe_code)]

pub mod align;
pub mod error;
pub mod foe;
mod generators;
mod group;
mod half_turn;
mod kabsch;
mod matrix3;
mod pair;
pub mod procrustes;
mod procrustes_report;
mod quarter;
mod refine;
pub mod rotate;
pub mod rotation;
mod row_sums;
#[cfg(test)]
mod samples;
mod so3_grid;
mod templates;
pub mod transform;

pub use align::{AlignParams, AlignReport, AlignWarning, Alignment, Method, align};
pub use error::ShapeError;
pub use foe::EllipsoidFrame;
pub use procrustes::{Procrustes, ProcrustesParams, ProcrustesReport, ProcrustesWarning, TemplateEnd, procrustes};
pub use rotate::rotate_parameters;
pub use rotation::Rotation;
pub use transform::{Similarity, Transform, rmsd, transform_object};
