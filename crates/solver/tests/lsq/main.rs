//! Tests of the full least squares: every strategy gives the solution of the dense problem, and undetermined components
//! stay small.

mod denoise;
mod factors;
mod gcv;
mod large_means;
mod moments;
mod preconditioned;
mod problems;
mod refusals;
mod singular;
mod standard_errors;
mod strategies;
