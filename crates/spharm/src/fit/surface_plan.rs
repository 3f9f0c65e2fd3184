//! The memory that fits of surfaces take.

use spharm_harmonics::basis_size;
use spharm_solver::MomentNormal;
use spharm_transform::{Accumulator, NodalSums, Transform};

use super::job::{held, reading};
use super::lsq_plan::{Sizes, transform};
use crate::Error;

/// Samples that are made and added at a time.
pub(crate) const RUN: usize = 1 << 18;

/// Samples that are made at a time where they are sorted by vertices.
pub(crate) const NODAL_RUN: usize = 1 << 15;

/// Columns of models that are evaluated at the vertices together, at most: kernels and Legendre functions are then
/// computed once for several surfaces.
const EVALUATED: usize = 12;

/// Coefficients of these columns, at most, so that a cache holds their grid: 12 columns to degree 100, 3 to degree 200.
const COEFFICIENTS: usize = 12 * 101 * 101;

/// The memory that fits of surfaces take.
pub(crate) struct SurfacePlan {
    pub(crate) sizes: Sizes,
    pub(crate) budget: usize,
    /// Surfaces that are fitted together.
    pub(crate) together: usize,
    /// The number of samples, where these are sorted by vertices.
    sorted: Option<usize>,
}

impl SurfacePlan {
    /// Plans fits of at most so many surfaces together.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`] where one doesn't fit the budget.
    pub(crate) fn new(sizes: Sizes, budget: usize, most: usize) -> Result<Self, Error> {
        let mut plan = Self { sizes, budget, together: 1, sorted: None };
        if plan.needed(1) > budget {
            return Err(Error::Memory { budget, needed: plan.needed(1) });
        }
        plan.together = plan.most_together(most);
        Ok(plan)
    }

    /// Plans the same with so many samples sorted by vertices; `None` where that doesn't fit the budget.
    pub(crate) fn by_nodes(&self, samples: usize, most: usize) -> Option<Self> {
        let mut plan = Self { sorted: Some(samples), together: 1, ..*self };
        if plan.needed(1) > plan.budget {
            return None;
        }
        plan.together = plan.most_together(most);
        Some(plan)
    }

    fn most_together(&self, most: usize) -> usize {
        (1..=most).rev().find(|&together| self.needed(together) <= self.budget).unwrap_or(1)
    }

    /// Bytes for so many surfaces together, which are read one at a time.
    pub(crate) fn needed(&self, together: usize) -> usize {
        let Sizes { vertices, faces, max_degree, channels, denoise } = self.sizes;
        let columns = together * channels;
        // How each triangle is cut; places, directions, weights and values of a run's samples, or of all by vertices.
        let (sampling, sums) = match self.sorted {
            None => (40 * faces + RUN * (64 + 8 * columns), Accumulator::bytes(max_degree, columns)),
            Some(samples) => (
                40 * faces + NODAL_RUN.min(samples) * 128 + 8 * columns * vertices,
                NodalSums::bytes(max_degree, vertices, faces, samples, columns),
            ),
        };
        // Moments, and what is made from them with a copy; right-hand sides, twice; the vectors of conjugate gradients.
        let solving = 8 * basis_size(2 * max_degree) + 80 * columns * basis_size(max_degree);
        let operator = MomentNormal::bytes(max_degree, columns, rayon::current_num_threads());
        let evaluated = self.evaluated(together);
        let at_vertices =
            Transform::bytes(&transform(max_degree, evaluated), vertices, evaluated).unwrap_or(usize::MAX / 4);
        // Models and residuals; noise beside its residual, where it is removed.
        let residual = 16 * evaluated * vertices + if denoise { 16 * columns * vertices } else { 0 };
        let held = held(vertices, faces, together, channels, 1);
        held + sampling + sums.max(operator) + solving + at_vertices + residual
    }

    /// Columns that are evaluated at the vertices together, of so many surfaces: those of whole surfaces.
    pub(crate) fn evaluated(&self, together: usize) -> usize {
        let columns = (COEFFICIENTS / basis_size(self.sizes.max_degree)).min(EVALUATED);
        let channels = self.sizes.channels;
        channels * (columns / channels.max(1)).clamp(1, together)
    }

    /// How many of the threads may read a surface at a time.
    pub(crate) fn readers(&self, threads: usize) -> usize {
        let Sizes { vertices, faces, channels, .. } = self.sizes;
        let spare = self.budget.saturating_sub(self.needed(self.together));
        (1 + spare / reading(vertices, faces, channels).max(1)).min(threads)
    }
}
