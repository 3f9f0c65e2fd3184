//! The memory that fits by transforms take: a full least squares beside a factor, and quadrature.

use spharm_harmonics::basis_size;
use spharm_transform::{FINEST, Transform, TransformParams};

use super::job::{held, reading};
use crate::{Error, defaults};

/// Channels that a transform takes at a time; more are slower, since the caches don't hold them.
const CHANNELS_AT_A_TIME: usize = 3;

/// What a fit takes, in bytes.
pub(crate) struct LsqPlan {
    /// What it may take.
    pub(crate) budget: usize,
    /// Channels that a transform takes at a time.
    pub(crate) channels_at_a_time: usize,
    /// Whatever the number of targets.
    fixed: usize,
    /// A target's columns in all the arrays.
    each: usize,
    /// A target while it is read.
    reading: usize,
}

/// Sizes of a fit.
#[derive(Clone, Copy)]
pub(crate) struct Sizes {
    pub(crate) vertices: usize,
    pub(crate) faces: usize,
    pub(crate) max_degree: usize,
    pub(crate) channels: usize,
    /// Whether noise is removed.
    pub(crate) denoise: bool,
}

impl LsqPlan {
    /// Plans fits of targets with so many channels, with as many of them in a transform as the budget allows.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`] where one target doesn't fit the budget.
    pub(crate) fn new(sizes: Sizes, budget: usize) -> Result<Self, Error> {
        let Sizes { vertices, faces, max_degree, channels, denoise } = sizes;
        // Targets and residual, and the samples between, and the same of a plain fit where a penalised one follows; the
        // vectors of conjugate gradients.
        let samples = if denoise { 6 } else { 4 };
        let each = 8 * channels * (samples * vertices + 8 * basis_size(max_degree));
        let held = held(vertices, faces, 1, channels, 1);
        let fixed = |at_a_time: usize| -> Result<usize, Error> {
            Ok(held + Transform::bytes(&transform(max_degree, at_a_time), vertices, at_a_time)?)
        };
        let at_a_time = channels.clamp(1, CHANNELS_AT_A_TIME);
        let reading = reading(vertices, faces, channels);
        let mut plan = Self { budget, channels_at_a_time: at_a_time, fixed: fixed(at_a_time)?, each, reading };
        while plan.channels_at_a_time > 1 && plan.needed(1) > budget {
            plan.channels_at_a_time -= 1;
            plan.fixed = fixed(plan.channels_at_a_time)?;
        }
        if plan.needed(1) > budget {
            return Err(Error::Memory { budget, needed: plan.needed(1) });
        }
        Ok(plan)
    }

    /// Bytes for so many targets together, which are read one at a time.
    pub(crate) fn needed(&self, together: usize) -> usize {
        self.fixed + together * self.each
    }

    /// Bytes of the budget that so many targets together leave.
    pub(crate) fn spare(&self, together: usize) -> usize {
        self.budget.saturating_sub(self.needed(together))
    }

    /// How many of the threads may read a target at a time while so many are fitted together, and `taken` bytes are
    /// taken for moments.
    pub(crate) fn readers(&self, together: usize, taken: usize, threads: usize) -> usize {
        let more = self.spare(together).saturating_sub(taken) / self.reading.max(1);
        (1 + more).min(threads)
    }
}

/// Checks that the memory suffices for quadrature, one target after another; returns how many of the threads may read a
/// target at a time.
///
/// # Errors
///
/// [`Error::Memory`] with the least that works.
pub(crate) fn quadrature_readers(sizes: Sizes, budget: usize, threads: usize) -> Result<usize, Error> {
    /// Of a triangle in the tree that finds those under the grid, its corners and what making it takes.
    const BYTES_PER_TRIANGLE: usize = 250;
    let Sizes { vertices, faces, max_degree, channels, .. } = sizes;
    let grid = 2 * (max_degree + 1) * (max_degree + 1);
    let transform = |n: usize| Transform::bytes(&quadrature_transform(max_degree), n, channels);
    // The grid's directions, weights and samples, twice while these are put in the transform's order; targets,
    // synthesis and residual.
    let arrays = grid * (32 + 16 * channels) + 24 * channels * vertices + 16 * channels * basis_size(max_degree);
    let held = held(vertices, faces, 1, channels, 1) + BYTES_PER_TRIANGLE * faces;
    let needed = held + arrays + transform(grid)? + transform(vertices)?;
    if needed > budget {
        return Err(Error::Memory { budget, needed });
    }
    Ok((1 + (budget - needed) / reading(vertices, faces, channels).max(1)).min(threads))
}

/// The settings of the transforms of quadrature, two surfaces at a time.
pub(crate) fn quadrature_transform(max_degree: usize) -> TransformParams {
    TransformParams { max_degree, accuracy: FINEST, channels: 6 }
}

/// The settings of the transform of a fit.
pub(crate) fn transform(max_degree: usize, channels: usize) -> TransformParams {
    TransformParams { max_degree, accuracy: defaults::TRANSFORM_ACCURACY, channels }
}
