//! Exact least squares, by products with the basis and the Gram matrix alone.
//!
//! | module | what |
//! |---|---|
//! | [`solve`] | which way is gone: iterations, a factor, a shifted one |
//! | [`cg`] | preconditioned conjugate gradients on the normal equations |
//! | [`preconditioner`] | approximate inverses |
//! | [`gcv`] | the smoothness by generalised cross-validation |
//! | [`gram`] | the Gram matrix of a sampling, from its moments |

pub mod cg;
pub(crate) mod columns;
pub mod gcv;
pub mod gram;
pub mod preconditioner;
pub mod solve;

pub use gcv::{Gcv, choose_smoothness};
pub use gram::{moment_gram, moment_gram_bytes};
pub use solve::{LsqEvent, LsqFit, LsqParams, LsqReport, LsqSolver, MakeGram, Way};
