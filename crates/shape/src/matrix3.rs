//! Functions on 3 x 3 matrices and vectors.

pub use spharm_surface::matrix3::Matrix3;
pub(crate) use spharm_surface::matrix3::{IDENTITY, determinant, product, transposed};

/// Returns the dot product of two vectors.
pub(crate) fn dot(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    spharm_surface::geometry::dot(*a, *b)
}
