//! Stores the Cholesky factor of a scheme's normal equations in one immutable file in the scheme's folder.
//!
//! The normal matrix G = A^T diag(w) A + lambda diag((l (l + 1))^2) is made of the harmonics A (n, K) at the scheme's n
//! directions, the weights w (n) of the directions, and the smoothness lambda. G has K = (L + 1)^2 rows and columns, in
//! the order l^2 + l + m. G is symmetric and, if the sampling determines the coefficients, positive definite: G = C C^T
//! with C lower triangular. Computing C takes K^3 / 3 flops, once. With C, each channel of another surface on the same
//! scheme takes 2 K^2 flops. See "A factor" in `store-format.md`.
//!
//! The file has the same container format as a basis file. Its parts are the tiles of C's lower triangle, one tile
//! column after another, so that each of the two triangular solves reads the file sequentially.
//!
//! | module | contents |
//! |---|---|
//! | `spec` | identity of a factor: scheme, degree, weights, smoothness; its name |
//! | `grid` | the tiles of a triangle |
//! | `header` | the contents of a file |
//! | `reader` | an open factor and windows on its tile columns |
//! | `writer` | a factor being written |
//! | `find` | the factors of a scheme: listing, opening and starting them |

mod find;
mod grid;
mod header;
mod reader;
mod spec;
mod writer;

pub use find::{FoundFactor, StartedFactor, check_factor_space, factors, open_factor, start_factor};
pub use grid::TileGrid;
pub use header::{Condition, FactorHeader};
pub use reader::{FactorFile, TileValues, TileWindow};
pub use spec::{FactorSpec, WeightsHash};
pub use writer::FactorWriter;
