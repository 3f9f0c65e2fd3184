//! Spheres from files, with their warnings.

use std::path::Path;

use spharm::Sphere;
use spharm_surface::SphereWarning;

use super::error::RunError;

/// Reads a sphere, see [`spharm::read_sphere`], and passes on its warnings.
///
/// # Errors
///
/// Those of [`spharm::read_sphere`]; if `strict`, also [`RunError::Strict`] for a centre that isn't the origin.
pub fn read_sphere(path: &Path, strict: bool, warn: &dyn Fn(&str)) -> Result<Sphere, RunError> {
    let sphere = spharm::read_sphere(path)?;
    for warning in &sphere.warnings {
        let text = format!("{}: {warning}", path.display());
        // An open sphere is reported with the surface on it.
        if strict && matches!(warning, SphereWarning::RadiusSpread { .. }) {
            return Err(RunError::Strict(text));
        }
        warn(&text);
    }
    Ok(sphere)
}
