//! Least stretch (E. Praun and H. Hoppe, Spherical parametrization and remeshing, SIGGRAPH 2003).
//!
//! The map grows coarse to fine (`embed.rs`) and makes the L2 stretch of the sphere onto the surface small from the
//! first vertex on: the samples of a uniform grid on the sphere then lie close on the surface. The energy is infinite
//! for a flat triangle, so no vertex can leave its kernel.

use std::time::Instant;

use spharm_surface::Mesh;

use crate::cald::finish;
use crate::descend::Descent;
use crate::domain::Domain;
use crate::embed::Growth;
use crate::energy::Energy;
use crate::{Event, Parametrization, ParametrizeError, Progress};

/// Settings of [`stretch`].
#[derive(Clone, Debug, PartialEq)]
pub struct StretchParams {
    /// Most Newton steps on the whole mesh.
    pub steps: usize,
    /// Of the rotation that the sphere starts from.
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
/// As [`cald`](crate::cald()).
pub fn stretch(
    surface: &Mesh,
    params: &StretchParams,
    progress: Progress<'_>,
) -> Result<Parametrization, ParametrizeError> {
    let started = Instant::now();
    let domain = Domain::new(surface)?;
    let growth = Growth { energy: Energy::STRETCH, steps: 6, seed: params.seed };
    let mut descent = Descent::start(&domain, growth, progress)?;
    progress(Event::Begin { stage: "smoothing", steps: params.steps as u64 });
    descent.descend(Energy::STRETCH, 1e-4, params.steps, progress);
    finish("stretch", surface, &domain, descent, started, Vec::new())
}
