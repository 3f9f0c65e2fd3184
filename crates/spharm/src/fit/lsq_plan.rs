//! The memory that a full least squares by transforms takes beside a factor.

use spharm_harmonics::basis_size;
use spharm_surface::Mesh;
use spharm_transform::{Transform, TransformParams};

use super::job::held;
use crate::{Error, FitParams, Method, defaults};

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
}

/// Sizes of a fit.
#[derive(Clone, Copy)]
pub(crate) struct Sizes {
    pub(crate) vertices: usize,
    pub(crate) faces: usize,
    pub(crate) max_degree: usize,
    pub(crate) channels: usize,
    pub(crate) threads: usize,
}

impl LsqPlan {
    /// Plans fits of targets with so many channels, with as many of them in a transform as the budget allows.
    ///
    /// # Errors
    ///
    /// [`Error::Memory`] where one target doesn't fit the budget.
    pub(crate) fn new(sizes: Sizes, budget: usize) -> Result<Self, Error> {
        let Sizes { vertices, faces, max_degree, channels, threads } = sizes;
        // Targets and residual, and the samples between; the vectors of conjugate gradients.
        let each = 8 * channels * (4 * vertices + 8 * basis_size(max_degree));
        let held = held(vertices, faces, 1, channels, threads);
        let fixed = |at_a_time: usize| -> Result<usize, Error> {
            Ok(held + Transform::bytes(&transform(max_degree, at_a_time), vertices, at_a_time)?)
        };
        let at_a_time = channels.clamp(1, CHANNELS_AT_A_TIME);
        let mut plan = Self { budget, channels_at_a_time: at_a_time, fixed: fixed(at_a_time)?, each };
        while plan.channels_at_a_time > 1 && plan.needed(1) > budget {
            plan.channels_at_a_time -= 1;
            plan.fixed = fixed(plan.channels_at_a_time)?;
        }
        if plan.needed(1) > budget {
            return Err(Error::Memory { budget, needed: plan.needed(1) });
        }
        Ok(plan)
    }

    /// Bytes for so many targets together.
    pub(crate) fn needed(&self, together: usize) -> usize {
        self.fixed + together * self.each
    }
}

/// The settings of the transform of a fit.
pub(crate) fn transform(max_degree: usize, channels: usize) -> TransformParams {
    TransformParams { max_degree, accuracy: defaults::TRANSFORM_ACCURACY, channels }
}

/// Checks that the memory suffices to fit a surface over a sphere with its vertices, before that sphere is made.
///
/// The plan of a fit over a store depends on the store, so those methods are checked when the fit starts.
///
/// # Errors
///
/// [`Error::Memory`] with the least that works.
pub fn check_memory(surface: &Mesh, params: &FitParams) -> Result<(), Error> {
    if params.method != Method::Lsq {
        return Ok(());
    }
    let sizes = Sizes {
        vertices: surface.vertices.len(),
        faces: surface.faces.len(),
        max_degree: params.max_degree,
        channels: 3,
        threads: params.threads.unwrap_or_else(rayon::current_num_threads),
    };
    LsqPlan::new(sizes, params.memory_budget()).map(drop)
}
