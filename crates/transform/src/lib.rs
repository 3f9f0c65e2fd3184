//! Fast synthesis and adjoint synthesis of spherical harmonics at scattered directions.
//!
//! Conventions are those of [`spharm_harmonics`]. With A the basis matrix (n, K), a [`Transform`] computes synthesis `A
//! x`, adjoint synthesis `A^T r` and the normal operator `A^T diag(w) A x` without forming A, for all columns of x at
//! once and to a chosen relative accuracy:
//!
//! ```text
//! coefficients --Legendre sums--> rings --Fourier--> oversampled grid --interpolation--> samples
//! ```
//!
//! The cost per channel is `L^3 / 4 + O(M^2 log M) + O(w^2 n)` products instead of `K n`, for an oversampled grid of M
//! points around the sphere and an interpolation kernel w points wide. The method is that of M. Reinecke, S. Belkner
//! and J. Carron, "Improved cosmic microwave background (de-)lensing using general spherical harmonic transforms", A&A
//! 678 (2023). Adjoint synthesis is the transpose of synthesis step by step.
//!
//! A [`MomentOperator`] applies the normal operator `A^T diag(w) A` using moments of the weights, and a [`MomentGram`]
//! computes the matrix itself. Neither cost depends on n.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`transform`] | the plan of a transform, and its methods |
//! | [`moments`] | the normal operator of scattered weighted directions, from their moments |
//! | [`gram`] | the Gram matrix of scattered weighted directions, from their moments |
//! | [`accumulator`] | moments and right-hand sides of samples that arrive in chunks |
//! | [`nodal`] | moments and right-hand sides of samples that are linear in values at nodes, for many sets of values |
//! | `either` | [`synthesis`]: direct sums or a transform, whichever is faster |
//! | `gridding` | the choice of grid size and kernel width |
//! | `legendre` | coefficients to rings and back |
//! | `ring_table`, `ring_sums` | inner loops of `legendre`: Legendre values on a block of rings, and sums with them |
//! | `polar_rings` | the Legendre recurrence next to the poles |
//! | `degree_pairs` | the Legendre recurrence over pairs of degrees, away from poles and equator |
//! | `fourier` | rings to the oversampled grid and back |
//! | `grid` | the layout of the oversampled grid and its margins |
//! | `cells`, `points` | the cells of directions; directions sorted by cell |
//! | `kernel` | the interpolation kernel |
//! | `interpolation`, `interpolation_batch`, `interpolation_cells` | grid to directions and back, and the inner loops |
//! | `batch` | the kernel values of a batch of directions |
//! | `workspace` | working memory of calls and threads |
//! | `lanes` | short arrays in vector registers |
//!
//! # Example
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

pub mod accumulator;
mod batch;
mod cells;
mod degree_pairs;
mod either;
mod error;
pub mod fft;
mod fourier;
pub mod gram;
mod grid;
mod gridding;
mod interpolation;
mod interpolation_batch;
mod interpolation_cells;
mod kernel;
mod lanes;
mod legendre;
pub mod moments;
pub mod nodal;
mod params;
mod points;
mod polar_rings;
mod pool;
mod ring_sums;
mod ring_table;
mod sorting;
pub mod transform;
mod workspace;

pub use accumulator::{Accumulated, Accumulator, Occupied, SumsSeconds};
pub use either::synthesis;
pub use error::TransformError;
pub use gram::MomentGram;
pub use gridding::{COARSEST, FINEST};
pub use moments::{InverseDensity, MomentOperator, SampleSums};
pub use nodal::{NodalSamples, NodalSums, NodalSumsBuilder};
pub use params::TransformParams;
pub use transform::{SortedWeights, Transform};
