//! Spherical-harmonic (SPHARM) models of closed surfaces: read, parametrise, fit, assess, write, reconstruct.
//!
//! A SPHARM model describes a closed surface of genus zero by three functions on the sphere, x, y and z, each a sum of
//! spherical harmonics up to a degree L. The functions of this crate provide everything that the program `spharm`
//! computes. `spharm-render` draws pictures, and `spharm-paper` contains the experiments of the paper.
//!
//! ```
//! use spharm::prelude::*;
//! # use spharm::generate::{Cortex, cortex};
//! # let folder = tempfile::tempdir()?;
//! # std::env::set_current_dir(&folder)?;
//! # write_mesh("bunny.ply", &cortex(&Cortex { subdivisions: 4, variant: 0 }).0)?;
//!
//! let surface = read_mesh("bunny.ply")?;
//! let model = Model::from(fit_mesh(&surface, &FitParams::lsq(20))?);
//! model.write("bunny.spharm.npz")?;
//! write_mesh("bunny20.ply", &model.reconstruct(&Sphere::icosphere(5), 20)?)?;
//! # assert!(model.provenance.parametrized);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The program `spharm fit` makes the same calls. Its coefficients are bit-identical for the same number of threads and
//! the same memory budget.
//!
//! # Data flow
//!
//! 1. [`io::read_mesh`] reads a closed surface, and [`fit_mesh()`] maps it one to one to a [`Sphere`] and fits it
//!    there, see [`parametrize`](mod@parametrize). Surfaces of a study with a common sphere are read with that sphere:
//!    [`read_sphere`], [`Target`].
//! 2. [`fit()`] computes the coefficients, by default by the full least squares. [`fit_many`] streams any number of
//!    surfaces over one sphere through bounded memory. With a basis store, a [`Method`] reads the basis from disk
//!    instead of computing fast transforms.
//! 3. The [`FitReport`] gives the distances between model and surface, at the vertices and between them, and warnings.
//! 4. A [`Model`] holds coefficients, sphere and provenance; [`Model::reconstruct`] evaluates it anywhere, to any
//!    degree.
//!
//! # Conventions
//!
//! Degrees are inclusive. Coefficients are those of the real orthonormal harmonics without the Condon-Shortley phase,
//! row `l^2 + l + m`, in the surface's unit. A residual is target minus synthesis. msd and xsd are the mean and the
//! maximum over the vertices of the squared distance, with the surface's bounding box scaled to volume 1.
//!
//! No function prints, ends the process, or changes its environment. Reading a store installs a handler of SIGBUS,
//! which acts only on faults inside the store's memory maps. Every function that may run longer than a second takes a
//! [`Monitor`], which shows its progress and can cancel it. Functions with a [`Monitor`] run in the caller's rayon
//! pool, or in a separate pool if [`FitParams::threads`] is set.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`mod@fit`] | [`fit()`], [`fit_many`], [`fit_each`]: coefficients of one target, or of many in bounded memory |
//! | [`mod@fit_mesh`] | [`fit_mesh()`]: maps and fits a surface without a sphere |
//! | [`params`] | [`FitParams`]: degree, method, smoothness, weights, store, memory, threads |
//! | [`report`] | reports on fits |
//! | [`assess`] | distances at the vertices, between them, and at held-out vertices |
//! | [`warning`] | [`FitWarning`]: possible problems with a fit |
//! | [`defaults`] | numeric defaults, with the reason for each |
//! | [`factor`] | the Cholesky factor of the normal equations, stored beside the basis |
//! | [`mod@correspond`] | a group of surfaces over one template's sphere, with corresponding points |
//! | [`machine`] | memory and limits of this process |
//! | [`mod@parametrize`] | maps from surfaces to the sphere: all methods, label volumes, resampling, quality |
//! | [`mod@model`] | provenance of models |
//!
//! These crates are re-exported:
//!
//! | module | crate | contents |
//! |---|---|---|
//! | [`store`] | `spharm-store` | basis stores: [`store::build`], [`store::catalog`] |
//! | [`io`], [`generate`], [`metrics`] | `spharm-surface` | files, example surfaces, distances between surfaces |
//! | [`solver`] | `spharm-solver` | least squares and iterative residual fitting on arrays |
//! | [`register`] | `spharm-register` | a template mesh moved onto surfaces of subjects |
//! | [`shape`] | `spharm-shape` | shape analysis on models: geometry, smoothing, descriptors, retrieval, levels, compression |
//! | [`moments`] | `spharm-moments` | moments of tables of samples, also of tables beyond one machine's memory |
//! | [`transform`] | `spharm-transform` | fast synthesis and its adjoint |
//! | [`harmonics`] | `spharm-harmonics` | the harmonics, [`Directions`], [`Coefficients`] |
//!
//! A basis is built once for all fits over its sphere:
//!
//! ```
//! use spharm::generate::{Cortex, cortex};
//! use spharm::metrics::compare;
//! use spharm::store::{BuildParams, build};
//! use spharm::{FitParams, Silent, Sphere, fit};
//!
//! let folder = tempfile::tempdir()?;
//! let (surface, sphere) = cortex(&Cortex { subdivisions: 3, variant: 0 });
//! let sphere = Sphere::from_mesh(&sphere)?;
//! let params = BuildParams { max_degree: 10, ..BuildParams::default() };
//! build(folder.path(), &sphere.directions, &params, &Silent)?;
//! let fit = fit(&sphere, &surface, &FitParams::irf(10, folder.path()))?;
//! let model = fit.into_model(sphere.clone());
//! assert!(compare(&surface, &model.reconstruct(&sphere, 10)?)?.msd < 1e-2);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

