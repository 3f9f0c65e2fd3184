//! A template: a surface that is repaired and mapped to the sphere, resampled at the directions of an icosphere.

use spharm_monitor::Monitor;
use spharm_parametrize::{CaldParams, Input};
use spharm_register::without_counterpart;
use spharm_surface::Mesh;
use spharm_surface::generate::icosphere;
use spharm_surface::topology::area;

use crate::Error;
use crate::parametrize::parametrize_with;

/// Minimum degree of the map, so that thin parts receive directions, whatever the models' degree.
const DEGREE: usize = 40;
/// Distance from the original surface, relative to the square root of its area, from which a place belongs to a cut or
/// a filled hole.
const FILLED: f64 = 0.005;

/// A surface resampled at the directions of an icosphere.
#[derive(Debug, Clone)]
pub struct MappedTemplate {
    /// The mesh whose vertices are the places at the icosphere's directions.
    pub mesh: Mesh,
    /// Whether each direction is on a cut or a filled hole, (n).
    pub masked: Vec<bool>,
    /// Repairs of the surface.
    pub changes: Vec<String>,
}

impl MappedTemplate {
    /// Repairs and maps a surface, cutting handles, and resamples it at the icosphere's directions: vertices lie on the
    /// surface.
    ///
    /// # Errors
    ///
    /// [`Error::Parametrize`] if the surface can't be mapped.
    pub fn new(surface: &Mesh, subdivisions: u32, max_degree: usize, monitor: &dyn Monitor) -> Result<Self, Error> {
        let input = Input::Mesh(surface.clone()).mended().without_handles(monitor)?;
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
