//! Computes the data of surface fits: sums over samples of all triangles and over the vertices of seams.
//!
//! If memory allows, samples are sorted by the vertices from which they are interpolated, once for all surfaces over a
//! sphere ([`NodalSums`]). Otherwise triangles are sampled run by run, again for each batch of surfaces, and the
//! samples are discarded after they have been added. The choice depends on the sphere, the degree and the budget, not
//! on the surfaces or their number: a surface has the same model whether it is fitted alone or together with other
//! surfaces.

use std::f64::consts::PI;
use std::ops::Range;

use ndarray::{Array2, ArrayView2, Axis, aview1, s};
use rayon::prelude::*;
use spharm_monitor::Monitor;
use spharm_surface::Sphere;
use spharm_surface::samples::{SphereSamples, SphereSampling};
use spharm_transform::{Accumulator, NodalSamples, NodalSums, NodalSumsBuilder, SampleSums};

use super::job::Job;
use super::seam::SeamVertices;
use super::surface_plan::{NODAL_RUN, RUN, SurfacePlan};
use crate::{Error, FitParams};

/// Number of vertices whose values one parallel task copies.
const ROWS: usize = 1024;

/// Computes the sums for surfaces over one sphere.
pub(crate) struct SurfaceSums<'a> {
    sphere: &'a Sphere,
    params: &'a FitParams,
    /// Weights of the n vertices.
    weights: Option<Vec<f64>>,
    /// Reciprocals of the weights of the n vertices; infinite for weights of 0.
    reciprocals: Option<Vec<f64>>,
    sampling: SphereSampling,
    /// The surface's seams; `None` when denoising, so that noise at the seams' vertices isn't fitted closely.
    seam: Option<SeamVertices>,
    nodal: Option<Nodal>,
}

/// Samples sorted by vertex.
struct Nodal {
    sums: NodalSums,
    /// Total weight of the seams' vertices.
    of_seam: f64,
    /// Bytes of the patches of the grid that [`NodalSums::keep`] stores for all batches; 0 if none are stored.
    kept: usize,
}

impl<'a> SurfaceSums<'a> {
    pub(crate) fn new(job: &Job<'a>) -> Result<Self, Error> {
        let (sphere, params) = (job.sphere, job.params);
        if sphere.faces.is_empty() {
            return Err(Error::NeedsTriangles { what: "a fit of the surface", sphere: sphere.name().to_owned() });
        }
        let max_degree = params.max_degree;
        if let Some(weights) = &job.weights {
            let counts = |face: &[u32; 3]| face.iter().all(|&v| weights.get(v as usize).is_some_and(|w| *w > 0.0));
            if !sphere.faces.iter().any(counts) {
                return Err(Error::NoTriangle { name: params.weights.name().to_owned() });
            }
        }
        Ok(Self {
            sphere,
            params,
            weights: job.weights.clone(),
            reciprocals: job.weights.as_ref().map(|weights| weights.iter().map(|weight| weight.recip()).collect()),
            sampling: SphereSampling::for_degree(&sphere.directions, &sphere.faces, max_degree)?,
            seam: SeamVertices::of(sphere, max_degree).filter(|_| !params.denoise),
            nodal: None,
        })
    }

    /// Returns the number of vertices.
    pub(crate) fn vertices(&self) -> usize {
        self.sphere.directions.len()
    }

    /// Returns the weights of the vertices, if there are any.
    pub(crate) fn weights(&self) -> Option<&[f64]> {
        self.weights.as_deref()
    }

    /// Returns the number of samples.
    pub(crate) fn samples(&self) -> usize {
        self.sampling.samples(0..self.sphere.faces.len())
    }

    /// Returns the number of bytes held in addition to those of the memory plan.
    pub(crate) fn kept_bytes(&self) -> usize {
        self.nodal.as_ref().map_or(0, |nodal| nodal.kept)
    }

    /// Sorts the samples by vertex if the plan's budget allows. Keeps the patches of the sorted samples if `several`
    /// surfaces use them and the budget allows. Returns the plan for at most `most` surfaces together.
    pub(crate) fn use_nodal_sums(
        &mut self,
        plan: SurfacePlan,
        most: usize,
        several: bool,
        monitor: &dyn Monitor,
    ) -> Result<SurfacePlan, Error> {
        let Some(with_nodes) = plan.by_nodes(self.samples(), most) else { return Ok(plan) };
        let mut nodal = self.build_nodal_sums(monitor)?;
        let kept = nodal.sums.patch_bytes();
        if several && with_nodes.needed(with_nodes.together) + kept <= with_nodes.budget {
            nodal.sums.keep();
            nodal.kept = kept;
        }
        self.nodal = Some(nodal);
        Ok(with_nodes)
    }

