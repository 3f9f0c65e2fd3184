//! Fits spherical harmonics to functions on the sphere: by iterative residual fitting over a basis that is streamed in
//! bounded memory, and by the full least squares without a stored basis.
//!
//! The methods are described by L. Shen and M. K. Chung, "Large-scale modeling of parametric surfaces using spherical
//! harmonics", 3DPVT 2006. The coordinates x, y and z of a surface are three columns of targets. The columns of several
//! surfaces are fitted together.
//!
//! The basis matrix A (n, K) has one row for each of n directions (vertices), and one column for each of the
//! `K = (L + 1)^2` basis functions up to degree L, in the order `l^2 + l + m`. Targets (n, c) have c columns, which are
//! fitted together.
//!
//! | module | contents |
//! |---|---|
//! | [`operator`] | the basis: as fast transforms, in memory, in a store |
//! | [`irf`] | iterative residual fitting: NLSF, SIRF, MIRF, IRF |
//! | [`lsq`] | the full least squares: conjugate gradients, Cholesky with refinement |
//! | [`gram`] | Gram matrices, from the moments of a sampling |
//! | [`cholesky`] | the factor of the normal equations, in memory or in a store |
//! | [`chunked_rows`] | targets and residual, stored in the basis's chunks |
//! | [`residual`] | norms of a residual |
//! | `dense`, [`threaded`] | dense matrices on one thread and on several |
//!
//! Without the default feature `dense`, only fast operators, conjugate gradients ([`lsq::cg`]) and cross-validation are
//! available, and `spharm-store` isn't needed.
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::{Directions, synthesis};
//! use spharm_monitor::Silent;
//! use spharm_solver::{IrfParams, MemoryOperator, Method, irf};
//!
//! // The fit recovers functions of degree 2 from samples at 200 directions.
//! let angles: Vec<_> = (0..200).map(|i| [0.015 * i as f64 + 0.05, 2.4 * i as f64]).collect();
//! let directions = Directions::from_angles(&angles)?;
//! let known = Array2::from_shape_fn((9, 3), |(k, c)| (k + c) as f64);
//! let targets = synthesis(&directions, known.view())?;
//! let operator = MemoryOperator::new(&directions, 2, 64)?;
//! let params = IrfParams { max_degree: 2, method: Method::Nlsf, ..IrfParams::default() };
//! let fit = irf::solve(&operator, targets.view(), &[0..3], &params, &Silent)?;
//! assert!((fit.coefficients.values() - &known).iter().all(|d| d.abs() < 1e-12));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(feature = "dense")]
mod check;
#[cfg(feature = "dense")]
pub mod cholesky;
#[cfg(feature = "dense")]
pub mod chunked_rows;
#[cfg(feature = "dense")]
mod condition;
#[cfg(feature = "dense")]
mod dense;
mod error;
pub mod gram;
#[cfg(feature = "dense")]
pub mod irf;
pub mod lsq;
mod moment_normal;
pub mod operator;
pub mod residual;
#[cfg(feature = "dense")]
pub mod threaded;

#[cfg(feature = "dense")]
pub use cholesky::{CholeskyFactor, FactorParams, MemoryFactor, StoredFactor};
#[cfg(feature = "dense")]
pub use chunked_rows::ChunkedRows;
pub use error::SolverError;
pub use gram::{GramMatrix, moment_gram, moment_gram_bytes, moment_normal};
#[cfg(feature = "dense")]
pub use irf::{IrfFit, IrfParams, IrfPlan, IrfReport, IrfSolver, Method};
#[cfg(feature = "dense")]
pub use lsq::{LsqFit, LsqParams, LsqReport, LsqSolver, Strategy};
pub use moment_normal::MomentNormal;
#[cfg(feature = "dense")]
pub use operator::{BlockOperator, DiskOperator, MemoryOperator, Residency};
pub use operator::{DeferredOperator, MatrixFreeOperator, Operator};
pub use residual::ResidualNorms;

/// Returns the requested number of threads; 0 means the number of threads of the caller's rayon pool.
#[cfg(feature = "dense")]
pub(crate) fn threads(asked: usize) -> usize {
    if asked == 0 { rayon::current_num_threads() } else { asked }
}
