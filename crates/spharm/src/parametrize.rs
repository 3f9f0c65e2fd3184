//! Maps surfaces without a sphere to the sphere.
//!
//! [`parametrize`](parametrize()) is the default method and returns a [`Sphere`] to fit over. The methods of
//! `spharm-parametrize` are available individually, and as values of [`Method`]; `Parametrized::try_from` converts
//! their results to a sphere.

use spharm_monitor::{Monitor, Silent};
use spharm_surface::{Mesh, Sphere, Target};

use crate::Error;

pub use spharm_parametrize::{
    CaldParams, ConformalParams, CutSurface, DeformParams, EqualAreaParams, Given, HandlesReport, Input, Method, Note,
    Parametrization, ParametrizeError, Quality, Report, Resampling, Sampling, Source, StretchParams, Warning,
    area_deviation, auto, cald, conformal, cut_handles, defects, deform, equal_area, fill_in, handles, quality,
    resample, stretch, volume, wrap,
};

/// A surface's map to the sphere.
#[derive(Debug, Clone)]
pub struct Parametrized {
    /// The sphere, with the surface's vertices and triangles.
    pub sphere: Sphere,
    /// The surface and the sphere as meshes, and a report on the map.
    pub map: Parametrization,
}

impl TryFrom<Parametrization> for Parametrized {
    type Error = Error;

    fn try_from(map: Parametrization) -> Result<Self, Error> {
        let sphere = Sphere { parametrized: true, ..Sphere::from_mesh(&map.sphere)? };
        Ok(Self { sphere, map })
    }
}

/// Maps a closed surface of genus zero one to one to the sphere by the default method: equal areas with little length
/// distortion (Shen and Makedon 2006), or least stretch if that fails.
///
/// # Errors
///
/// [`Error::Parametrize`], with the reason, if the surface can't be mapped.
pub fn parametrize(surface: &Mesh, params: &CaldParams) -> Result<Parametrized, Error> {
    parametrize_with(surface, params, &Silent)
}

/// Maps a surface as [`parametrize`](parametrize()) does, with progress and cancellation. Also maps the quadrangles
/// around a label of a volume, which get equal areas (Brechbuehler, Gerig and Kuebler 1995).
///
/// # Errors
///
/// The errors of [`parametrize`](parametrize()).
pub fn parametrize_with<'a>(
    surface: impl Into<Source<'a>>,
    params: &CaldParams,
    monitor: &dyn Monitor,
) -> Result<Parametrized, Error> {
    Method::Auto(params.clone()).run(surface, monitor)?.try_into()
}

/// Returns the map from a surface to the sphere that is given by `sphere`, a mesh with the surface's triangles and the
/// images of the surface's vertices.
///
/// # Errors
///
/// [`Error::Surface`] if the sphere's vertices and triangles don't match those of the surface, [`Error::Parametrize`]
/// if the map isn't one to one.
pub fn with_sphere(surface: &Mesh, sphere: &Mesh) -> Result<Parametrized, Error> {
    Target::from_mesh(surface, &Sphere::from_mesh(sphere)?)?;
    Parametrization::given(surface.clone(), sphere.clone())?.try_into()
}
