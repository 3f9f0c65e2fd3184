//! Plans the memory for fits that use transforms: the full least squares, possibly with a factor, and quadrature.

use spharm_harmonics::basis_size;
use spharm_transform::{FINEST, Transform, TransformParams};

use super::job::{held, reading};
use crate::{Error, defaults};

/// Number of channels that a transform processes at a time. A larger number is slower, because the data no longer fit
/// in the caches.
const CHANNELS_AT_A_TIME: usize = 3;

/// Memory of a fit, in bytes.
pub(crate) struct LsqPlan {
    /// Memory budget.
    pub(crate) budget: usize,
    /// Number of channels that a transform processes at a time.
    pub(crate) channels_at_a_time: usize,
    /// Memory that doesn't depend on the number of targets.
    fixed: usize,
    /// Memory of one target's columns in all arrays.
    each: usize,
    /// Memory for reading one target while other targets are fitted.
    reading: usize,
}

/// Sizes that determine the memory of a fit.
#[derive(Clone, Copy)]
pub(crate) struct Sizes {
    pub(crate) vertices: usize,
    pub(crate) faces: usize,
    pub(crate) max_degree: usize,
    pub(crate) channels: usize,
    /// Whether noise is removed from the targets.
    pub(crate) denoise: bool,
}

impl LsqPlan {
    /// Plans the memory use of fits. Each transform processes as many of a target's channels as the budget allows.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`] if the budget doesn't suffice for one target.
    pub(crate) fn new(sizes: Sizes, budget: usize) -> Result<Self, Error> {
        let Sizes { vertices, faces, max_degree, channels, denoise } = sizes;
        // Each target needs memory for itself, its residual and intermediate samples, for the samples of the plain fit
        // if a penalised fit follows, and for the vectors of conjugate gradients.
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

    /// Returns the memory in bytes for `together` targets that are fitted together and read one at a time.
    pub(crate) fn needed(&self, together: usize) -> usize {
        self.fixed + together * self.each
    }

    /// Returns the number of bytes of the budget that remain free with `together` targets.
    pub(crate) fn spare(&self, together: usize) -> usize {
        self.budget.saturating_sub(self.needed(together))
    }

    /// Returns the number of threads that may read targets at the same time, while `together` targets are fitted
    /// together and `taken` bytes are reserved for moments.
    pub(crate) fn readers(&self, together: usize, taken: usize, threads: usize) -> usize {
        let more = self.spare(together).saturating_sub(taken) / self.reading.max(1);
        (1 + more).min(threads)
    }
}

/// Checks that memory suffices for quadrature of targets one after another. Returns the number of threads that may read
/// targets at the same time.
///
/// # Errors
///
/// [`Error::Memory`], with the smallest sufficient budget, if memory doesn't suffice.
pub(crate) fn quadrature_readers(sizes: Sizes, budget: usize, threads: usize) -> Result<usize, Error> {
    /// Bytes per triangle: for its node in the search tree for the grid's directions, for its corners, and for the
    /// tree's construction.
    const BYTES_PER_TRIANGLE: usize = 250;
    let Sizes { vertices, faces, max_degree, channels, .. } = sizes;
    let grid = 2 * (max_degree + 1) * (max_degree + 1);
    let transform = |n: usize| Transform::bytes(&quadrature_transform(max_degree), n, channels);
    // The arrays are the grid's directions, weights and samples (twice, since samples are reordered for the
    // transform), and the targets, syntheses and residuals.
    let arrays = grid * (32 + 16 * channels) + 24 * channels * vertices + 16 * channels * basis_size(max_degree);
    let held = held(vertices, faces, 1, channels, 1) + BYTES_PER_TRIANGLE * faces;
    let needed = held + arrays + transform(grid)? + transform(vertices)?;
    if needed > budget {
        return Err(Error::Memory { budget, needed });
    }
    Ok((1 + (budget - needed) / reading(vertices, faces, channels).max(1)).min(threads))
}

/// Returns the settings of the transforms for quadrature, which process the channels of two surfaces at a time.
pub(crate) fn quadrature_transform(max_degree: usize) -> TransformParams {
    TransformParams { max_degree, accuracy: FINEST, channels: 6 }
}

/// Returns the settings of a fit's transform.
pub(crate) fn transform(max_degree: usize, channels: usize) -> TransformParams {
    TransformParams { max_degree, accuracy: defaults::TRANSFORM_ACCURACY, channels }
}
