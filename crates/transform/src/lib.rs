//! Fast synthesis and adjoint synthesis of spherical harmonics at scattered directions.
//!
//! Conventions are those of [`spharm_harmonics`]. With A the basis matrix, (n, K), [`Transform`] gives `A x`, `A^T r` and
//! `A^T diag(w) A x` without it, for all columns of x at once, to a relative accuracy of choice:
//!
//! ```text
//! coefficients --Legendre sums--> rings --Fourier--> oversampled grid --interpolation--> samples
//! ```
//!
//! at `L^3 / 4 + O(M^2 log M) + O(w^2 n)` products a channel in place of `K n`. M. Reinecke, S. Belkner, J. Carron,
//! "Improved cosmic microwave background (de-)lensing using general spherical harmonic transforms", A&A 678 (2023),
//! describe the way. Adjoint synthesis is the transpose of synthesis step by step.
//!
//! # Map
//!
//! | module | what |
//! |---|---|
//! | [`transform`] | the plan, and the transforms |
//! | `either` | synthesis by whichever way is faster |
//! | `legendre` | coefficients to rings and back |
//! | `polar` | the Legendre recurrence next to the poles |
//! | `fourier` | rings to the oversampled grid and back |
//! | `kernel` | the interpolation kernel |
//! | `grid` | interpolation at the directions and spreading from them |
//! | `points` | the directions, sorted |
//! | `shape` | the choice of grid and kernel |
//! | [`gram`] | the Gram matrix of the basis at scattered weighted directions, from their moments |
//!
//! ```
//! use ndarray::array;
//! use spharm_harmonics::Directions;
//! use spharm_transform::{Transform, TransformParams};
//!
//! let directions = Directions::from_vertices(&[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])?;
//! let transform = Transform::new(&directions, &TransformParams { max_degree: 1, ..Default::default() })?;
//! // f = S_{1,0}, which is proportional to z.
//! let samples = transform.synthesis(array![[0.0], [0.0], [1.0], [0.0]].view())?;
//! let n1 = (3.0 / (4.0 * std::f64::consts::PI)).sqrt();
//! assert!((samples[[0, 0]] - n1).abs() < 1e-12 && samples[[1, 0]].abs() < 1e-12);
//! # Ok::<(), spharm_transform::TransformError>(())
//! ```

mod either;
mod error;
mod fourier;
pub mod gram;
mod grid;
mod kernel;
mod legendre;
mod points;
mod polar;
mod shape;
pub mod transform;

pub use either::synthesis;
pub use error::TransformError;
pub use gram::MomentGram;
pub use shape::{COARSEST, FINEST};
pub use transform::{SortedWeights, Transform, TransformParams};