/// The README's Rust code, compiled with the documentation's tests.
#[cfg(doctest)]
#[doc = include_str!("../../../README.md")]
pub struct Readme;

pub mod assess;
pub mod correspond;
pub mod defaults;
pub mod degree;
mod error;
pub mod factor;
pub mod fit;
pub mod fit_mesh;
pub mod machine;
pub mod model;
mod objective;
pub mod parametrize;
pub mod params;
pub mod prelude;
pub mod report;
pub mod warning;
mod weights;

pub use degree::{Accuracy, DegreeChoice, choose_degree, choose_degree_over};
pub use error::Error;
pub use fit::{
    Fit, MomentsFit, MomentsReport, PlannedSphere, Quadrature, ToTarget, check_mapping, check_memory, fit, fit_each,
    fit_many, fit_moments, fit_target, fit_with,
};
pub use fit_mesh::{
    DROPPED, FILLED, MappedSurface, MeshFit, Preparation, check_surface, fit_mesh, fit_mesh_masked, fit_mesh_with,
    percent_to_allow, percent_to_wrap,
};
pub use model::versions;
pub use objective::Objective;
pub use params::{FitParams, Method, Preconditioner, Smoothness};
pub use report::{BatchReport, Denoised, FitReport, ManyReport, Seconds, Settings};
pub use warning::FitWarning;
pub use weights::Weights;

pub use spharm_harmonics as harmonics;
pub use spharm_moments as moments;
pub use spharm_register as register;
pub use spharm_shape as shape;
pub use spharm_solver as solver;
pub use spharm_store as store;
pub use spharm_transform as transform;

pub use spharm_harmonics::{Coefficients, Directions, HarmonicsError};
pub use spharm_model::{FileRecord, Model, ModelError, Versions};
pub use spharm_moments::{Moments, MomentsError};
pub use spharm_monitor::{Interrupted, Level, Monitor, Silent, Stage, Unit};
pub use spharm_parametrize::ParametrizeError;
pub use spharm_shape::ShapeError;
pub use spharm_solver::SolverError;
pub use spharm_store::{Scalar, StoreError};
pub use spharm_surface::{
    Kind, Mesh, Place, Seam, Signal, Sphere, SurfaceError, Target, generate, io, metrics, pose, read_sphere,
    read_target, read_target_with_gaps,
};
pub use spharm_transform::TransformError;
