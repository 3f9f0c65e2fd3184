//! Measures a model's distance from its surface at the centres of triangles, since a model can match all vertices and
//! oscillate between them.

use ndarray::{Array2, ArrayView1, ArrayView2};
use spharm_harmonics::{Directions, synthesis};
use spharm_surface::Sphere;

use crate::Error;
use crate::assess::Distances;

/// Maximum product of the number of triangle centres and the number of basis functions. It keeps the time of an
/// evaluation to a few hundredths of a second up to degree 300.
const WORK: usize = 20_000_000;
/// Minimum and maximum number of triangle centres.
const PLACES: [usize; 2] = [200, 2000];
/// A model is reported as oscillating if its rms distance at the triangle centres is more than `OSCILLATION` times its
/// rms distance at the vertices, and also more than [`LEAST`] times the rms of the triangles' longest edges. The
/// distances between a smooth model and the flat triangles don't exceed both limits.
const OSCILLATION: f64 = 10.0;
/// A model is reported as oscillating only if its rms distance at the triangle centres is more than this multiple of
/// the rms of the triangles' longest edges; see [`OSCILLATION`].
const LEAST: f64 = 0.3;

/// Centres of some of a sphere's triangles, which are evenly spaced in the list of triangles.
pub(crate) struct OffVertex {
    faces: Vec<[u32; 3]>,
    centres: Directions,
}

impl OffVertex {
    /// Chooses the triangle centres at which models of `functions` basis functions are evaluated. Triangles with a
    /// corner marked in `unread` are excluded. Returns `None` if no triangle remains.
    pub(crate) fn new(sphere: &Sphere, unread: Option<&[bool]>, functions: usize) -> Result<Option<Self>, Error> {
        let unit = sphere.directions.as_slice();
        let sum = |face: &[u32; 3]| {
            [0, 1, 2].map(|k| face.iter().map(|&v| unit.get(v as usize).map_or(f64::NAN, |p| p[k])).sum::<f64>())
        };
        let places = (WORK / functions).clamp(PLACES[0], PLACES[1]);
        let step = sphere.faces.len().div_ceil(places).max(1);
        // The centre of a triangle that covers much of the sphere is meaningless.
        let small = |(_, sum): &([u32; 3], [f64; 3])| sum.iter().map(|x| x * x).sum::<f64>() > 1.0;
        let is_read = |face: &&[u32; 3]| {
            unread.is_none_or(|unread| face.iter().all(|&v| !unread.get(v as usize).copied().unwrap_or(false)))
        };
        let chosen = sphere.faces.iter().step_by(step).filter(is_read).map(|face| (*face, sum(face))).filter(small);
        let (faces, sums): (Vec<_>, Vec<_>) = chosen.unzip();
        if faces.is_empty() {
            return Ok(None);
        }
        Ok(Some(Self { faces, centres: Directions::from_vertices(&sums)? }))
    }

    /// Returns the directions of the triangle centres.
    pub(crate) fn centres(&self) -> &Directions {
        &self.centres
    }

    /// Evaluates the model with the given coefficients at the triangle centres. Returns one position per centre.
    pub(crate) fn evaluate(&self, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, Error> {
        Ok(synthesis(&self.centres, coefficients)?)
    }

    /// Returns the distances between the model's positions at the triangle centres and the centres of the surface's
    /// triangles. If the model oscillates, also returns the rms of these distances divided by the rms of `at`, the
    /// distances at the vertices.
    pub(crate) fn assess(
        &self,
        model: ArrayView2<'_, f64>,
        vertices: ArrayView2<'_, f64>,
        at: &Distances,
        scale: Option<f64>,
    ) -> (Distances, Option<f64>) {
        let (mut sum, mut most, mut sizes) = (0.0, 0.0_f64, 0.0);
        for (face, model) in self.faces.iter().zip(model.rows()) {
            let off = |k: usize| model[k] - face.iter().map(|&v| vertices[[v as usize, k]]).sum::<f64>() / 3.0;
            let square: f64 = (0..model.len()).map(|k| off(k).powi(2)).sum();
            (sum, most) = (sum + square, most.max(square));
            let [a, b, c] = face.map(|v| vertices.row(v as usize));
            let edge = |p: ArrayView1<'_, f64>, q: ArrayView1<'_, f64>| -> f64 {
                p.iter().zip(q).map(|(p, q)| (p - q).powi(2)).sum()
            };
            sizes += edge(a, b).max(edge(b, c)).max(edge(c, a));
        }
        let between = Distances::new(sum / self.faces.len() as f64, most, false, scale);
        let ratio = (between.msd_raw / at.msd_raw.max(f64::MIN_POSITIVE)).sqrt();
        let oscillates = ratio > OSCILLATION && sum > LEAST * LEAST * sizes;
        (between, oscillates.then_some(ratio))
    }
}
