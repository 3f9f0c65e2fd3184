//! Real orthonormal spherical harmonics at arbitrary directions.
//!
//! A closed surface is described by three functions on the sphere, each a sum of harmonics,
//!
//! ```text
//! f(theta, phi) = sum over l <= L, |m| <= l of a_{l,m} S_{l,m}(theta, phi).
//! ```
//!
//! # Conventions
//!
//! - Degree `l` runs over `0..=L` (`L` is `max_degree`), order `m` over `-l..=l`. The basis has `K = (L + 1)^2`
//!   functions, and the function of degree l and order m is column `l^2 + l + m` ([`index`]).
//! - Colatitude `theta` in `[0, pi]`, azimuth `phi` in `[0, 2 pi)`. A [direction](Directions) is a unit vector.
//! - The canonical basis is real, orthonormal over the sphere and without the Condon-Shortley phase:
//!   `S_{l,0} = N P_l(cos theta)`, `S_{l,m} = sqrt2 N P_l^m(cos theta) cos(m phi)`,
//!   `S_{l,-m} = sqrt2 N P_l^m(cos theta) sin(m phi)` for `m > 0`,
//!   with `N^2 = (2l + 1) / (4 pi) (l - m)! / (l + m)!`.
//! - Degrees go up to [`MAX_DEGREE`]. The recurrence is scaled and no factorial is ever formed, so nothing overflows or
//!   underflows.
//!
//! Errors of values are below `1e-12 sqrt((2l + 1) / (4 pi))` at any direction, including the poles.
//!
//! # Modules
//!
//! | module | contents |
//! |---|---|
//! | [`index`] | (degree, order) to column and back |
//! | [`directions`] | unit vectors, from vertices, from angles or spread evenly |
//! | [`sweep`] | blocks `A_l` of the harmonics of degree l at a run of directions: the fast way to evaluate harmonics |
//! | [`product`] | products of a block, and of its transpose, with a few columns |
//! | [`mod@synthesis`] | coefficients to samples at any directions |
//! | [`coefficients`] | canonical coefficients, and the complex coefficients of Shen and Chung |
//! | [`quadrature`] | Gauss-Legendre rings |
//! | [`recurrence`] | the normalised Legendre recurrence and its coefficients |
//! | [`rings`] | the Legendre recurrence for one order at a time, for transforms over rings |
//! | [`polar`] | the Legendre recurrence next to the poles |
//! | [`double_double`] | arithmetic with 32 digits |
//! | [`textbook`] | a plain implementation, against which the fast implementation is tested |
//!
//! # Examples
//!
//! Evaluate a function from its coefficients:
//!
//! ```
//! use ndarray::array;
//! use spharm_harmonics::{Directions, synthesis};
//!
//! let directions = Directions::fibonacci(100)?;
//! let samples = synthesis(&directions, array![[0.0], [0.0], [1.0], [0.0]].view())?; // f = S_{1,0}
//! let z = directions.as_slice()[7][2];
//! assert!((samples[[7, 0]] - (3.0 / (4.0 * std::f64::consts::PI)).sqrt() * z).abs() < 1e-15);
//! # Ok::<(), spharm_harmonics::HarmonicsError>(())
//! ```
//!
//! Evaluate the harmonics themselves:
//!
//! ```
//! use spharm_harmonics::{Directions, Recurrence, Sweep};
//!
//! let directions = Directions::from_vertices(&[[0.0, 0.0, 2.0], [3.0, 0.0, 4.0]])?;
//! let recurrence = Recurrence::new(1)?;
//! let mut sweep = Sweep::new(&recurrence, directions.as_slice());
//! let mut a0 = vec![0.0; 2]; // (rows, 2 l + 1), column-major
//! let mut a1 = vec![0.0; 6];
//! sweep.next_degree(&mut a0);
//! sweep.next_degree(&mut a1);
//! let n1 = (3.0 / (4.0 * std::f64::consts::PI)).sqrt();
//! assert!((a1[2] - n1).abs() < 1e-15); // S_{1,0} at the north pole: column 1, row 0
//! # Ok::<(), spharm_harmonics::HarmonicsError>(())
//! ```

pub mod coefficients;
pub mod directions;
pub mod double_double;
mod duplicates;
mod error;
pub mod index;
pub mod polar;
pub mod product;
pub mod quadrature;
pub mod recurrence;
pub mod rings;
pub mod sweep;
pub mod synthesis;
pub mod textbook;

pub use coefficients::Coefficients;
pub use directions::Directions;
pub use error::HarmonicsError;
pub use index::{basis_size, column};
pub use quadrature::{GaussLegendre, gauss_legendre};
pub use recurrence::{MAX_DEGREE, Recurrence};
pub use sweep::Sweep;
pub use synthesis::synthesis;
