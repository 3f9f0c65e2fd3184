//! The method for those who have no wish: [`cald`](crate::cald()), and [`stretch`](crate::stretch()) where that fails.

use spharm_surface::Mesh;

use crate::{CaldParams, Parametrization, ParametrizeError, Progress, StretchParams, cald, stretch};

/// Maps a closed surface to the sphere by cald, or, where that doesn't come out one to one, by least stretch.
///
/// # Errors
///
/// [`ParametrizeError::BadSurface`] at once; else that of the last method tried.
pub fn auto(surface: &Mesh, params: &CaldParams, progress: Progress<'_>) -> Result<Parametrization, ParametrizeError> {
    match cald(surface, params, progress) {
        Err(first @ (ParametrizeError::NotBijective { .. } | ParametrizeError::NoPlace { .. })) => {
            let mut found =
                stretch(surface, &StretchParams { seed: params.seed, ..StretchParams::default() }, progress)?;
            found.report.notes.push(format!("cald came first and failed: {first}"));
            Ok(found)
        }
        other => other,
    }
}
