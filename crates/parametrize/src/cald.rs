//! Maps a surface to the sphere with nearly equal areas and bounded length distortion by CALD, the control of area and
//! length distortion (L. Shen and F. Makedon, "Spherical mapping for processing of 3D closed surfaces", Image and
//! Vision Computing 24, 2006).
//!
//! As in the paper, local and global smoothing start from a one-to-one map. Local smoothing moves single vertices
//! within the triangles around them; global smoothing moves all vertices at once. Unlike in the paper, both kinds of
//! smoothing minimise the same energy: area distortion plus weighted shape distortion (`energy.rs`), so neither undoes
//! the work of the other. No step may flip a triangle. The weight of shape distortion is lowered from stage to stage
//! until areas are equal enough, but no further. The remaining weight keeps the map smooth, and a fit over a smooth map
//! needs fewer degrees.
//!
//! If the area distortion is then smaller than allowed, the remaining allowance is used for residual-adaptive areas
//! (`residual_areas.rs`). Each round gives more of the sphere, and so more samples, to parts of the surface where a
//! model's residual is large. The rounds continue as long as the error of a fit decreases. The error of a fit over such
//! a map is a fifth to a half smaller than that of a fit over a map that keeps the surface's own areas.

use std::time::Instant;

use spharm_monitor::Monitor;
use spharm_surface::Mesh;

use crate::descend::{Descent, SMOOTHING};
use crate::domain::Domain;
use crate::embed::Growth;
use crate::energy::Energy;
use crate::error::ParametrizeError;
use crate::report::{Note, Parametrization};
use crate::residual_areas::{adapted, degree_for, residual};

/// Weight of shape distortion in the energy, for each stage.
const STAGES: [f64; 13] = [0.3, 0.212, 0.15, 0.11, 0.08, 0.056, 0.04, 0.028, 0.02, 0.014, 0.01, 0.007, 0.005];

/// Weight of the term that bounds lengths, relative to the weight of shape distortion. At ten times this value, the
/// area distortion of surfaces that have arms nearly doubles (0.15 instead of 0.08 for the surface `homer`).
const BOUND: f64 = 0.02;

/// Share of the allowed area distortion that may be used to lower the shape distortion.
const FOR_SHAPE: f64 = 0.75;

/// Target of the area distortion when areas are adapted, as a share of the allowed distortion. The remaining share is a
/// margin for the last smoothing, which still changes areas slightly.
const AIM: f64 = 0.98;

/// Largest area distortion accepted in exchange for lower shape distortion. A larger area distortion increases the
/// error of a fit.
const MOST_FOR_SHAPE: f64 = 0.3;

/// Largest number of rounds that adapt the target areas.
const ROUNDS: usize = 8;

/// Largest change in target areas per round, measured as the root mean square of the logarithms of the factors by which
/// the areas are multiplied.
const STEP: f64 = 0.2;

/// The rounds end when the largest change that the next round may make, measured like [`STEP`], is below this value.
const SMALLEST_STEP: f64 = 0.03;

/// Areas aren't adapted if the residual, relative to the surface's radius, is below this value. A residual this small
/// can't be distinguished from the error of the fit itself.
const NEGLIGIBLE: f64 = 3e-5;

/// A round is kept only if it reduces the residual to less than this share of its previous value. If the surface is a
/// sphere, no round achieves this, so no round is kept.
const WORTHWHILE: f64 = 0.99;

/// Settings of [`cald`].
#[derive(Clone, Debug, PartialEq)]
pub struct CaldParams {
    /// Allowed area distortion, from 0 to 1: the root mean square of the triangles' log area ratios. With 0, areas are
    /// made as equal as possible. Default 0.1. The allowance is used to lower the shape distortion and to adapt areas
    /// to the residual.
    pub area: f64,
    /// Degree of the model whose residual determines how areas are adapted. If the degree is below 2, areas aren't
    /// adapted. Default `None`: the degree at which a model has half as many basis functions as the surface has
    /// vertices, but at most 100. In any case the model has at most two thirds as many basis functions as there are
    /// vertices.
    pub degree: Option<usize>,
    /// Largest number of Newton steps in each stage. Default 30.
    pub steps: usize,
    /// Seed of the sphere's initial rotation; different seeds give different maps of the same quality. Default 0.
    pub seed: u64,
}

impl Default for CaldParams {
    fn default() -> Self {
        Self { area: 0.1, degree: None, steps: 30, seed: 0 }
    }
}

impl CaldParams {
    /// Returns settings for a map that only serves as the domain of a fit of degree `max_degree`. The settings allow an
    /// area distortion of up to 0.8, as long as the distortion lowers the error of the fit.
    #[must_use]
    pub fn for_degree(max_degree: usize) -> Self {
        Self { area: 0.8, degree: Some(max_degree), ..Self::default() }
    }
}

