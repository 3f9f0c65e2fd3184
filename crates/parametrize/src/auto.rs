//! Maps a surface to the sphere by the default method: [`cald`](crate::cald()), or [`stretch`](crate::stretch()) if
//! `cald` fails.

use spharm_monitor::{Monitor, Silent};
use spharm_surface::Mesh;

use crate::cald::{CaldParams, cald};
use crate::error::ParametrizeError;
use crate::report::{Parametrization, Warning};
use crate::stretch::{StretchParams, stretch};

/// Maps a closed surface to the sphere by [`cald`](crate::cald()). If cald finds no one-to-one map, the surface is
/// mapped by [`stretch`](crate::stretch()) instead, and the report contains [`Warning::FellBack`].
///
/// # Errors
///
/// The error of `cald`, unless it is [`ParametrizeError::NotBijective`] or [`ParametrizeError::NoPlace`]; the error of
/// `stretch` if both methods fail.
pub fn auto(surface: &Mesh, params: &CaldParams, monitor: &dyn Monitor) -> Result<Parametrization, ParametrizeError> {
    match cald(surface, params, monitor) {
        Err(first @ (ParametrizeError::NotBijective { .. } | ParametrizeError::NoPlace { .. })) => {
            let mut found =
                stretch(surface, &StretchParams { seed: params.seed, ..StretchParams::default() }, monitor)?;
            found.report.warnings.push(Warning::FellBack { method: "cald", cause: first.to_string() });
            Ok(found)
        }
        other => other,
    }
}

/// Maps a closed surface to the sphere by the default method. Equivalent to [`auto`] with a monitor that does nothing.
///
/// # Errors
///
/// The errors of [`auto`].
pub fn parametrize(surface: &Mesh, params: &CaldParams) -> Result<Parametrization, ParametrizeError> {
    auto(surface, params, &Silent)
}