    fn build_nodal_sums(&self, monitor: &dyn Monitor) -> Result<Nodal, Error> {
        let (nodes, on_seam) =
            (self.sphere.directions.len(), self.seam.as_ref().map_or(0, |seam| seam.vertices().len()));
        let (triangles, samples) = (self.sphere.faces.len() + on_seam, self.samples() + on_seam);
        let mut builder = NodalSumsBuilder::new(self.params.max_degree, nodes, triangles, samples)?;
        let mut of_surface = 0.0;
        for triangles in self.sampling.runs(NODAL_RUN) {
            monitor.check()?;
            let SphereSamples { directions, weights } = self.weighted(triangles.clone())?;
            let (nodes, shares) = self.sampling.corners(triangles);
            of_surface += weights.iter().sum::<f64>();
            let directions = directions.as_slice();
            builder.add(NodalSamples { directions, weights: &weights, nodes: &nodes, shares: &shares })?;
        }
        let mut of_seam = 0.0;
        if let Some(seam) = &self.seam {
            let weights = self.of_seam(seam, of_surface);
            of_seam = weights.iter().sum();
            let nodes: Vec<[u32; 3]> = seam.vertices().iter().map(|&vertex| [vertex as u32; 3]).collect();
            let (directions, shares) = (seam.directions(self.sphere), vec![[1.0, 0.0, 0.0]; nodes.len()]);
            builder.add(NodalSamples { directions: &directions, weights: &weights, nodes: &nodes, shares: &shares })?;
        }
        Ok(Nodal { sums: builder.finish()?, of_seam, kept: 0 })
    }

    /// Returns the samples of some triangles. A sample's weight is its solid angle times the harmonic mean of the
    /// corners' weights, in which each corner is weighted by its share in the sample. A sample is a mean of its
    /// corners' values, and it is no more certain than the least certain corner. Therefore, if one corner's weight is
    /// near 0, the sample's weight is small. If one corner's weight is 0, the sample's weight is 0, and the corner's
    /// value has no influence.
    fn weighted(&self, triangles: Range<usize>) -> Result<SphereSamples, Error> {
        let mut samples = self.sampling.at(&self.sphere.directions, triangles.clone())?;
        if self.params.denoise {
            self.count_alike(triangles.clone(), &mut samples.weights);
        }
        if let Some(reciprocals) = &self.reciprocals {
            let column = aview1(reciprocals).insert_axis(Axis(1));
            let variances = self.sampling.interpolate(column, triangles);
            samples.weights.iter_mut().zip(&variances).for_each(|(weight, variance)| *weight /= variance);
        }
        Ok(samples)
    }

    /// Returns the weights of the seams' vertices for a surface of total weight `of_surface`.
    fn of_seam(&self, seam: &SeamVertices, of_surface: f64) -> Vec<f64> {
        seam.weights(of_surface / (4.0 * PI), self.weights.as_deref())
    }

    /// Scales the weights of the samples of some triangles so that each triangle has total weight 1. Equal weights suit
    /// noise at the vertices: many small triangles contain more information about a region than one large triangle
    /// does.
    fn count_alike(&self, triangles: Range<usize>, weights: &mut [f64]) {
        let mut rest = weights;
        for triangle in triangles {
            let (of_triangle, others) = rest.split_at_mut(self.sampling.samples(triangle..triangle + 1));
            let sum: f64 = of_triangle.iter().sum();
            if sum > 0.0 {
                of_triangle.iter_mut().for_each(|weight| *weight /= sum);
            }
            rest = others;
        }
    }

