//! The memory that fits of surfaces take.

use spharm_harmonics::basis_size;
use spharm_transform::{Accumulator, MomentOperator, Transform};

use super::job::{held, reading};
use super::lsq_plan::{Sizes, transform};
use crate::Error;

/// Samples that are made and added at a time.
pub(crate) const RUN: usize = 1 << 18;

/// The memory that fits of surfaces take.
pub(crate) struct SurfacePlan {
    pub(crate) sizes: Sizes,
    pub(crate) budget: usize,
    /// Surfaces that are fitted together.
    pub(crate) together: usize,
}

impl SurfacePlan {
    /// Plans fits of at most so many surfaces together.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`] where one doesn't fit the budget.
    pub(crate) fn new(sizes: Sizes, budget: usize, most: usize) -> Result<Self, Error> {
        let mut plan = Self { sizes, budget, together: 1 };
        if plan.needed(1) > budget {
            return Err(Error::Memory { budget, needed: plan.needed(1) });
        }
        plan.together = (1..=most).rev().find(|&together| plan.needed(together) <= budget).unwrap_or(1);
        Ok(plan)
    }

    /// Bytes for so many surfaces together, which are read one at a time.
    pub(crate) fn needed(&self, together: usize) -> usize {
        let Sizes { vertices, faces, max_degree, channels, denoise } = self.sizes;
        let columns = together * channels;
        // How each triangle is cut; places, directions, weights and values of a run's samples.
        let sampling = 40 * faces + RUN * (64 + 8 * columns);
        let sums = Accumulator::bytes(max_degree, columns);
        // Moments and right-hand sides, twice; the vectors of conjugate gradients.
        let solving = 16 * basis_size(2 * max_degree) + 80 * columns * basis_size(max_degree);
        let operator = MomentOperator::bytes(max_degree, columns, rayon::current_num_threads());
        // At the vertices the models are evaluated one after another.
        let at_vertices =
            Transform::bytes(&transform(max_degree, channels), vertices, channels).unwrap_or(usize::MAX / 4);
        // Noise beside its residual, where it is removed.
        let residual = 16 * channels * vertices + if denoise { 16 * columns * vertices } else { 0 };
        let held = held(vertices, faces, together, channels, 1);
        held + sampling + sums.max(operator) + solving + at_vertices + residual
    }

    /// How many of the threads may read a surface at a time.
    pub(crate) fn readers(&self, threads: usize) -> usize {
        let Sizes { vertices, faces, channels, .. } = self.sizes;
        let spare = self.budget.saturating_sub(self.needed(self.together));
        (1 + spare / reading(vertices, faces, channels).max(1)).min(threads)
    }
}
