//! The method for those who have no wish: [`cald`](crate::cald()), and [`stretch`](crate::stretch()) where that fails.

use spharm_surface::Mesh;

use crate::{CaldParams, Parametrization, ParametrizeError, Progress, StretchParams, cald, stretch};

/// Maps a closed surface to the sphere by the method that fits it best among those that come out one to one.
///
/// # Errors
///
/// [`ParametrizeError::BadSurface`] at once; else that of the last method tried.
pub fn auto(surface: &Mesh, seed: u64, progress: Progress<'_>) -> Result<Parametrization, ParametrizeError> {
    match cald(surface, &CaldParams { seed, ..CaldParams::default() }, progress) {
        Err(first @ (ParametrizeError::NotBijective { .. } | ParametrizeError::NoPlace { .. })) => {
            let mut found = stretch(surface, &StretchParams { seed, ..StretchParams::default() }, progress)?;
            found.report.notes.push(format!("cald came first and failed: {first}"));
            Ok(found)
        }
        other => other,
    }
}
