//! Computes tangent fields on the sphere from harmonic potentials, the adjoint of this computation, and steps along
//! fields.
//!
//! The potentials A and B are sums of harmonics of degrees 1 to D. Their field is the sum of a gradient and a curl,
//!
//! ```text
//! w = grad A + u x grad B = -u x L A + L B,    L f = u x grad f
//! ```
//!
//! so it is computed by synthesis of `L_k A` and `L_k B` ([`derivatives`](crate::derivatives)), without a tangent
//! frame and its singularities. By Helmholtz's decomposition, every smooth field is such a sum. Because the operators
//! are antisymmetric, the adjoint for covectors g at the directions is
//!
//! ```text
//! d/dA = -sum_k L_k S^T (u x g)_k,    d/dB = -sum_k L_k S^T g_k,    S^T adjoint synthesis
//! ```
//!
//! A step is the exponential map, `exp(w)(u) = cos|w| u + sin|w| w / |w|`: it moves directions along great circles.
//!
//! Cost: a synthesis or an adjoint synthesis of six functions of degree D.

use ndarray::Array2;
use spharm_surface::geometry::{Vec3, add, cross, dot, scale, unit};
use spharm_transform::Transform;

use crate::derivatives::{generators, rotational_derivatives};
use crate::error::ShapeError;
use crate::geometry::side_by_side;

/// Returns the field at the directions `at`. The columns of `potentials` (K, 2) are the coefficients of the potentials
/// A and B (see the [module](self)). `transform` must be planned for these directions and for the potentials' degree.
pub(super) fn field(potentials: &Array2<f64>, at: &[Vec3], transform: &Transform) -> Result<Vec<Vec3>, ShapeError> {
    let samples = transform.synthesis(side_by_side(&rotational_derivatives(potentials.view())?).view())?;
    let rows = samples.rows().into_iter().zip(at);
    Ok(rows.map(|(row, &u)| add(cross([row[0], row[2], row[4]], u), [row[1], row[3], row[5]])).collect())
}

/// Returns the derivatives (K, 2) of `sum_u covectors . field` with respect to the potentials.
pub(super) fn adjoint(covectors: &[Vec3], at: &[Vec3], transform: &Transform) -> Result<Array2<f64>, ShapeError> {
    let mut samples = Array2::zeros((at.len(), 6));
    for ((mut row, &g), &u) in samples.rows_mut().into_iter().zip(covectors).zip(at) {
        let turned = cross(u, g);
        (0..3).for_each(|k| (row[2 * k], row[2 * k + 1]) = (turned[k], g[k]));
    }
    let sums = transform.adjoint_synthesis(samples.view())?;
    let mut found = Array2::zeros((sums.nrows(), 2));
    for axis in 0..3 {
        let pairs: Vec<[f64; 2]> = sums.rows().into_iter().map(|row| [row[2 * axis], row[2 * axis + 1]]).collect();
        for (mut row, derivative) in found.rows_mut().into_iter().zip(&generators(&pairs)[axis]) {
            (0..2).for_each(|c| row[c] -= derivative[c]);
        }
    }
    Ok(found)
}

/// Moves the directions `at` by the exponential map `exp(t w)` of the field w.
pub(super) fn step(at: &[Vec3], field: &[Vec3], t: f64) -> Vec<Vec3> {
    let along = |(&u, &w): (&Vec3, &Vec3)| {
        let w = scale(w, t);
        let angle = dot(w, w).sqrt();
        // For a tiny angle, the limit 1 of sin(angle) / angle is accurate to rounding error.
        let ratio = if angle > 1e-8 { angle.sin() / angle } else { 1.0 };
        unit(add(scale(u, angle.cos()), scale(w, ratio)))
    };
    at.iter().zip(field).map(along).collect()
}
