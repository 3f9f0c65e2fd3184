//! The rows of the full least squares: the vertices, or samples of the whole surface.

use std::ops::Range;

use ndarray::{Array2, ArrayView2, s};
use spharm_harmonics::Directions;
use spharm_solver::{LsqFit, ResidualNorms};
use spharm_surface::Sphere;
use spharm_surface::samples::{SphereSamples, SphereSampling};
use spharm_transform::{Transform, TransformParams};

use super::batches::Batch;
use super::job::Job;
use crate::{Error, FitParams, defaults};

/// How a surface is sampled for models of a degree.
pub(crate) struct Sampling {
    sampling: SphereSampling,
}

impl Sampling {
    /// # Errors
    ///
    /// [`Error::NeedsTriangles`].
    pub(crate) fn new(job: &Job<'_>) -> Result<Self, Error> {
        let (sphere, spacing) = (job.sphere, spacing(job.params));
        if sphere.faces.is_empty() {
            return Err(Error::NeedsTriangles { what: "a fit of the surface", sphere: sphere.name().to_owned() });
        }
        Ok(Self { sampling: SphereSampling::new(&sphere.directions, &sphere.faces, spacing)? })
    }

    /// Returns their number.
    pub(crate) fn samples(&self) -> usize {
        self.sampling.samples(self.all())
    }

    fn all(&self) -> Range<usize> {
        0..self.sampling.triangles()
    }
}

/// Returns the distance of samples for a fit, in radians.
fn spacing(params: &FitParams) -> f64 {
    defaults::SAMPLE_SPACING / params.max_degree.max(1) as f64
}

/// What the least squares is over.
pub(crate) struct Rows<'a> {
    sphere: &'a Sphere,
    weights: Option<Vec<f64>>,
    surface: Option<Surface>,
}

/// Samples of a surface, and its vertices, where the fit is assessed as well.
struct Surface {
    sampling: Sampling,
    directions: Directions,
    vertices: Transform,
}

impl<'a> Rows<'a> {
    /// The vertices.
    pub(crate) fn vertices(job: &Job<'a>) -> Self {
        Self { sphere: job.sphere, weights: job.weights.clone(), surface: None }
    }

    /// Samples of all triangles. Their weights are solid angles times what the vertices count, scaled to the sum that the
    /// vertices' weights have: a smoothness penalty then means the same for a surface as for its vertices.
    pub(crate) fn surface(job: &Job<'a>, sampling: Sampling, transform: &TransformParams) -> Result<Self, Error> {
        let sphere = job.sphere;
        let SphereSamples { directions, mut weights } = sampling.sampling.at(&sphere.directions, sampling.all())?;
        let mut total = sphere.directions.len() as f64;
        if let Some(of_vertices) = &job.weights {
            let column = ArrayView2::from_shape((of_vertices.len(), 1), of_vertices).expect("a list is a column");
            let at_samples = sampling.sampling.interpolate(column, sampling.all());
            weights.iter_mut().zip(&at_samples).for_each(|(weight, factor)| *weight *= factor);
            total = of_vertices.iter().sum();
        }
        let factor = total / weights.iter().sum::<f64>();
        weights.iter_mut().for_each(|weight| *weight *= factor);
        let vertices = Transform::new(&sphere.directions, transform)?;
        Ok(Self { sphere, weights: Some(weights), surface: Some(Surface { sampling, directions, vertices }) })
    }

    /// Returns their directions.
    pub(crate) fn directions(&self) -> &Directions {
        self.surface.as_ref().map_or(&self.sphere.directions, |surface| &surface.directions)
    }

    /// Returns what each counts; all the same where there are none.
    pub(crate) fn weights(&self) -> Option<&[f64]> {
        self.weights.as_deref()
    }

    /// Returns a batch's targets there, (rows, columns).
    pub(crate) fn targets(&self, batch: &Batch) -> Array2<f64> {
        let Some(Surface { sampling, .. }) = &self.surface else { return batch.side_by_side() };
        let mut all = Array2::zeros((sampling.samples(), batch.columns()));
        for (group, target) in batch.targets() {
            all.slice_mut(s![.., group]).assign(&sampling.sampling.interpolate(target, sampling.all()));
        }
        all
    }

    /// Returns each target's residual at the vertices.
    pub(crate) fn at_vertices(&self, batch: &Batch, fit: &LsqFit) -> Result<Vec<ResidualNorms>, Error> {
        let Some(Surface { vertices, .. }) = &self.surface else { return Ok(fit.report.residuals.clone()) };
        let of = |(group, target): (Range<usize>, ArrayView2<'_, f64>)| {
            let model = vertices.synthesis(fit.coefficients.values().slice(s![.., group]))?;
            Ok(ResidualNorms::of((&target - &model).view()))
        };
        batch.targets().map(of).collect()
    }
}
