//! Checks that memory suffices for mapping and fitting a surface, before any work starts.

use spharm_surface::{Kind, Mesh};

use super::job::held;
use super::lsq_plan::{LsqPlan, Sizes, quadrature_readers};
use super::surface_plan::SurfacePlan;
use crate::parametrize::Method as MapMethod;
use crate::{Error, FitParams, Method};

/// Checks that memory suffices to fit a surface over a sphere with the same vertices, before that sphere exists.
///
/// The memory plan of a method over a store depends on the store, so that such a method is checked only when its fit
/// starts.
///
/// # Errors
///
/// [`Error::Memory`], with the smallest sufficient budget, if memory doesn't suffice.
pub fn check_memory(surface: &Mesh, params: &FitParams) -> Result<(), Error> {
    check_sizes(surface.vertices.len(), surface.faces.len(), params)
}

/// Checks the memory like [`check_memory`], for a surface of `vertices` vertices and `faces` triangles.
pub(crate) fn check_sizes(vertices: usize, faces: usize, params: &FitParams) -> Result<(), Error> {
    let sizes = Sizes { vertices, faces, max_degree: params.max_degree, channels: 3, denoise: params.denoise };
    match params.method {
        Method::Lsq if params.fits_surface(Kind::Surface, true) => {
            SurfacePlan::new(sizes, params.memory_budget(), 1).map(drop)
        }
        Method::Lsq => LsqPlan::new(sizes, params.memory_budget()).map(drop),
        Method::Quadrature => quadrature_readers(sizes, params.memory_budget(), 1).map(drop),
        _ => Ok(()),
    }
}

/// Checks that memory suffices to map a surface with `vertices` vertices to a sphere, as
/// [`fit_mesh`](crate::fit_mesh()) does.
///
/// # Errors
///
/// [`Error::Memory`], with the smallest sufficient budget, if memory doesn't suffice.
pub fn check_mapping(vertices: usize, params: &FitParams) -> Result<(), Error> {
    let method = MapMethod::Auto(params.map());
    let mapping = usize::try_from(method.bytes(vertices)).unwrap_or(usize::MAX);
    let (budget, needed) = (params.memory_budget(), mapping.saturating_add(held(0, 0, 0, 0, 0)));
    if needed > budget { Err(Error::Memory { budget, needed }) } else { Ok(()) }
}
