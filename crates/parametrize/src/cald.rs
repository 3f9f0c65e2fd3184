//! Control of area and length distortion (L. Shen and F. Makedon, Image and Vision Computing 24, 2006).
//!
//! The aim is theirs, equal areas with bounded length distortion, by local and global smoothing from a map that is one
//! to one. Local smoothing moves single vertices in their stars; global smoothing moves all of them at once. Both
//! descend the same energy here, area distortion plus a share of shape distortion (`energy.rs`), so neither undoes the
//! other, and no step may flip a triangle. The share of shape goes down from stage to stage until areas are equal
//! enough, and no further: what is left of it keeps the map smooth, and a fit over a smooth map needs fewer degrees.
//!
//! What area distortion is allowed beyond that gives room to what a model errs on (`detail.rs`): at the same distortion a
//! fit over such a map has a fifth to a half less error than over one with areas as they are.

use std::time::Instant;

use spharm_surface::Mesh;

use crate::descend::Descent;
use crate::detail::{adapted, degree_for, detail, normalise};
use crate::domain::Domain;
use crate::embed::Growth;
use crate::energy::Energy;
use crate::{Event, Parametrization, ParametrizeError, Progress, Report};

/// The shares of shape, the last one for whatever comes.
const STAGES: [f64; 13] = [0.3, 0.212, 0.15, 0.11, 0.08, 0.056, 0.04, 0.028, 0.02, 0.014, 0.01, 0.007, 0.005];

/// Of the term that bounds lengths, by the share of shape. At ten times this, areas of figures with arms suffer (homer:
/// 0.15 in place of 0.08).
const BOUND: f64 = 0.02;

/// The part of the area distortion that shape may cost, of what is allowed in all.
const FOR_SHAPE: f64 = 0.75;

/// What is aimed at, of what is allowed: the last smoothing moves areas a little.
const AIM: f64 = 0.98;

/// Rounds of giving room to detail.
const ROUNDS: usize = 4;

/// What the wish for room is multiplied with where it came out as more than is allowed.
const LESS: f64 = 0.9;

/// An error of this share of the surface's radius isn't worth distortion, and isn't told from that of the fit itself.
const NEGLIGIBLE: f64 = 3e-5;

/// Room is kept where it takes the model's error below this share of what it was: a sphere gains nothing by it.
const WORTH: f64 = 0.99;

/// Settings of [`cald`].
#[derive(Clone, Debug, PartialEq)]
pub struct CaldParams {
    /// Root mean square of the log area ratio that may be spent on shape and on room for detail; 0 for areas as equal as
    /// they get.
    pub area: f64,
    /// Degree of the model that room is made for; by default that with half as many functions as there are vertices, at
    /// most 100. No more functions than two thirds of the vertices count.
    pub degree: Option<usize>,
    /// Most Newton steps at each share of shape.
    pub steps: usize,
    /// Of the rotation that the sphere starts from.
    pub seed: u64,
}

impl Default for CaldParams {
    fn default() -> Self {
        Self { area: 0.1, degree: None, steps: 30, seed: 0 }
    }
}

/// Maps a closed surface to the sphere with equal areas, as far as they are allowed to differ, and little length
/// distortion.
///
/// # Errors
///
/// [`ParametrizeError::BadSurface`], and [`ParametrizeError::NoPlace`] or [`ParametrizeError::NotBijective`] where
/// 64-bit numbers don't suffice.
pub fn cald(surface: &Mesh, params: &CaldParams, progress: Progress<'_>) -> Result<Parametrization, ParametrizeError> {
    if !(0.0..=1.0).contains(&params.area) {
        let found = params.area.to_string();
        return Err(ParametrizeError::Argument { what: "area", expected: "a number from 0 to 1", found });
    }
    let started = Instant::now();
    let domain = Domain::new(surface)?;
    let growth = Growth { energy: Energy::balanced(1.0, STAGES[0]), steps: 6, seed: params.seed };
    let mut descent = Descent::start(&domain, growth, progress)?;
    progress(Event::Begin { stage: "smoothing", steps: ((STAGES.len() + 2 * ROUNDS + 1) * params.steps) as u64 });
    let mut energy = growth.energy;
    for (stage, shape) in STAGES.into_iter().enumerate() {
        energy = Energy::bounded(1.0, shape, BOUND * shape);
        descent.descend(energy, 1e-3, params.steps, progress);
        if descent.area_distortion(&domain) <= FOR_SHAPE * params.area {
            progress(Event::Step(((STAGES.len() - stage - 1) * params.steps) as u64));
            break;
        }
    }
    let mut notes = Vec::new();
    let degree = degree_for(domain.positions.len(), params.degree);
    if let Some(factor) = make_room(&domain, &mut descent, energy, degree, params, progress)? {
        notes.push(format!(
            "areas give room to what a model of degree {degree} errs on, up to {factor:.2} times their own"
        ));
    }
    descent.descend(energy, 1e-5, params.steps, progress);
    finish("cald", surface, &domain, descent, started, notes)
}

/// Spends what is left of the allowed area distortion on room for detail; returns by how much areas grow at most, or
/// `None`, and the map as it was, where nothing is left or nothing gained.
fn make_room(
    domain: &Domain,
    descent: &mut Descent,
    energy: Energy,
    degree: usize,
    params: &CaldParams,
    progress: Progress<'_>,
) -> Result<Option<f64>, ParametrizeError> {
    let own = descent.area_distortion(domain);
    let aim = AIM * params.area;
    if own >= aim || degree < 2 {
        return Ok(None);
    }
    let (before, without) = (descent.map.clone(), detail(domain, &descent.map, degree)?);
    if without.error < NEGLIGIBLE {
        return Ok(None);
    }
    let room = (aim * aim - own * own).sqrt();
    let (mut strength, mut applied) = (room, 0.0);
    let mut wanted = without.excess;
    for round in 0..ROUNDS {
        applied = strength;
        descent.set_areas(&adapted(&domain.areas, &wanted, applied));
        descent.descend(energy, 1e-4, params.steps, progress);
        // What was wanted and what came of it differ: shape resists.
        let came = (descent.area_distortion(domain).powi(2) - own * own).max(0.0).sqrt();
        strength *= (room / came).clamp(0.5, 2.0);
        if round == 0 {
            // Where the model errs once there is room is wanted as well.
            let seen = detail(domain, &descent.map, degree)?;
            wanted.iter_mut().zip(&seen.excess).for_each(|(sum, seen)| *sum += seen);
            normalise(&mut wanted);
        }
    }
    for _ in 0..ROUNDS {
        if descent.area_distortion(domain) <= params.area {
            break;
        }
        applied *= LESS;
        descent.set_areas(&adapted(&domain.areas, &wanted, applied));
        descent.descend(energy, 1e-4, params.steps, progress);
    }
    let too_much = descent.area_distortion(domain) > params.area;
    if too_much || detail(domain, &descent.map, degree)?.error > WORTH * without.error {
        descent.map = before;
        descent.set_areas(&domain.areas);
        return Ok(None);
    }
    let most = wanted.iter().copied().fold(0.0, f64::max);
    Ok(Some((applied * most).exp()))
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
