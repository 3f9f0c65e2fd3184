//! Holds vertices out of a fit, to assess the model between the fitted vertices.

use ndarray::{Array2, ArrayView2};
use serde::Serialize;
use spharm_harmonics::Directions;
use spharm_surface::generate::SplitMix64;
use spharm_transform::synthesis;

use crate::Error;
use crate::assess::Distances;

/// Vertices that were chosen at random and are held out of a fit.
pub(crate) struct HoldOut {
    held: Vec<bool>,
}

/// Distances between model and target at the held-out vertices and at the fitted vertices.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct HeldOut {
    /// Number of vertices held out.
    pub vertices: usize,
    /// Distances at the held-out vertices.
    pub held_out: Distances,
    /// Distances at the fitted vertices.
    pub seen: Distances,
}

impl HoldOut {
    /// Chooses at random about the fraction `fraction` of n vertices and holds them out. The seed is fixed, so the
    /// choice is reproducible.
    ///
    /// # Errors
    ///
    /// [`Error::HoldOut`] if the fraction selects no vertex, [`Error::Setting`] if it selects all vertices.
    pub(crate) fn new(n: usize, fraction: f64) -> Result<Self, Error> {
        let mut random = SplitMix64::new(0);
        let found = Self { held: (0..n).map(|_| random.between(0.0, 1.0) < fraction).collect() };
        if found.count() == 0 {
            return Err(Error::HoldOut { fraction, vertices: n });
        }
        if found.count() == n {
            let (what, expected) = ("hold-out", "a fraction small enough to leave vertices for the fit");
            return Err(Error::Setting {
                what,
                expected,
                found: format!("{fraction}, which holds out all {n} vertices"),
            });
        }
        Ok(found)
    }

    pub(crate) fn count(&self) -> usize {
        self.held.iter().filter(|held| **held).count()
    }

    /// Returns `weights` with 0 at the held-out vertices. If `weights` is `None`, all other vertices get weight 1.
    pub(crate) fn apply(&self, weights: Option<Vec<f64>>) -> Vec<f64> {
        let mut weights = weights.unwrap_or_else(|| vec![1.0; self.held.len()]);
        weights.iter_mut().zip(&self.held).filter(|(_, held)| **held).for_each(|(weight, _)| *weight = 0.0);
        weights
    }

    /// Returns the distances between a model and `targets` (one row per vertex, one column per channel), at the
    /// held-out vertices and at the fitted vertices. The model has the given coefficients, one row per basis function.
    /// Vertices marked in `unread` are excluded.
    pub(crate) fn assess(
        &self,
        directions: &Directions,
        coefficients: ArrayView2<'_, f64>,
        targets: ArrayView2<'_, f64>,
        unread: Option<&[bool]>,
        scale: Option<f64>,
    ) -> Result<HeldOut, Error> {
        let residual: Array2<f64> = &targets - &synthesis(directions, coefficients)?;
        let of = |which: bool| {
            let (mut sum, mut max, mut count) = (0.0, 0.0f64, 0usize);
            for (i, (row, held)) in residual.rows().into_iter().zip(&self.held).enumerate() {
                if *held == which && !unread.is_some_and(|unread| unread[i]) {
                    let square = row.dot(&row);
                    (sum, max, count) = (sum + square, max.max(square), count + 1);
                }
            }
            Distances::new(sum / count.max(1) as f64, max, false, scale)
        };
        Ok(HeldOut { vertices: self.count(), held_out: of(true), seen: of(false) })
    }
}
