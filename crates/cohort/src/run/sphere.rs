//! Reads spheres, reports warnings about them, and looks up the scalar type of their bases in a store.

use std::path::Path;

use spharm::store::{Scalar, Scheme};
use spharm::{FitParams, Method, Sphere};
use spharm_surface::SphereWarning;

use super::error::RunError;

/// Reads a sphere with [`spharm::read_sphere`], and calls `warn` with each warning about it.
///
/// # Errors
///
/// The errors of [`spharm::read_sphere`]; if `strict` is set, also [`RunError::Strict`] if the radius varies, for
/// example because the centre isn't the origin.
pub fn read_sphere(path: &Path, strict: bool, warn: &dyn Fn(&str)) -> Result<Sphere, RunError> {
    let sphere = spharm::read_sphere(path)?;
    for warning in &sphere.warnings {
        let text = format!("{}: {warning}", path.display());
        // Here, a strict run refuses a sphere only if its radius varies. A sphere that isn't closed is reported later,
        // when a surface is fitted over it.
        if strict && matches!(warning, SphereWarning::RadiusSpread { .. }) {
            return Err(RunError::Strict(text));
        }
        warn(&text);
    }
    Ok(sphere)
}

/// Returns the scalar type of the basis at a sphere's directions: the requested one, or the one found in the store.
/// Returns `None` if the method uses no store, or if the basis can't be opened.
pub(super) fn scalar_at(sphere: &Sphere, params: &FitParams) -> Option<Scalar> {
    let of_store = || {
        let store = params.store.as_ref().filter(|_| !matches!(params.method, Method::Lsq | Method::Quadrature))?;
        Some(Scheme::open_at(store, &sphere.directions, None, params.max_degree).ok()?.scalar())
    };
    params.scalar.or_else(of_store)
}
