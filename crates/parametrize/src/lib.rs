//! Maps closed surfaces to the sphere, one to one.
//!
//! A SPHARM model is fitted over a map from the surface to the sphere, and can only be as good as that map. If the map
//! compresses a part of the surface, few samples lie on that part, and the model's high degrees describe other parts,
//! which don't need them. This crate computes such maps. Every method returns either a one-to-one map, verified by an
//! exact predicate on each spherical triangle, or an error.
//!
//! # Example
//!
//! ```
//! use spharm_parametrize::{CaldParams, parametrize};
//! use spharm_surface::generate::{Cortex, cortex};
//!
//! let (surface, _) = cortex(&Cortex { subdivisions: 3, variant: 0 });
//! let found = parametrize(&surface, &CaldParams::default())?;
//! assert_eq!(found.sphere.faces, surface.faces);
//! assert!(found.quality().is_bijective());
//! assert!(found.quality().area_rms < 0.1);
//! # Ok::<(), spharm_parametrize::ParametrizeError>(())
//! ```
//!
//! # Conventions
//!
//! - A sphere has the vertices and triangles of its surface, in the same order; its vertices lie on the unit sphere up
//!   to rounding.
//! - Triangles that wind outwards on the surface also wind outwards on the sphere.
//! - For comparisons of areas, the surface is scaled to the area of the sphere, 4 pi.
//! - The same input and seed give the same bits, for any number of threads.
//! - Functions that may take longer than a second have a [`Monitor`](spharm_monitor::Monitor) as their last parameter,
//!   for progress and cancellation.
//!
//! # Method
//!
//! All methods for meshes begin in the same way. The surface is coarsened to a tetrahedron, which is placed on the
//! sphere. Then the vertices are reinserted, each at a position where it flips no triangle (`hierarchy.rs`, `embed.rs`,
//! `star.rs`). From there, a method minimises its energy (`energy.rs`) by Newton steps over the whole mesh
//! (`newton.rs`) and by sweeps over single vertices, and takes no step that flips a triangle. The map therefore never
//! has folds; the result is verified independently. Derivatives are in closed form (`local.rs`). Linear systems are
//! solved by conjugate gradients with a two-grid preconditioner (`pcg.rs`, `coarse.rs`), so time and memory are linear
//! in the number of vertices.
//!
//! # Modules and methods
//!
//! | item | |
//! |---|---|
//! | [`parametrize()`], [`auto()`] | the default method: `cald`, or `stretch` if `cald` fails |
//! | [`cald()`] | equal areas with little length distortion (Shen and Makedon 2006), adapted to the residual of a fit |
//! | [`conformal()`] | least angle distortion |
//! | [`stretch()`] | least stretch (Praun and Hoppe 2003) |
//! | [`deform()`] | deforms an icosphere onto the surface, coarse to fine |
//! | [`equal_area()`] | equal areas for the surface of a voxel object (Brechbuehler et al. 1995) |
//! | [`resample()`] | resamples a surface on another sampling of its sphere |
//! | [`handles`] | cuts and fills surfaces with handles, so that they have genus zero |
//! | [`Method`] | an enum with one variant per method, each containing the method's settings |
//! | [`fill_in()`] | fills in missing values from the values around them |
//! | [`Input`] | a mesh or a label's surface from a file |
//! | [`wrap()`] | the closed surface around a mesh of any kind |
//! | [`volume`] | label volumes: the closed surface around a label, repaired on request |
//! | [`quality`] | whether a map is one to one, and its distortion of areas, angles and lengths |

#![forbid(unsafe_code)]

mod angle;
mod auto;
mod background;
mod batch;
mod blocks;
mod cald;
mod coarse;
mod conformal;
mod deform;
mod density;
mod descend;
mod domain;
mod embed;
mod enclosure;
mod energy;
mod equal_area;
mod error;
mod fill;
mod flaws;
mod geometry;
pub mod handles;
mod hierarchy;
mod hubs;
mod input;
mod local;
mod memory;
mod mending;
mod method;
mod newton;
mod pcg;
pub mod quality;
mod report;
mod resample;
mod residual_areas;
mod self_intersections;
mod sparse_cholesky;
mod star;
mod stretch;
mod trial;
pub mod volume;
pub mod wrap;

pub use auto::{auto, parametrize};
pub use cald::{CaldParams, cald};
pub use conformal::{ConformalParams, conformal};
pub use deform::{DeformParams, deform};
pub use equal_area::{EqualAreaParams, area_deviation, equal_area};
pub use error::ParametrizeError;
pub use fill::fill_in;
pub use handles::{CutSurface, HandlesReport, LARGEST_HOLE, cut_handles, fill_holes};
pub use input::{Given, Input, Sampling};
pub use mending::Mending;
pub use method::{Method, Source};
pub use quality::Quality;
pub use report::{Note, Parametrization, Report, Resampling, Warning};
pub use resample::resample;
pub use stretch::{StretchParams, stretch};
pub use trial::defects;
pub use wrap::wrap;
