//! Maps a surface to the sphere with the least stretch (E. Praun and H. Hoppe, "Spherical parametrization and
//! remeshing", SIGGRAPH 2003).
//!
//! The map is built coarse to fine (`embed.rs`). At every level the L2 stretch of the map from the sphere to the
//! surface is minimised, so that a uniform grid of samples on the sphere is dense everywhere on the surface. The energy
//! is infinite for a flat triangle, so no triangle can flip.

use std::time::Instant;

use spharm_monitor::Monitor;
use spharm_surface::Mesh;

use crate::descend::{Descent, SMOOTHING};
use crate::domain::Domain;
use crate::embed::Growth;
use crate::energy::Energy;
use crate::error::ParametrizeError;
use crate::report::Parametrization;

/// Settings of [`stretch`].
#[derive(Clone, Debug, PartialEq)]
pub struct StretchParams {
    /// Largest number of Newton steps on the whole mesh. Default 40.
    pub steps: usize,
    /// Seed of the sphere's initial rotation. Default 0.
    pub seed: u64,
}

impl Default for StretchParams {
    fn default() -> Self {
        Self { steps: 40, seed: 0 }
    }
}

/// Maps a closed surface to the sphere with little L2 stretch.
///
/// # Errors
///
/// The errors of [`cald`](crate::cald()), except for `Argument` and `Solver`.
pub fn stretch(
    surface: &Mesh,
    params: &StretchParams,
    monitor: &dyn Monitor,
) -> Result<Parametrization, ParametrizeError> {
    let started = Instant::now();
    let domain = Domain::new(surface, monitor)?;
    let growth = Growth { energy: Energy::STRETCH, steps: 6, seed: params.seed };
    let mut descent = Descent::start(&domain, growth, monitor)?;
    monitor.begin(SMOOTHING, 0);
    descent.descend(Energy::STRETCH, 1e-4, params.steps, monitor)?;
    monitor.end();
    descent.finish("stretch", surface, &domain, started)
}