/// Maps a closed surface to the sphere with little length distortion. Areas are equal up to the allowed distortion.
///
/// # Errors
///
/// [`ParametrizeError::InvalidMesh`] if coordinates aren't finite or indices are out of range;
/// [`ParametrizeError::BadSurface`] if the mesh isn't a closed surface of genus zero, or has degenerate triangles;
/// [`ParametrizeError::OneSided`] or [`ParametrizeError::OpenSheet`] if the mesh can't enclose a body;
/// [`ParametrizeError::Argument`] if `area` is outside of 0 to 1; [`ParametrizeError::NoPlace`] or
/// [`ParametrizeError::NotBijective`] if 64-bit numbers aren't precise enough for the map; [`ParametrizeError::Solver`]
/// if the fit used for the adaptation fails; [`ParametrizeError::Interrupted`].
pub fn cald(surface: &Mesh, params: &CaldParams, monitor: &dyn Monitor) -> Result<Parametrization, ParametrizeError> {
    if !(0.0..=1.0).contains(&params.area) {
        let found = params.area.to_string();
        return Err(ParametrizeError::Argument { what: "area", expected: "a number from 0 to 1", found });
    }
    let started = Instant::now();
    let domain = Domain::new(surface, monitor)?;
    let growth = Growth { energy: Energy::balanced(1.0, STAGES[0]), steps: 6, seed: params.seed };
    let mut descent = Descent::start(&domain, growth, monitor)?;
    monitor.begin(SMOOTHING, 0);
    let mut energy = growth.energy;
    for shape in STAGES {
        energy = Energy::bounded(1.0, shape, BOUND * shape);
        descent.descend(energy, 1e-3, params.steps, monitor)?;
        if descent.area_distortion(&domain) <= (FOR_SHAPE * params.area).min(MOST_FOR_SHAPE) {
            break;
        }
    }
    let degree = degree_for(domain.positions.len(), params.degree);
    let adapted = adapt_areas(&domain, &mut descent, energy, degree, params, monitor)?;
    descent.descend(energy, 1e-5, params.steps, monitor)?;
    monitor.end();
    let mut found = descent.finish("cald", surface, &domain, started)?;
    found.report.notes.extend(adapted.map(|factor| Note::AreasAdapted { degree, factor }));
    Ok(found)
}

/// Adapts areas to the residual of a fit, within the remaining allowance for area distortion, as long as the error of
/// the fit decreases. Returns the largest factor by which the target area of a triangle has grown. Returns `None` and
/// leaves the map unchanged if no allowance remains or the error didn't decrease.
///
/// Each round multiplies the target areas by factors derived from the residual of the last fit. A round that exceeds
/// the allowed distortion, or doesn't lower the residual, is undone and tried again with smaller factors.
fn adapt_areas(
    domain: &Domain,
    descent: &mut Descent,
    energy: Energy,
    degree: usize,
    params: &CaldParams,
    monitor: &dyn Monitor,
) -> Result<Option<f64>, ParametrizeError> {
    // The squares of the present distortion and of the distortion still to be added are assumed to sum to the square of
    // the allowed distortion, which is nearly true.
    let left = |descent: &Descent| {
        let spent = descent.area_distortion(domain);
        (AIM * params.area * AIM * params.area - spent * spent).max(0.0).sqrt()
    };
    if left(descent) < SMALLEST_STEP || degree < 2 {
        return Ok(None);
    }
    let mut seen = residual(domain, &descent.map, degree, monitor)?;
    if seen.rms < NEGLIGIBLE {
        return Ok(None);
    }
    let mut kept = descent.map.clone();
    // Logarithms of the factors applied to the areas.
    let mut factors = vec![0.0; domain.faces.len()];
    let (mut adapts, mut step) = (false, STEP);
    for _ in 0..ROUNDS {
        step = left(descent).min(step);
        if step < SMALLEST_STEP {
            break;
        }
        let tried: Vec<f64> = factors.iter().zip(&seen.excess).map(|(factor, excess)| factor + step * excess).collect();
        descent.set_areas(&adapted(&domain.areas, &tried));
        descent.descend(energy, 1e-3, params.steps, monitor)?;
        let allowed = descent.area_distortion(domain) <= params.area;
        let found = if allowed { Some(residual(domain, &descent.map, degree, monitor)?) } else { None };
        match found.filter(|found| found.rms < WORTHWHILE * seen.rms) {
            Some(found) => (adapts, seen, factors, kept) = (true, found, tried, descent.map.clone()),
            None => {
                descent.map.clone_from(&kept);
                step *= 0.5;
            }
        }
    }
    descent.set_areas(&adapted(&domain.areas, &factors));
    let most = factors.iter().copied().fold(0.0, f64::max);
    Ok(adapts.then(|| most.exp()))
}