    /// Returns the sums over the samples. Each target is given by its range of columns in the batch and its values at
    /// the vertices. The samples' weights are scaled so that their sum is the sum of the vertices' weights. A penalty
    /// therefore has the same meaning for a surface as for its vertices.
    pub(crate) fn of(
        &self,
        targets: &[(Range<usize>, ArrayView2<'_, f64>)],
        monitor: &dyn Monitor,
    ) -> Result<SampleSums, Error> {
        let (mut sums, of_seam) = match &self.nodal {
            Some(nodal) => (nodal.sums.sums(side_by_side(targets).view())?, nodal.of_seam),
            None => self.run_by_run(targets, monitor)?,
        };
        let vertices = self.sphere.directions.len() as f64;
        let total = self.weights.as_ref().map_or(vertices, |weights| weights.iter().sum());
        let factor = total / (sums.weight - of_seam);
        let all = sums.moments.iter_mut().chain(&mut sums.right_sides).chain(&mut sums.squares);
        all.chain([&mut sums.weight]).for_each(|sum| *sum *= factor);
        Ok(sums)
    }

    /// Samples the triangles run by run. Returns the sums, and the seams' part of the total weight.
    fn run_by_run(
        &self,
        targets: &[(Range<usize>, ArrayView2<'_, f64>)],
        monitor: &dyn Monitor,
    ) -> Result<(SampleSums, f64), Error> {
        let columns = columns(targets);
        let (mut sums, mut of_surface, mut of_seam) = (Accumulator::new(self.params.max_degree, columns)?, 0.0, 0.0);
        for triangles in self.sampling.runs(RUN) {
            monitor.check()?;
            let SphereSamples { directions, weights } = self.weighted(triangles.clone())?;
            let mut values = Array2::zeros((weights.len(), columns));
            for (group, target) in targets {
                let columns = values.slice_mut(s![.., group.clone()]);
                self.sampling.interpolate_to(target.view(), triangles.clone(), columns);
            }
            sums.add(directions.as_slice(), Some(&weights), values.view())?;
            of_surface += weights.iter().sum::<f64>();
        }
        if let Some(seam) = &self.seam {
            let weights = self.of_seam(seam, of_surface);
            let mut values = Array2::zeros((weights.len(), columns));
            for (group, target) in targets {
                values.slice_mut(s![.., group.clone()]).assign(&seam.rows_of(target.view()));
            }
            sums.add(&seam.directions(self.sphere), Some(&weights), values.view())?;
            of_seam = weights.iter().sum();
        }
        Ok((sums.finish()?.sums, of_seam))
    }
}

fn columns(targets: &[(Range<usize>, ArrayView2<'_, f64>)]) -> usize {
    targets.last().map_or(0, |(group, _)| group.end)
}

/// Returns the columns of all targets side by side, as an array with one row per vertex.
fn side_by_side(targets: &[(Range<usize>, ArrayView2<'_, f64>)]) -> Array2<f64> {
    let rows = targets.first().map_or(0, |(_, target)| target.nrows());
    let mut all = Array2::zeros((rows, columns(targets)));
    all.axis_chunks_iter_mut(Axis(0), ROWS).into_par_iter().enumerate().for_each(|(chunk, mut all)| {
        let rows = chunk * ROWS..chunk * ROWS + all.nrows();
        for (group, target) in targets {
            all.slice_mut(s![.., group.clone()]).assign(&target.slice(s![rows.clone(), ..]));
        }
    });
    all
}

#[cfg(test)]
mod tests {
    use spharm_monitor::Silent;
    use spharm_surface::Seam;

    use super::super::lsq_plan::Sizes;
    use super::*;
    use crate::Weights;

    fn largest<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
        values.into_iter().fold(0.0, |a: f64, b| a.max(b.abs()))
    }

    #[test]
    fn sums_by_vertices_are_those_by_samples() {
        let mut sphere = Sphere::icosphere(3);
        let n = sphere.directions.len();
        let values = |c: usize| Array2::from_shape_fn((n, c), |(v, k)| ((v * (k + 3 * c)) as f64 * 0.13).sin());
        let weights = (0..n).map(|v| (v % 5) as f64).collect();
        let weighted =
            FitParams { weights: Weights::Values { name: "some".into(), values: weights }, ..FitParams::lsq(17) };
        let denoised = FitParams { denoise: true, ..weighted.clone() };
        for (seam, params) in [(false, &FitParams::lsq(9)), (true, &weighted), (true, &denoised)] {
            sphere.seam = seam.then(|| Seam { vertices: n, faces: sphere.faces.len() - 40, copies: Vec::new() });
            let job = Job::new(&sphere, None, params, &Silent).unwrap();
            let mut sums = SurfaceSums::new(&job).unwrap();
            let (a, b) = (values(3), values(1));
            let targets = [(0..3, a.view()), (3..4, b.view())];
            let by_samples = sums.of(&targets, &Silent).unwrap();
            sums.nodal = Some(sums.build_nodal_sums(&Silent).unwrap());
            let by_vertices = sums.of(&targets, &Silent).unwrap();
            let scale = largest(&by_samples.moments);
            let off = &by_samples.right_sides - &by_vertices.right_sides;
            assert!(largest(&off) < 1e-12 * scale, "{:e} of {scale}", largest(&off));
            for (a, b) in by_samples.moments.iter().zip(&by_vertices.moments) {
                assert!((a - b).abs() < 1e-12 * scale, "{a} {b}");
            }
            for (a, b) in by_samples.squares.iter().zip(&by_vertices.squares) {
                assert!((a / b - 1.0).abs() < 1e-12, "{a} {b}");
            }
            assert!((by_samples.weight / by_vertices.weight - 1.0).abs() < 1e-13);
            assert_eq!(by_samples.count, by_vertices.count);
        }
    }

    /// Samples are sorted by vertices if memory allows, and patches are stored if several surfaces use them.
    #[test]
    fn vertices_are_chosen_by_memory() {
        let chosen = |sphere: &Sphere, budget: usize, several: bool| {
            let params = FitParams::lsq(100);
            let job = Job::new(sphere, None, &params, &Silent).unwrap();
            let mut sums = SurfaceSums::new(&job).unwrap();
            let sizes = Sizes {
                vertices: sphere.directions.len(),
                faces: sphere.faces.len(),
                max_degree: 100,
                channels: 3,
                denoise: false,
            };
            let plan = sums.use_nodal_sums(SurfacePlan::new(sizes, budget, 32).unwrap(), 32, several, &Silent).unwrap();
            assert!(plan.needed(plan.together) + sums.kept_bytes() <= budget);
            (sums.nodal.is_some(), sums.kept_bytes() > 0)
        };
        let even = Sphere::icosphere(4);
        assert_eq!(chosen(&even, 1 << 30, true), (true, true));
        assert_eq!(chosen(&even, 1 << 30, false), (true, false));
        let fine = Sphere::icosphere(7);
        assert_eq!(chosen(&fine, 180 << 20, true), (false, false));
    }
}
