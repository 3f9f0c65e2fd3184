//! Maps a template to the sphere: the surface is repaired, mapped, and resampled at the directions of an icosphere.

use spharm_monitor::Monitor;
use spharm_parametrize::{CaldParams, Input, ParametrizeError};
use spharm_register::without_counterpart;
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::topology::area;

use crate::Error;
use crate::parametrize::parametrize_with;

/// Lowest degree for which the template is mapped to the sphere, even if the group's models have a lower degree. With a
/// lower value, too few directions might lie on thin parts of the surface.
const DEGREE: usize = 40;
/// Minimum distance from the original surface at which a point is treated as lying on a cut or a filled hole, relative
/// to the square root of the surface's area.
const FILLED: f64 = 0.005;

/// A surface resampled at the directions of an icosphere.
#[derive(Debug, Clone)]
pub struct MappedTemplate {
    /// Mesh whose vertices are the surface's points at the icosphere's directions.
    pub mesh: Mesh,
    /// For each of the n directions, whether it lies on a cut or a filled hole.
    pub masked: Vec<bool>,
    /// Repairs that were made to the surface.
    pub changes: Vec<String>,
}

impl MappedTemplate {
    /// Repairs a surface, cuts its handles, maps it to the sphere, and resamples it at the icosphere's directions. The
    /// vertices of the result lie on the repaired surface.
    ///
    /// # Errors
    ///
    /// [`Error::Parametrize`] if the surface can't be mapped.
    pub fn new(surface: &Mesh, subdivisions: u32, max_degree: usize, monitor: &dyn Monitor) -> Result<Self, Error> {
        let input = Input::Mesh(surface.clone()).mended(monitor)?;
        if let Some(repair) = input.mesh_repair().filter(|repair| repair.filled_area > crate::FILLED) {
            let expected = "a surface that is closed or has only small holes";
            let found = format!("{}; fill the holes, or choose another template", repair.drops_and_fills());
            return Err(ParametrizeError::Argument { what: "template", expected, found }.into());
        }
        let input = input.without_handles(monitor)?;
        let changes = input.changes(true);
        let map = CaldParams::for_degree(max_degree.max(DEGREE));
        let mapped = parametrize_with(&input, &map, monitor)?;
        let mesh = mapped.map.resampled(&icosphere(subdivisions), monitor)?.surface;
        let masked = if changes.is_empty() {
            vec![false; mesh.vertices.len()]
        } else {
            without_counterpart(&mesh, surface, FILLED * area(surface).sqrt())
        };
        Ok(Self { mesh, masked, changes })
    }
}
