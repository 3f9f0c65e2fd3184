//! Reads spheres from files and reports their warnings.

use std::path::Path;

use spharm::Sphere;
use spharm_surface::SphereWarning;

use super::error::RunError;

/// Reads a sphere by [`spharm::read_sphere`], and calls `warn` with each of its warnings.
///
/// # Errors
///
/// The errors of [`spharm::read_sphere`]. If `strict`, also [`RunError::Strict`] for a sphere whose centre isn't the
/// origin.
pub fn read_sphere(path: &Path, strict: bool, warn: &dyn Fn(&str)) -> Result<Sphere, RunError> {
    let sphere = spharm::read_sphere(path)?;
    for warning in &sphere.warnings {
        let text = format!("{}: {warning}", path.display());
        // A strict run refuses a sphere here only for a varying radius. A sphere that isn't closed is reported when a
        // surface is fitted over it.
        if strict && matches!(warning, SphereWarning::RadiusSpread { .. }) {
            return Err(RunError::Strict(text));
        }
        warn(&text);
    }
    Ok(sphere)
}
