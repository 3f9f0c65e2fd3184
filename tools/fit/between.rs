//! What a model does between the vertices that it was fitted to: a fit can be perfect at all of them and wild elsewhere.

use anyhow::Result;
use ndarray::ArrayView2;
use spharm_cli::inputs::Sphere;
use spharm_harmonics::{Directions, synthesis};

use crate::report::{About, Distances};

/// Products of places and functions: some hundredths of a second.
const WORK: usize = 20_000_000;
/// Least and most places.
const PLACES: [usize; 2] = [200, 2000];
/// A model is wild where it is this many times as far off between the vertices as at them, and by more than [`LEAST`] of
/// the surface's size.
const WILD: f64 = 10.0;
const LEAST: f64 = 1e-3;

/// Centres of some of the triangles, evenly spread over their list.
pub(crate) struct Between {
    faces: Vec<[u32; 3]>,
    centres: Directions,
}

impl Between {
    /// For models of `functions` functions; `None` where the sphere has no triangles.
    pub(crate) fn new(sphere: &Sphere, functions: usize) -> Result<Option<Self>> {
        let unit = sphere.directions.as_slice();
        let sum = |face: &[u32; 3]| {
            [0, 1, 2].map(|k| face.iter().map(|&v| unit.get(v as usize).map_or(f64::NAN, |p| p[k])).sum::<f64>())
        };
        let places = (WORK / functions).clamp(PLACES[0], PLACES[1]);
        let step = sphere.faces.len().div_ceil(places).max(1);
        // The centre of a triangle that goes round the sphere says nothing.
        let small = |(_, sum): &([u32; 3], [f64; 3])| sum.iter().map(|x| x * x).sum::<f64>() > 1.0;
        let chosen = sphere.faces.iter().step_by(step).map(|face| (*face, sum(face))).filter(small);
        let (faces, sums): (Vec<_>, Vec<_>) = chosen.unzip();
        if faces.is_empty() {
            return Ok(None);
        }
        Ok(Some(Self { faces, centres: Directions::from_vertices(&sums)? }))
    }

    /// Distances of the model with these coefficients from the centres of the surface's triangles.
    pub(crate) fn judge(
        &self,
        coefficients: ArrayView2<'_, f64>,
        vertices: ArrayView2<'_, f64>,
        about: &About,
    ) -> Result<Distances> {
        let model = synthesis(&self.centres, coefficients)?;
        let (mut sum, mut most) = (0.0, 0.0_f64);
        for (face, model) in self.faces.iter().zip(model.rows()) {
            let off = |k: usize| model[k] - face.iter().map(|&v| vertices[[v as usize, k]]).sum::<f64>() / 3.0;
            let square: f64 = (0..model.len()).map(|k| off(k).powi(2)).sum();
            (sum, most) = (sum + square, most.max(square));
        }
        Ok(about.of_residual(sum / self.faces.len() as f64, most, false))
    }
}

/// How many times as far off a model is between the vertices as at them, where that is too many.
pub(crate) fn wild(at: &Distances, between: &Distances, scale: f64) -> Option<f64> {
    let ratio = (between.msd_raw / at.msd_raw).sqrt();
    (ratio > WILD && between.msd_raw.sqrt() > LEAST * scale).then_some(ratio)
}
