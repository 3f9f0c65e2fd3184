//! The full least squares, by products with the basis and, where that is too slow, a factor of the normal equations.
//!
//! ```text
//! min | W^(1/2) (A x - f) |^2 + x^T P x,   P = lambda diag (l (l + 1))^2 + diag p_l
//! ```
//!
//! for each column f of the targets. This is the paper's NLSF, without its matrix. [`Strategy::Auto`] proceeds as
//! follows:
//!
//! 1. Conjugate gradients ([`cg`]) by fast operators. On an even sampling the normal matrix `N = A^T W A + P` is nearly
//!    a multiple of the identity, and a handful of iterations suffices.
//! 2. Where they are slow, a Cholesky factor of N in single precision, from the Gram matrix, to precondition with, from
//!    some 4,000 columns on and where condition numbers, which are estimated with it, allow for that.
//! 3. Else the Cholesky factor of N in double precision, and refinement: `x += N^-1 g` with the gradient
//!    `g = A^T W (f - A x) - P x` formed by the operator, until the optimality `|g| / |A^T W f|` is met or stops
//!    improving. A factor that is at hand, say in a store, is used from the start; where N is well conditioned, when
//!    the iterations that seem to be left would take longer.
//! 4. Where N is numerically singular, the factor of `N + mu I`: `x += (N + mu I)^-1 g`, iterated Tikhonov
//!    regularisation. From x = 0 that tends to the minimum-norm solution; what the targets determine worse than `mu`
//!    allows for stays small instead of growing to 1e11. A. Bjorck, "Numerical methods for least squares problems"
//!    (1996), section 4.1.3.
//!
//! Where the samples are many, products with N in 1 come from moments of the sampling ([`MomentProblem`]), at a cost
//! that doesn't depend on their number, three columns are iterated at a time, and where the sampling is uneven the
//! inverse of its density preconditions ([`InverseDensity`](spharm_transform::InverseDensity)); the gradient is formed
//! from the samples in the end where its errors may count, and the iteration goes on from there where the optimality
//! asks for it.
//!
//! The report says which of these was done, and how close the result is.
//!
//! | module | contents |
//! |---|---|
//! | `params`, `solver`, `iterate`, `choice`, `progress`, `cost` | [`LsqParams`], [`LsqSolver`]: the strategy |
//! | [`normal_equations`], [`cg`], [`preconditioner`] | conjugate gradients |
//! | `factor`, `refine` | the factor of N, shifted where N is singular; refinement with it |
//! | `problem` | products and gradients, from samples or from moments |
//! | `moments`, `moment_solver` | [`MomentProblem`], [`solve_moments`]: fits from sums over the samples alone |
//! | `standard_errors` | of the coefficients |
//! | [`gcv`] | the smoothness by generalised cross-validation |
//! | [`denoise`] | a ridge by degree that removes noise, estimated from the targets |
//! | `report`, `assess` | what a fit reports |
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::{Directions, synthesis};
//! use spharm_monitor::Silent;
//! use spharm_solver::{LsqParams, MatrixFreeOperator, lsq};
//! use spharm_transform::TransformParams;
//!
//! // Three functions of degree 10, sampled at 600 directions, are found again.
//! let directions = Directions::fibonacci(600)?;
//! let known = Array2::from_shape_fn((121, 3), |(k, c)| ((7 * k + c) as f64).sin());
//! let targets = synthesis(&directions, known.view())?;
//!
//! let operator = MatrixFreeOperator::new(&directions, &TransformParams { max_degree: 10, ..TransformParams::default() })?;
//! let fit = lsq::solve(&operator, &targets, &LsqParams::default(), &Silent)?;
//! assert!(fit.report.optimality < 2e-10);
//! assert!((fit.coefficients.values() - &known).iter().all(|d| d.abs() < 1e-8));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

#[cfg(feature = "dense")]
mod assess;
pub mod cg;
#[cfg(feature = "dense")]
mod choice;
mod columns;
#[cfg(feature = "dense")]
mod cost;
pub mod denoise;
#[cfg(feature = "dense")]
mod factor;
pub mod gcv;
#[cfg(feature = "dense")]
mod iterate;
#[cfg(feature = "dense")]
mod moment_solver;
mod moments;
pub mod normal_equations;
#[cfg(feature = "dense")]
mod params;
pub mod preconditioner;
mod problem;
mod progress;
#[cfg(feature = "dense")]
mod refine;
#[cfg(feature = "dense")]
mod report;
mod signs;
#[cfg(feature = "dense")]
mod solver;
#[cfg(feature = "dense")]
mod standard_errors;

pub use cg::Stop;
#[cfg(feature = "dense")]
pub use cost::moments_pay;
pub use denoise::{Denoise, NoisePower};
pub use gcv::{Gcv, GcvTerms, choose_smoothness, choose_smoothness_by, choose_smoothness_by_moments};
#[cfg(feature = "dense")]
pub use moment_solver::{GroupFit, MomentFit, solve_moments, solve_moments_of_groups};
pub use moments::MomentProblem;
pub use normal_equations::NormalEquations;
#[cfg(feature = "dense")]
pub use params::{LsqParams, Strategy};
#[cfg(feature = "dense")]
pub use report::{LsqReport, LsqSeconds, LsqWarning};
#[cfg(feature = "dense")]
pub use solver::{CheckLimits, LsqFit, LsqSolver, MakeGram, MakeMoments, MomentsAndRightSides, solve};
