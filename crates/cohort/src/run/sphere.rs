//! Reads spheres from files and reports their warnings.

use std::path::Path;

use spharm::Sphere;
use spharm_surface::SphereWarning;

use super::error::RunError;

/// Reads a sphere with [`spharm::read_sphere`], and calls `warn` with each warning about it.
///
/// # Errors
///
/// The errors of [`spharm::read_sphere`]; if `strict` is set, also [`RunError::Strict`] if the radius varies, as it
/// does if the centre isn't the origin.
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
