//! Stores the Cholesky factor of a scheme's normal equations in one immutable file beside the scheme's basis.
//!
//! G = A^T diag(w) A + lambda diag((l (l + 1))^2), (K, K) with K = (L + 1)^2 columns in the order l^2 + l + m, is
//! symmetric and, on a sampling that determines the coefficients, positive definite: G = C C^T with C lower triangular.
//! Computing C costs K^3 / 3 flops, once. With C, fitting another surface on the same scheme costs 2 K^2 flops per
//! channel. See "A factor" in `store-format.md`.
//!
//! The file is a container like a basis file. Its parts are the tiles of C's lower triangle by tile column, so that
//! each of the two triangular solves reads the file sequentially.
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
