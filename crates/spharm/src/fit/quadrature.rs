//! Computes coefficients by quadrature: the surface is resampled on a Gauss-Legendre grid, where the analysis is
//! exact.
//!
//! On a grid of L + 1 Gauss-Legendre rings with 2 L + 2 azimuths each, the coefficients of a function of degree L are
//! weighted sums, over the grid, of the function's values times the harmonics S_{l,m}. No equations are solved. The
//! method fits the surface, which is linear on the sphere's triangles, rather than the vertices alone. Quadrature
//! doesn't minimise the distances at the vertices, and the surface's part above degree L is aliased into the
//! coefficients. D. M. Healy, D. N. Rockmore, P. J. Kostelec and S. Moore, "FFTs for the 2-sphere: improvements and
//! variations", J. Fourier Anal. Appl. 9 (2003).

use std::ops::Range;
use std::time::Instant;

use ndarray::{Array2, ArrayView2, s};
use spharm_harmonics::{Directions, MAX_DEGREE, gauss_legendre};
use spharm_monitor::Stage;
use spharm_solver::ResidualNorms;
use spharm_surface::Mesh;
use spharm_surface::locator::SphereLocator;
use spharm_transform::Transform;

use super::batches::{Run, Solved};
use super::lsq_plan::{Sizes, quadrature_readers, quadrature_transform};
use crate::Error;
use crate::report::BatchReport;

/// Fits all targets, one after another.
pub(crate) fn run<T: Send, E: From<Error> + Send>(run: &mut Run<'_, T, E>) -> Result<(), E> {
    let (sphere, max_degree, monitor) = (run.job.sphere, run.job.params.max_degree, run.monitor);
    if sphere.faces.is_empty() {
        return Err(Error::NeedsTriangles { what: "quadrature", sphere: sphere.name().to_owned() }.into());
    }
    let mark = Instant::now();
    let channels = run.channels();
    let sizes =
        Sizes { vertices: sphere.directions.len(), faces: sphere.faces.len(), max_degree, channels, denoise: false };
    run.readers = quadrature_readers(sizes, run.job.memory, run.job.threads)?;
    let quadrature = Quadrature::new(&sphere.to_mesh(), max_degree)?;
    let vertices = Transform::new(&sphere.directions, &quadrature_transform(max_degree)).map_err(Error::from)?;
    run.seconds.plan += mark.elapsed().as_secs_f64();
    monitor.begin(Stage::counted("fit", "surfaces"), run.count as u64);
    run.each_batch(channels, |_, batch| {
        let targets = batch.side_by_side();
        let coefficients = quadrature.fit(targets.view())?;
        let residual = &targets - &vertices.synthesis(coefficients.view())?;
        let of = |group: &Range<usize>| ResidualNorms::of(residual.slice(s![.., group.clone()]));
        let residuals: Vec<ResidualNorms> = batch.groups.iter().map(of).collect();
        monitor.step(batch.groups.len() as u64);
        Ok(Solved {
            coefficients,
            sweeps: vec![(false, residuals.clone())],
            standard_errors: None,
            denoised: Vec::new(),
            surface_distances: Vec::new(),
            warnings: Vec::new(),
            per_target: Vec::new(),
            at_centres: Vec::new(),
            report: BatchReport::Quadrature { max_degree, grid: quadrature.grid(), residuals },
        })
    })?;
    monitor.end();
    Ok(())
}

/// Quadrature over one sphere, for models of one degree.
pub struct Quadrature {
    locator: SphereLocator,
    grid: Directions,
    /// Weights of the grid's directions in integrals over the sphere.
    weights: Vec<f64>,
    analysis: Transform,
}

impl Quadrature {
    /// Prepares quadrature over the triangles of a sphere.
    ///
    /// # Errors
    ///
    /// The errors of [`SphereLocator::new`]; [`Error::Degree`] if the degree is above [`MAX_DEGREE`].
    pub fn new(sphere: &Mesh, max_degree: usize) -> Result<Self, Error> {
        if max_degree > MAX_DEGREE {
            return Err(Error::Degree { found: max_degree, most: MAX_DEGREE });
        }
        let locator = SphereLocator::new(sphere)?;
        let (grid, weights) = gauss_legendre_grid(max_degree)?;
        let analysis = Transform::new(&grid, &quadrature_transform(max_degree))?;
        Ok(Self { locator, grid, weights, analysis })
    }

    /// Returns the numbers of rings and azimuths of the grid.
    pub fn grid(&self) -> [usize; 2] {
        let rings = self.analysis.max_degree() + 1;
        [rings, 2 * rings]
    }

    /// Returns the canonical coefficients (basis functions x channels) of `values` (vertices x channels).
    ///
    /// # Errors
    ///
    /// [`NotCovered`](spharm_surface::SurfaceError::NotCovered) if the sphere has holes,
    /// [`LengthMismatch`](spharm_surface::SurfaceError::LengthMismatch) if the number of rows isn't the number of
    /// vertices.
    pub fn fit(&self, values: ArrayView2<'_, f64>) -> Result<Array2<f64>, Error> {
        let mut samples = self.locator.interpolate(values, self.grid.as_slice())?;
        for (mut row, weight) in samples.rows_mut().into_iter().zip(&self.weights) {
            row *= *weight;
        }
        Ok(self.analysis.adjoint_synthesis(samples.view())?)
    }
}

/// Returns the directions of the grid, ring by ring, and their weights.
fn gauss_legendre_grid(max_degree: usize) -> Result<(Directions, Vec<f64>), Error> {
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
    use spharm_surface::generate::icosphere;
    use spharm_transform::{FINEST, TransformParams};

    /// Quadrature itself is exact: it recovers a model's coefficients from the model's values on the grid.
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

    /// Interpolation over triangles is of second order: with sixteen times as many vertices, the error is a sixteenth.
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
