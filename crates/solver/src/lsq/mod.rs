//! Exact least squares, by iteration on the normal equations.

pub mod cg;
pub(crate) mod columns;
pub mod preconditioner;
