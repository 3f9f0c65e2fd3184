//! Vertices that a fit isn't shown, to see what it does between those that it was.

use anyhow::Result;
use ndarray::{Array2, ArrayView2};
use serde::Serialize;
use spharm_harmonics::Directions;
use spharm_surface::generate::SplitMix64;
use spharm_transform::synthesis;

use super::report::{About, Distances};

/// Which vertices are held out.
pub(crate) struct HoldOut {
    held: Vec<bool>,
}

/// Distances at the vertices that were held out and at the others.
#[derive(Debug, Clone, Copy, Serialize)]
pub(crate) struct HeldOut {
    pub(crate) vertices: usize,
    pub(crate) held_out: Distances,
    pub(crate) seen: Distances,
}

impl HoldOut {
    /// A fraction of n vertices, the same ones each time.
    pub(crate) fn new(n: usize, fraction: f64) -> Self {
        let mut random = SplitMix64::new(0);
        Self { held: (0..n).map(|_| random.between(0.0, 1.0) < fraction).collect() }
    }

    pub(crate) fn count(&self) -> usize {
        self.held.iter().filter(|held| **held).count()
    }

    /// The weights with those of the held-out vertices at zero.
    pub(crate) fn apply(&self, weights: Option<Vec<f64>>) -> Vec<f64> {
        let mut weights = weights.unwrap_or_else(|| vec![1.0; self.held.len()]);
        weights.iter_mut().zip(&self.held).filter(|(_, held)| **held).for_each(|(weight, _)| *weight = 0.0);
        weights
    }

    /// Distances of the model with these coefficients from targets, (n, c).
    pub(crate) fn judge(
        &self,
        directions: &Directions,
        coefficients: ArrayView2<'_, f64>,
        targets: ArrayView2<'_, f64>,
        about: &About,
    ) -> Result<HeldOut> {
        let residual: Array2<f64> = &targets - &synthesis(directions, coefficients)?;
        let of = |which: bool| {
            let (mut sum, mut max, mut count) = (0.0, 0.0f64, 0usize);
            for (row, held) in residual.rows().into_iter().zip(&self.held) {
                if *held == which {
                    let square = row.dot(&row);
                    (sum, max, count) = (sum + square, max.max(square), count + 1);
                }
            }
            about.of_residual(sum / count.max(1) as f64, max, false)
        };
        Ok(HeldOut { vertices: self.count(), held_out: of(true), seen: of(false) })
    }
}
