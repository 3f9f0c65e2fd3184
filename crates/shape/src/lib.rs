//! Operations on spherical-harmonic surface models: rotation, alignment, statistics of groups, geometry, compression.
//!
//! Coefficients are (K, 3) arrays over the canonical basis, with K = (L+1)^2. Row `l^2 + l + m` has degree l and order
//! m (see `spharm_harmonics`). The distance between two surfaces f and g with coefficients a and b is `|a - b| / sqrt(4
//! pi)`, in the surfaces' unit of length. By Parseval's identity, it equals the root mean square of |f(u) - g(u)| over
//! the sphere.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`rotation`] | rotations from angles, axes, quaternions and matrices |
//! | [`rotate`] | rotation of a model's parameters, applied to its coefficients |
//! | [`transform`] | transforms of surfaces and models in space and in their parameters |
//! | [`mod@align`] | alignment of one surface to another, by a search of all rotations of the parameters and of space |
//! | [`foe`] | the frame of the first-order ellipsoid |
//! | [`mod@procrustes`] | alignment of a group of surfaces, and the group's mean |
//! | [`derivatives`] | the operators L_x, L_y, L_z, which map each degree to itself |
//! | [`geometry`] | tangents, normal, fundamental forms, curvatures at any directions |
//! | [`mod@mean`] | truncation of groups to a common degree, and their mean |
//! | [`poses`] | check whether the surfaces of a group share one pose |
//! | [`smoothing`] | check whether the models of a group were smoothed equally |
//! | [`measures`] | area, volume, centroid |
//! | [`heat`] | smoothing by the heat kernel |
//! | [`mod@descriptors`] | power and singular values of each degree, which are invariant under rotations |
//! | [`retrieval`] | search for the nearest models of a library |
//! | [`levels`] | error of truncating a model to a lower degree |
//! | [`even`] | directions that spread vertices evenly over the surface |
//! | [`mod@extent`] | check whether coefficients describe a surface |
//! | [`mod@singular_values`] | singular values of matrices with few columns, to full accuracy |
//! | [`morph`] | intermediate shapes between two surfaces |
//! | [`field`] | measured values of a group at the vertices of a sampling |
//! | [`pca`] | mean and modes of a group, and their quality |
//! | [`mod@groupwise`] | refinement of a group's correspondence |
//! | [`mod@quality`] | quality of a group's correspondence, weighted by area |
//! | [`units`] | members of a group whose lengths seem to be in another unit |
//! | [`stats`] | tests of groups and covariates at every vertex |
//! | [`codec`] | compression and decompression of models |
//! | [`error`] | [`ShapeError`] |
//! | `quarter`, `row_sums`, `half_turn` | Wigner's matrix at pi/2; products with its rows; the resulting half turn |
//! | `matrix3`, `product` | 3 x 3 matrices; products of large matrices |
//! | `so3_grid`, `refine`, `pair` | search over a grid of rotations; refinement of one rotation; both combined |
//! | `group` | a group during its alignment |
//! | `templates` | choice of the members from which a group's alignment starts |
//!
//! # Example
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::{Coefficients, Directions};
//! use spharm_monitor::Silent;
//! use spharm_shape::{MeasureParams, local_geometry, measure};
//!
//! // An ellipsoid of semi-axes 3, 2 and 1, which has coefficients of degree 1 only.
//! let unit = (4.0 * std::f64::consts::PI / 3.0).sqrt();
//! let mut values = Array2::zeros((4, 3));
//! (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (3.0 * unit, 2.0 * unit, unit);
//! let ellipsoid = Coefficients::new(values)?;
//!
//! let found = measure(&ellipsoid, &MeasureParams::default(), &Silent)?;
//! assert!((found.volume - 8.0 * std::f64::consts::PI).abs() < 1e-12);
//! let pole = Directions::from_vertices(&[[0.0, 0.0, 1.0]])?;
//! let [point] = local_geometry(&ellipsoid, &pole, &Silent)?[..] else { unreachable!() };
//! assert!((point.gaussian_curvature() - 1.0 / 36.0).abs() < 1e-14);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod align;
pub mod clusters;
pub mod codec;
pub mod derivatives;
pub mod descriptors;
pub mod error;
mod evaluated;
pub mod even;
pub mod extent;
pub mod field;
pub mod foe;
pub mod geometry;
mod group;
pub mod groupwise;
mod half_turn;
pub mod heat;
pub mod levels;
mod matrix3;
pub mod mean;
pub mod measures;
pub mod memory;
pub mod morph;
pub mod outliers;
mod pair;
pub mod pca;
pub mod places;
pub mod poses;
pub mod procrustes;
mod procrustes_report;
mod product;
pub mod quality;
mod quarter;
mod refine;
pub mod retrieval;
pub mod rotate;
pub mod rotation;
mod row_sums;
#[cfg(test)]
mod samples;
pub mod singular_values;
pub mod smoothing;
mod so3_grid;
pub mod stats;
pub mod surface_poses;
mod templates;
pub mod transform;
pub mod units;

pub use align::{AlignParams, AlignReport, AlignWarning, Alignment, Method, align};
pub use clusters::{Clusters, PairDistances};
pub use derivatives::rotational_derivatives;
pub use descriptors::{Descriptors, descriptors};
pub use error::ShapeError;
pub use even::{EvenSphere, area_spread, even_sphere};
pub use extent::{Extent, extent};
pub use field::{Field, Measurement, measure_group};
pub use foe::EllipsoidFrame;
pub use geometry::{LocalGeometry, local_geometry, tangent_frame};
pub use groupwise::{Flow, Groupwise, GroupwiseParams, GroupwiseReport, StageParams, StageReport, groupwise};
pub use heat::HeatKernel;
pub use levels::{degree_within, tails};
pub use mean::{CommonDegree, DegreesDiffer, mean, to_common_degree};
pub use measures::{MeasureParams, MeasureWarning, Measures, measure};
pub use outliers::{Influence, Outlier, equal_members, influential, outliers, robust_z};
pub use pca::Modes;
pub use places::places_differ;
pub use poses::PosesDiffer;
pub use procrustes::{
    Journal, Procrustes, ProcrustesParams, ProcrustesReport, ProcrustesWarning, TemplateEnd, procrustes,
    procrustes_with,
};
pub use quality::{Curve, GroupQuality, QualityParams, group_quality};
pub use retrieval::{Library, Match, Metric};
pub use rotate::rotate_parameters;
pub use rotation::Rotation;
pub use singular_values::singular_values;
pub use smoothing::{Smoothing, SmoothingDiffers};
pub use surface_poses::{SurfacePoseWarning, SurfacePoses, surface_poses};
pub use transform::{Similarity, Transform, rmsd, transform_object};
pub use units::{OtherUnit, other_units, unit_factor};
