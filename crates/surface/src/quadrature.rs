//! Healy's way to coefficients: the surface resampled to a Gauss-Legendre grid, and analysis by exact quadrature.
//!
//! On L + 1 Gauss-Legendre rings of 2 L + 2 azimuths the coefficients of a function of degree L are the sums of its values
//! there times S_{l,m} and weights, without any solving. What that fits is the surface between the vertices, linear over the
//! sphere's triangles, in place of the vertices alone: it neither sees nor minimises the distances there, and what the
//! surface has above degree L is aliased into the coefficients. D. M. Healy, D. N. Rockmore, P. J. Kostelec and S. Moore,
//! "FFTs for the 2-sphere: improvements and variations", J. Fourier Anal. Appl. 9 (2003).

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::{Directions, gauss_legendre};
use spharm_transform::{FINEST, Transform, TransformError, TransformParams};

use crate::sphere_locator::SphereLocator;
use crate::{Mesh, SurfaceError};

/// What can go wrong in a fit by quadrature.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum QuadratureError {
    /// The sphere can't be interpolated over.
    #[error(transparent)]
    Surface(#[from] SurfaceError),
    /// The degree is refused.
    #[error(transparent)]
    Transform(#[from] TransformError),
}

/// Quadrature over one sphere, to one degree.
pub struct Quadrature {
    locator: SphereLocator,
    grid: Directions,
    /// Of the grid's directions, for integrals over the sphere.
    weights: Vec<f64>,
    analysis: Transform,
}

impl Quadrature {
    /// For the triangles of a sphere.
    ///
    /// # Errors
    ///
    /// Those of [`SphereLocator::new`]; a degree above [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE).
    pub fn new(sphere: &Mesh, max_degree: usize) -> Result<Self, QuadratureError> {
        if max_degree > spharm_harmonics::MAX_DEGREE {
            let max = spharm_harmonics::MAX_DEGREE;
            let refused = spharm_harmonics::HarmonicsError::DegreeTooHigh { degree: max_degree, max };
            return Err(TransformError::from(refused).into());
        }
        let locator = SphereLocator::new(sphere)?;
        let (grid, weights) = gauss_legendre_grid(max_degree)?;
        let params = TransformParams { max_degree, accuracy: FINEST, channels: 6 };
        let analysis = Transform::new(&grid, &params)?;
        Ok(Self { locator, grid, weights, analysis })
    }

    /// Rings and azimuths of the grid.
    pub fn grid(&self) -> [usize; 2] {
        let rings = self.analysis.max_degree() + 1;
        [rings, 2 * rings]
    }

    /// Canonical coefficients, (K, c), of values on the sphere's vertices, (n, c).
    ///
    /// # Errors
    ///
    /// [`SurfaceError::NotCovered`] where the sphere has holes, [`SurfaceError::LengthMismatch`].
    pub fn fit(&self, values: ArrayView2<'_, f64>) -> Result<Array2<f64>, QuadratureError> {
        let mut samples = self.locator.interpolate(values, self.grid.as_slice())?;
        for (mut row, weight) in samples.rows_mut().into_iter().zip(&self.weights) {
            row *= *weight;
        }
        Ok(self.analysis.adjoint_synthesis(samples.view())?)
    }
}

/// Directions of the grid, ring after ring, and their weights.
fn gauss_legendre_grid(max_degree: usize) -> Result<(Directions, Vec<f64>), TransformError> {
    let rings = gauss_legendre(max_degree + 1);
    let around = 2 * max_degree + 2;
    let (mut vectors, mut weights) = (Vec::new(), Vec::new());
    for j in 0..rings.len() {
        for k in 0..around {
            let (sine, cosine) = (std::f64::consts::TAU * k as f64 / around as f64).sin_cos();
            vectors.push([rings.sines[j] * cosine, rings.sines[j] * sine, rings.cosines[j]]);
            weights.push(rings.weights[j] * std::f64::consts::TAU / around as f64);
        }
    }
    Ok((Directions::from_vertices(&vectors)?, weights))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;

    /// Quadrature itself is exact: on the grid's own values the coefficients come back.
    #[test]
    fn analysis_is_exact_on_the_grid() {
        let max_degree = 17;
        let (grid, weights) = gauss_legendre_grid(max_degree).unwrap();
        let known = Array2::from_shape_fn((324, 2), |(k, c)| ((k * 3 + c) as f64).sin());
        let mut samples = spharm_harmonics::synthesis(&grid, known.view()).unwrap();
        for (mut row, weight) in samples.rows_mut().into_iter().zip(&weights) {
            row *= *weight;
        }
        let params = TransformParams { max_degree, accuracy: FINEST, channels: 2 };
        let found = Transform::new(&grid, &params).unwrap().adjoint_synthesis(samples.view()).unwrap();
        assert!((found - known).iter().all(|d| d.abs() < 1e-11));
    }

    /// Interpolation over triangles is of second order: sixteen times as many vertices, a sixteenth of the error.
    #[test]
    fn the_error_is_that_of_linear_interpolation() {
        let known = Array2::from_shape_fn((16, 1), |(k, _)| (k as f64).cos());
        let error = |subdivisions| {
            let sphere = icosphere(subdivisions);
            let directions = Directions::from_vertices(&sphere.vertices).unwrap();
            let values = spharm_harmonics::synthesis(&directions, known.view()).unwrap();
            let found = Quadrature::new(&sphere, 3).unwrap().fit(values.view()).unwrap();
            (found - &known).iter().fold(0.0f64, |a, d| a.max(d.abs()))
        };
        let (coarse, fine) = (error(4), error(6));
        assert!(fine < 0.001 && coarse / fine > 12.0 && coarse / fine < 20.0, "{coarse} {fine}");
    }
}
