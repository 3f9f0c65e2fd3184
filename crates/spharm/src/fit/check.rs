//! Checks that memory suffices for mapping and fitting a surface, before any work starts.

use spharm_monitor::Silent;
use spharm_surface::{Kind, Mesh, Sphere};

use super::irf;
use super::job::{Job, held};
use super::lsq_plan::{LsqPlan, Sizes, quadrature_readers};
use super::surface_plan::SurfacePlan;
use crate::parametrize::Method as MapMethod;
use crate::{Error, FitParams, Method};

/// Checks that memory suffices to fit a surface over its sphere, which has the same vertices but needn't exist yet.
///
/// The memory plan of a method over a store depends on the store, so such methods aren't checked here but by
/// [`FitParams::check_over`].
///
/// # Errors
///
/// [`Error::Memory`], with the smallest sufficient budget, if memory doesn't suffice.
pub fn check_memory(surface: &Mesh, params: &FitParams) -> Result<(), Error> {
    check_sizes(surface.vertices.len(), surface.faces.len(), params)
}

impl FitParams {
    /// Checks that memory suffices to fit surfaces over a sphere, without fitting them. For a method over a store, also
    /// checks that the store has the basis at the sphere's directions up to the highest degree.
    ///
    /// # Errors
    ///
    /// The errors of [`check_memory`]. For a method over a store, also the errors that a fit of `surfaces` surfaces
    /// would return before its first pass, because of the store or the memory budget.
    pub fn check_over(&self, sphere: &Sphere, surfaces: usize) -> Result<(), Error> {
        if self.method.blocks().is_none() {
            return check_sizes(sphere.directions.len(), sphere.faces.len(), self);
        }
        self.check()?;
        // Don't verify the basis, because the verification would read all of it.
        let params = Self { verify: false, ..self.clone() };
        irf::check(Job::new(sphere, None, &params, &Silent)?, surfaces.max(1))
    }
}

/// Checks the memory as [`check_memory`] does, for a surface of `vertices` vertices and `faces` triangles.
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
