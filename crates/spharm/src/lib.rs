//! Spherical-harmonic (SPHARM) models of closed surfaces: read, parametrise, fit, assess, write, reconstruct.
//!
//! A SPHARM model describes a closed surface of genus zero by three functions on the sphere, x, y and z, each a sum of
//! spherical harmonics up to a degree L. This crate is everything that the program `spharm` does, as functions.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`mod@fit`] | [`fit()`], [`fit_many`]: coefficients of one target, or of many in bounded memory |
//! | [`params`] | [`FitParams`]: degree, method, smoothness, weights, store, memory, threads |
//! | [`report`] | what a fit reports |
//! | [`assess`] | distances at the vertices, between them, at vertices held out |
//! | [`warning`] | [`FitWarning`]: what may be wrong with a fit |
//! | [`defaults`] | the numbers behind the defaults |
//! | [`files`] | the files of a fit |
//! | [`rerun`] | what becomes of outputs that exist |
//! | [`factor`] | the factor of the normal equations, kept in a store |
//! | [`machine`] | memory and limits of this process |
//!
//! The crates below are re-exported: [`io`] and [`generate`] of `spharm-surface`, the methods of `spharm-parametrize`.

pub mod assess;
pub mod defaults;
mod error;
pub mod factor;
pub mod files;
pub mod fit;
pub mod machine;
pub mod model;
pub mod parametrize;
pub mod params;
pub mod prelude;
pub mod report;
pub mod rerun;
pub mod warning;

pub use error::Error;
pub use fit::{Fit, Quadrature, ToTarget, check_memory, fit, fit_many, fit_with};
pub use model::{model_of, versions};
pub use params::{FitParams, Method, Preconditioner, Smoothness, Weights};
pub use report::{BatchReport, FitReport, ManyReport, Seconds, Settings};
pub use warning::FitWarning;

pub use spharm_model::{FileRecord, Model, ModelError, Versions};
pub use spharm_monitor::{Interrupted, Level, Monitor, Silent, Stage};
pub use spharm_surface::{Kind, Mesh, Signal, Sphere, Target, generate, io};
