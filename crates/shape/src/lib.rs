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
//! | [`derivatives`] | the operators L_x, L_y, L_z, each degree to itself |
//! | [`geometry`] | tangents, normal, fundamental forms, curvatures at any directions |
//! | [`measures`] | area, volume, centroid |
//! | [`heat`] | smoothing by the heat kernel |
//! | [`mod@descriptors`] | power and singular values of each degree, which rotations don't change |
//! | [`retrieval`] | the nearest models of a library |
//! | [`levels`] | coarser levels within a distance |
//! | [`even`] | directions that spread vertices evenly over the surface |
//! | [`mod@extent`] | whether coefficients are those of a surface |
//! | [`mod@singular_values`] | of matrices of few columns, to full accuracy |
//! | [`codec`] | compressed models, and back |
//! | [`error`] | [`ShapeError`] |

#![forbid(unsafe_code)]

pub mod codec;
pub mod derivatives;
pub mod descriptors;
pub mod error;
pub mod even;
pub mod extent;
pub mod geometry;
pub mod heat;
pub mod levels;
pub mod measures;
pub mod retrieval;
pub mod singular_values;

pub use derivatives::rotational_derivatives;
pub use descriptors::{Descriptors, descriptors};
pub use error::ShapeError;
pub use even::{EvenSphere, area_spread, even_sphere};
pub use extent::{Extent, extent};
pub use geometry::{LocalGeometry, local_geometry, tangent_frame};
pub use heat::HeatKernel;
pub use levels::{degree_within, tails};
pub use measures::{MeasureParams, MeasureWarning, Measures, measure};
pub use retrieval::{Library, Match, Metric};
pub use singular_values::singular_values;
