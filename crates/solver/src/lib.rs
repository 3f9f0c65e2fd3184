//! Iterative residual fitting of functions on the sphere, over a basis that is streamed in bounded memory.
//!
//! The paper: L. Shen and M. K. Chung, "Large-scale modeling of parametric surfaces using spherical harmonics", 3DPVT
//! 2006. A surface's x, y and z are three columns of targets; many surfaces are many columns, fitted in one sweep.
//!
//! | module | what |
//! |---|---|
//! | [`operator`] | what a solver sees of a basis: [`Operator`], [`operator::Block`] |
//! | [`disk`], [`memory`] | the operator over a store, and one in memory |
//! | [`matrix_free`] | the operator by fast transforms |
//! | [`schedule`] | NLSF, SIRF, MIRF, IRF: which degrees are solved together |
//! | [`mod@plan`] | what memory a fit takes |
//! | [`rows`] | targets and residual, kept in the basis's chunks |
//! | `block` | one block's least squares |
//! | [`grams`] | the blocks' Gram matrices from the sampling's moments |
//! | `triangle` | the rank-revealing way: QR of a matrix that arrives in chunks |
//! | `workers` | what the threads do for a block |
//! | [`mod@fit`] | the passes |
//! | `accelerated` | conjugate gradients over symmetric sweeps of the store |
//! | [`lsq`] | exact least squares without the matrix |
//! | [`report`] | what a fit tells about itself |
//! | [`cholesky`] | the factor of the whole normal equations, in memory or in a store |
//! | [`dense`] | the BLAS and LAPACK, behind one door |
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::{Directions, synthesis};
//! use spharm_solver::{FitParams, MemoryOperator, Method, fit};
//!
//! // Functions of degree 2, sampled at 200 directions, are found again.
//! let angles: Vec<_> = (0..200).map(|i| [0.015 * i as f64 + 0.05, 2.4 * i as f64]).collect();
//! let directions = Directions::from_angles(&angles)?;
//! let known = Array2::from_shape_fn((9, 3), |(k, c)| (k + c) as f64);
//! let targets = synthesis(&directions, known.view())?;
//! let operator = MemoryOperator::new(&directions, 2, 64)?;
//! let params = FitParams { max_degree: 2, method: Method::Nlsf, ..FitParams::default() };
//! let fit = fit(&operator, targets.view(), &[0..3], &params)?;
//! assert!((fit.coefficients.values() - &known).iter().all(|d| d.abs() < 1e-12));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod accelerated;
mod block;
pub mod cholesky;
pub mod dense;
pub mod disk;
mod error;
pub mod fit;
pub mod grams;
pub mod lsq;
pub mod matrix_free;
pub mod memory;
pub mod operator;
pub mod plan;
pub mod report;
pub mod rows;
pub mod schedule;
mod triangle;
mod workers;

pub use cholesky::{CholeskyFactor, Factor, FactorParams, GramSource, StoredFactor};
pub use disk::DiskOperator;
pub use error::SolverError;
pub use fit::{Fit, FitEvent, FitParams, Fitter, fit};
pub use grams::BlockGrams;
pub use matrix_free::MatrixFreeOperator;
pub use memory::MemoryOperator;
pub use operator::{BlockOperator, Operator, Residency};
pub use plan::{Plan, plan};
pub use report::FitReport;
pub use rows::ChunkedRows;
pub use schedule::Method;
