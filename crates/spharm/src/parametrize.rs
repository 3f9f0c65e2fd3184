//! A sphere for a surface that comes without one.

use spharm_monitor::{Monitor, Silent, Stage};
use spharm_parametrize::{Event, auto};
use spharm_surface::{Mesh, Sphere};

use crate::Error;

pub use spharm_parametrize::{CaldParams, Report};

/// A surface and its map to the sphere.
#[derive(Debug, Clone)]
pub struct Parametrized {
    /// The surface: the mesh that was given.
    pub surface: Mesh,
    /// The sphere, with the surface's vertices and triangles.
    pub sphere: Sphere,
    /// Quality of the map, and how it was found.
    pub report: Report,
}

/// Maps a closed surface of genus zero to the sphere, one to one, by the default method: equal areas with little length
/// distortion (Shen and Makedon 2006), and least stretch where that fails.
///
/// # Errors
///
/// [`Error::Parametrize`] with what keeps the surface from being mapped.
pub fn parametrize(surface: &Mesh, params: &CaldParams) -> Result<Parametrized, Error> {
    parametrize_with(surface, params, &Silent)
}

/// As [`parametrize`](parametrize()), with progress.
///
/// # Errors
///
/// Those of [`parametrize`](parametrize()).
pub fn parametrize_with(surface: &Mesh, params: &CaldParams, monitor: &dyn Monitor) -> Result<Parametrized, Error> {
    let mut show = |event| match event {
        Event::Begin { stage, steps } => monitor.begin(Stage::counted(stage, "steps"), steps),
        Event::Step(steps) => monitor.step(steps),
        _ => {}
    };
    let found = auto(surface, params, &mut show)?;
    monitor.end();
    let sphere = Sphere { parametrized: true, ..Sphere::from_mesh(&found.sphere)? };
    Ok(Parametrized { surface: found.surface, sphere, report: found.report })
}
