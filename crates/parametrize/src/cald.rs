//! Control of area and length distortion (L. Shen and F. Makedon, Image and Vision Computing 24, 2006).
//!
//! The aim is theirs, equal areas with bounded length distortion, by local and global smoothing from a map that is one
//! to one. Local smoothing moves single vertices in their stars; global smoothing moves all of them at once. Both
//! descend the same energy here, area distortion plus a share of shape distortion (`energy.rs`), so neither undoes the
//! other, and no step may flip a triangle. The share of shape goes down from stage to stage: first the map finds its
//! place, then the areas are made equal.

use std::time::Instant;

use spharm_surface::Mesh;

use crate::descend::Descent;
use crate::domain::Domain;
use crate::embed::Growth;
use crate::energy::Energy;
use crate::{Event, Parametrization, ParametrizeError, Progress, Report};

/// The shares of shape on the way to the last one.
const STAGES: [f64; 3] = [0.3, 0.1, 0.03];

/// Settings of [`cald`].
#[derive(Clone, Debug, PartialEq)]
pub struct CaldParams {
    /// The weight of shape against area in the end: smaller makes areas more equal and lengths less.
    pub shape: f64,
    /// Most Newton steps at each weight.
    pub steps: usize,
    /// Of the rotation that the sphere starts from.
    pub seed: u64,
}

impl Default for CaldParams {
    fn default() -> Self {
        Self { shape: 0.02, steps: 30, seed: 0 }
    }
}

/// Maps a closed surface to the sphere with equal areas and little length distortion.
///
/// # Errors
///
/// [`ParametrizeError::BadSurface`], and [`ParametrizeError::NoPlace`] or [`ParametrizeError::NotBijective`] where
/// 64-bit numbers don't suffice.
pub fn cald(surface: &Mesh, params: &CaldParams, progress: Progress<'_>) -> Result<Parametrization, ParametrizeError> {
    if !(params.shape > 0.0 && params.shape.is_finite()) {
        let found = params.shape.to_string();
        return Err(ParametrizeError::Argument { what: "the weight of shape", expected: "a number above 0", found });
    }
    let started = Instant::now();
    let domain = Domain::new(surface)?;
    let growth = Growth { energy: Energy::balanced(1.0, STAGES[0]), steps: 6, seed: params.seed };
    let mut descent = Descent::start(&domain, growth, progress)?;
    let before: Vec<f64> = STAGES.into_iter().filter(|&shape| shape > params.shape).collect();
    progress(Event::Begin { stage: "smoothing", steps: ((before.len() + 1) * params.steps) as u64 });
    for shape in before {
        descent.descend(Energy::balanced(1.0, shape), 1e-3, params.steps, progress);
    }
    descent.descend(Energy::balanced(1.0, params.shape), 1e-5, params.steps, progress);
    finish("cald", surface, &domain, descent, started, Vec::new())
}

/// The report on a map, and the map if it is one to one.
pub(crate) fn finish(
    method: &'static str,
    surface: &Mesh,
    domain: &Domain,
    descent: Descent,
    started: Instant,
    notes: Vec<String>,
) -> Result<Parametrization, ParametrizeError> {
    let sphere = domain.sphere(surface, descent.map);
    let mut report = Report::new(method, surface, &sphere, "remesh the surface so that its triangles are less thin")?;
    report.iterations = descent.iterations;
    report.converged = descent.converged;
    report.seconds = started.elapsed().as_secs_f64();
    report.notes = notes;
    Ok(Parametrization { surface: surface.clone(), sphere, report })
}
