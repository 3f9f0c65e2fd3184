//! Control of area and length distortion (L. Shen and F. Makedon, Image and Vision Computing 24, 2006).
//!
//! The aim is theirs, equal areas with bounded length distortion, by local and global smoothing from a map that is one
//! to one. Local smoothing moves single vertices in their stars; global smoothing moves all of them at once. Both
//! descend the same energy here, area distortion plus a share of shape distortion ([`crate::energy`]), so neither undoes
//! the other, and no step may flip a triangle. The share of shape goes down from stage to stage: first the map finds
//! its place, then the areas are made equal.

use std::time::Instant;

use spharm_surface::Mesh;

use crate::domain::Domain;
use crate::embed::{Growth, embed};
use crate::energy::Energy;
use crate::newton::Newton;
use crate::star::sweep;
use crate::{Event, Parametrization, ParametrizeError, Progress, Report};

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
        Self { shape: 0.03, steps: 30, seed: 0 }
    }
}

/// Maps a closed surface to the sphere with equal areas and little length distortion.
///
/// # Errors
///
/// [`ParametrizeError::BadSurface`], and [`ParametrizeError::NoPlace`] or [`ParametrizeError::NotBijective`] where
/// 64-bit numbers don't suffice.
pub fn cald(surface: &Mesh, params: &CaldParams, progress: Progress<'_>) -> Result<Parametrization, ParametrizeError> {
    let started = Instant::now();
    let domain = Domain::new(surface)?;
    let growth = Growth { energy: Energy::balanced(1.0, 0.3), steps: 6, seed: params.seed };
    let (mut map, mut iterations, hierarchy) = embed(&domain.positions, &domain.faces, growth, progress)?;
    let vertices: Vec<u32> = (0..map.len() as u32).collect();
    let newton = Newton::new(map.len(), hierarchy.faces.clone(), hierarchy.shapes.clone());
    let stages = [0.3, 0.1, 0.03].into_iter().filter(|&s| s > params.shape).chain([params.shape]);
    let stages: Vec<f64> = stages.collect();
    progress(Event::Begin { stage: "smoothing", steps: (stages.len() * params.steps) as u64 });
    let mut converged = false;
    for (at, &shape) in stages.iter().enumerate() {
        let energy = Energy::balanced(1.0, shape);
        let tolerance = if at + 1 == stages.len() { 1e-5 } else { 1e-3 };
        sweep(&hierarchy, &mut map, &vertices, energy);
        converged = false;
        for done in 0..params.steps {
            let Some(newton) = &newton else { break };
            let step = newton.step(energy, &mut map);
            if std::env::var_os("TRACE").is_some() {
                eprintln!("{shape} {done} {step:?} {:.1}", started.elapsed().as_secs_f64());
            }
            iterations += 1;
            progress(Event::Step(1));
            if step.taken < 0.2 {
                sweep(&hierarchy, &mut map, &vertices, energy);
            }
            if step.before - step.after < tolerance * (step.before - 4.0 * std::f64::consts::PI) {
                converged = true;
                progress(Event::Step((params.steps - done - 1) as u64));
                break;
            }
        }
    }
    let sphere = domain.sphere(surface, map);
    let mut report = Report::new("cald", surface, &sphere, "remesh the surface, or use the method stretch")?;
    report.iterations = iterations;
    report.converged = converged;
    report.seconds = started.elapsed().as_secs_f64();
    Ok(Parametrization { surface: surface.clone(), sphere, report })
}
