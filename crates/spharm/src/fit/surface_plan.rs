//! Plans the memory for surface fits.

use spharm_harmonics::basis_size;
use spharm_solver::MomentNormal;
use spharm_transform::{Accumulator, NodalSums, Transform};

use super::job::{held, reading};
use super::lsq_plan::{Sizes, transform};
use crate::Error;

/// Number of samples that are generated and added to the sums at a time.
pub(crate) const RUN: usize = 1 << 18;

/// Number of samples that are generated at a time if samples are sorted by vertex.
pub(crate) const NODAL_RUN: usize = 1 << 15;

/// Largest number of columns of coefficients that are evaluated at the vertices together. Kernels and Legendre
/// functions are computed once for all of these columns.
const EVALUATED: usize = 12;

/// Largest number of coefficients that are evaluated together, so that their grid fits in the cache: 12 columns up to
/// degree 100, 3 up to degree 200.
const COEFFICIENTS: usize = 12 * 101 * 101;

/// Memory plan for surface fits.
pub(crate) struct SurfacePlan {
    pub(crate) sizes: Sizes,
    pub(crate) budget: usize,
    /// Number of surfaces that are fitted together.
    pub(crate) together: usize,
    /// Number of samples, if samples are sorted by vertex; else `None`.
    sorted: Option<usize>,
}

impl SurfacePlan {
    /// Plans fits of at most `most` surfaces together.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`] if the budget doesn't suffice for one surface.
    pub(crate) fn new(sizes: Sizes, budget: usize, most: usize) -> Result<Self, Error> {
        let mut plan = Self { sizes, budget, together: 1, sorted: None };
        if plan.needed(1) > budget {
            return Err(Error::Memory { budget, needed: plan.needed(1) });
        }
        plan.together = plan.most_together(most);
        Ok(plan)
    }

    /// Returns the plan with `samples` samples sorted by vertex, or `None` if the budget doesn't suffice for it.
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

    /// Returns the memory in bytes for `together` surfaces that are fitted together and read one at a time.
    pub(crate) fn needed(&self, together: usize) -> usize {
        let Sizes { vertices, faces, max_degree, channels, denoise } = self.sizes;
        let columns = together * channels;
        // The sampling holds the subdivision of each triangle, and the positions, directions, weights and values of
        // samples. Samples are computed in runs, so memory is needed for one run at a time. If samples are sorted by
        // vertex, the sums hold data of all samples.
        let (sampling, sums) = match self.sorted {
            None => (40 * faces + RUN * (64 + 8 * columns), Accumulator::bytes(max_degree, columns)),
            Some(samples) => (
                40 * faces + NODAL_RUN.min(samples) * 128 + 8 * columns * vertices,
                NodalSums::bytes(max_degree, vertices, faces, samples, columns),
            ),
        };
        // Solving needs the moments, a copy of the moments, the operator made from them, two copies of the right-hand
        // sides, and the vectors of conjugate gradients.
        let solving = 8 * basis_size(2 * max_degree) + 80 * columns * basis_size(max_degree);
        let operator = MomentNormal::bytes(max_degree, columns, rayon::current_num_threads());
        let evaluated = self.evaluated(together);
        let at_vertices =
            Transform::bytes(&transform(max_degree, evaluated), vertices, evaluated).unwrap_or(usize::MAX / 4);
        // The residual needs memory for models and residuals and, if noise is removed, for noise and its residual.
        let residual = 16 * evaluated * vertices + if denoise { 16 * columns * vertices } else { 0 };
        let held = held(vertices, faces, together, channels, 1);
        held + sampling + sums.max(operator) + solving + at_vertices + residual
    }

    /// Returns the number of columns that are evaluated at the vertices together, a multiple of a surface's columns.
    pub(crate) fn evaluated(&self, together: usize) -> usize {
        let columns = (COEFFICIENTS / basis_size(self.sizes.max_degree)).min(EVALUATED);
        let channels = self.sizes.channels;
        channels * (columns / channels.max(1)).clamp(1, together)
    }

    /// Returns the number of threads that may read surfaces at the same time.
    pub(crate) fn readers(&self, threads: usize) -> usize {
        let Sizes { vertices, faces, channels, .. } = self.sizes;
        let spare = self.budget.saturating_sub(self.needed(self.together));
        (1 + spare / reading(vertices, faces, channels).max(1)).min(threads)
    }
}
