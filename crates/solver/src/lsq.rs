//! Solves the full least-squares problem by conjugate gradients or, if these converge too slowly, by a Cholesky factor
//! of the normal equations.
//!
//! ```text
//! min | W^(1/2) (A x - f) |^2 + x^T P x,   P = lambda diag (l (l + 1))^2 + diag p_l
//! ```
//!
//! for each column f of the targets, with the basis A (n, K), the weights W, the smoothness lambda and the penalty p_l
//! of each degree l. This is the method NLSF of Shen and Chung, but A isn't stored. There are three ways to solve the
//! problem:
//!
//! - Conjugate gradients ([`cg`]) with fast operators. On an even sampling the normal matrix `N = A^T W A + P` is
//!   nearly a multiple of the identity, so a few iterations suffice. Products with N are computed from the samples, or
//!   from moments of the sampling ([`MomentProblem`]). The cost of a product from moments doesn't depend on the number
//!   of samples. Products from moments process three columns at a time. If moments are used and the sampling is uneven,
//!   the inverse of the sampling density serves as a preconditioner, see
//!   [`InverseDensity`](spharm_transform::InverseDensity). At the end the gradient is recomputed from the samples,
//!   unless its errors are estimated to be small. If the recomputed gradient misses the tolerance, the iteration is
//!   resumed.
//! - A Cholesky factor of N, computed from the Gram matrix or read from a store, and refinement: `x += N^-1 g` with the
//!   gradient `g = A^T W (f - A x) - P x` computed by the operator, until the optimality `|g| / |A^T W f|` meets the
//!   tolerance or stops improving.
//! - If N is numerically singular, the factor of `N + mu I` and iterated Tikhonov regularisation,
//!   `x += (N + mu I)^-1 g`. From x = 0 this iteration tends to a solution of small norm. Components that the targets
//!   determine too poorly compared with `mu` stay small instead of growing to 1e11. Because of rounding errors, the
//!   iteration doesn't reach the minimum norm, so this method isn't used if there are fewer rows with nonzero weight
//!   than coefficients. A. Bjorck, "Numerical methods for least squares problems" (1996), section 4.1.3.
//!
//! The module `strategy` chooses the methods, their order and their durations. From the problem's sizes, the available
//! data and the request, its function `choose` derives a list of steps. A table in that module documents the choice.
//! [`Strategy::Auto`] iterates first, by moments if they pay off, and switches from iterations to a factor if the
//! factor seems faster. The plan is logged as a detail; the report contains the steps taken ([`StepReport`]) and the
//! accuracy of the result.
//!
//! | module | contents |
//! |---|---|
//! | `strategy`, `limits`, `cost`, `plan` | the choice of steps, and its constants |
//! | `params`, `solver`, `available`, `run`, `progress` | [`LsqParams`], [`LsqSolver`]: execution of the steps |
//! | [`normal_equations`], [`cg`], [`preconditioner`] | conjugate gradients |
//! | `factor`, `refine` | the factor of N, shifted if N is singular; refinement with it |
//! | `problem` | products and gradients, from samples or from moments |
//! | `moments`, `moment_solver` | [`MomentProblem`], [`solve_moments`]: fits from sums over the samples |
//! | `standard_errors` | standard errors of the coefficients |
//! | [`gcv`] | choice of the smoothness by generalised cross-validation |
//! | [`denoise`] | a ridge by degree that removes noise, estimated from the targets |
//! | `report`, `assess` | reports on fits |
//!
//! ```
//! use ndarray::Array2;
//! use spharm_harmonics::{Directions, synthesis};
//! use spharm_monitor::Silent;
//! use spharm_solver::{LsqParams, MatrixFreeOperator, lsq};
//! use spharm_transform::TransformParams;
//!
//! // The fit recovers three functions of degree 10 from samples at 600 directions.
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
#[cfg(feature = "dense")]
mod available;
pub mod cg;
mod columns;
#[cfg(feature = "dense")]
mod cost;
pub mod denoise;
#[cfg(feature = "dense")]
mod factor;
pub mod gcv;
#[cfg(feature = "dense")]
mod limits;
#[cfg(feature = "dense")]
mod moment_solver;
mod moments;
pub mod normal_equations;
#[cfg(feature = "dense")]
mod params;
#[cfg(feature = "dense")]
mod plan;
pub mod preconditioner;
mod problem;
mod progress;
#[cfg(feature = "dense")]
mod refine;
#[cfg(feature = "dense")]
mod report;
#[cfg(feature = "dense")]
mod run;
mod signs;
#[cfg(feature = "dense")]
mod smoothness;
#[cfg(feature = "dense")]
mod solver;
#[cfg(feature = "dense")]
mod standard_errors;
#[cfg(feature = "dense")]
mod strategy;
#[cfg(feature = "dense")]
mod why;

pub use cg::Stop;
#[cfg(feature = "dense")]
pub use cost::{moment_accuracy, moments_pay};
pub use denoise::{Denoise, NoisePower};
pub use gcv::{Gcv, GcvTerms, PROBES, choose_smoothness_by, choose_smoothness_by_moments};
#[cfg(feature = "dense")]
pub use moment_solver::{GroupFit, MomentFit, determined, solve_moments, solve_moments_of_groups};
pub use moments::MomentProblem;
pub use normal_equations::NormalEquations;
#[cfg(feature = "dense")]
pub use params::{LsqParams, Strategy};
#[cfg(feature = "dense")]
pub use report::{LsqReport, LsqSeconds, LsqWarning, StepReport};
#[cfg(feature = "dense")]
pub use solver::{CheckLimits, LsqFit, LsqSolver, MakeGram, MakeMoments, MomentsAndRightSides, solve};
