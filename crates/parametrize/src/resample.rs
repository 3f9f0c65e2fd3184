//! Resampling of a surface on another sampling of its sphere.
//!
//! If every subject of a study has the same vertices over the same sphere, one basis serves them all and vertices
//! correspond. Each direction of the shared sphere meets a triangle of the surface's own sphere; the new vertex is the
//! point of the surface with the same barycentric weights ([`SphereLocator`]). A vertex that both spheres have in
//! common keeps its position to the last bit. Elsewhere the new surface has its vertices on the old one and its
//! triangles cut corners; [`Resampling::distance`] measures the difference.

use std::time::Instant;

use ndarray::ArrayView2;
use spharm_harmonics::Directions;
use spharm_monitor::{Monitor, Stage};
use spharm_surface::Mesh;
use spharm_surface::locator::SphereLocator;
use spharm_surface::metrics::{SurfaceDistanceParams, surface_distance};

use crate::error::ParametrizeError;
use crate::geometry::Vec3;
use crate::report::{Note, Parametrization, Resampling};

/// Number of vertices between checks of the monitor and reports of progress.
pub(crate) const CHUNK: usize = 4096;

/// Resamples a surface on another sphere.
///
/// `sphere` must have the surface's vertices and triangles; `shared` may be any sphere. Only the directions of their
/// vertices matter. The result's sphere is an exact copy of `shared`, so that a stored basis of `shared` serves it.
///
/// # Errors
///
/// [`NotBijective`](ParametrizeError::NotBijective) if one of the spheres has folds;
/// [`Surface`](ParametrizeError::Surface) if they aren't closed, or the surface doesn't belong to the sphere;
/// [`Argument`](ParametrizeError::Argument) for a sphere with a vertex at the origin;
/// [`Interrupted`](ParametrizeError::Interrupted).
pub fn resample(
    surface: &Mesh,
    sphere: &Mesh,
    shared: &Mesh,
    monitor: &dyn Monitor,
) -> Result<Parametrization, ParametrizeError> {
    let started = Instant::now();
    let locator = locator(sphere)?;
    let vertices = unit_vectors(shared)?;
    monitor.begin(Stage::counted("resampling", "vertices"), vertices.len() as u64);
    let mut positions = Vec::with_capacity(vertices.len());
    for chunk in vertices.chunks(CHUNK) {
        positions.extend(points(&locator, surface, chunk)?);
        monitor.step(chunk.len() as u64);
        monitor.check()?;
    }
    monitor.end();
    let mut new = Mesh::new(positions, shared.faces.clone());
    // The surface's metadata describe its space, which the new surface shares.
    new.meta.clone_from(&surface.meta);
    let unit = Mesh::new(vertices, shared.faces.clone());
    let mut found = measured("resample", surface, new, unit, started, monitor)?;
    // Normalising vectors of length 1 once more may change their last bits, and with them the key of their basis, so
    // the shared sphere is used unchanged.
    found.sphere = shared.clone();
    Ok(found)
}

impl Parametrization {
    /// Returns this map's surface resampled on `shared`, by [`resample`]; the reports are merged.
    ///
    /// # Errors
    ///
    /// As [`resample`].
    pub fn resampled(&self, shared: &Mesh, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        Ok(resample(&self.surface, &self.sphere, shared, monitor)?.after(&self.report))
    }
}

/// Verifies a new surface's map, and measures the surface's distance from the given one.
pub(crate) fn measured(
    method: &'static str,
    given: &Mesh,
    surface: Mesh,
    sphere: Mesh,
    started: Instant,
    monitor: &dyn Monitor,
) -> Result<Parametrization, ParametrizeError> {
    let mut found = Parametrization::checked(method, surface, sphere, started, "give a sphere without folds")?;
    let distance = surface_distance(given, &found.surface, &SurfaceDistanceParams::default(), monitor)?;
    found.report.converged = true;
    found.report.notes.push(Note::Distance(distance));
    found.report.seconds = started.elapsed().as_secs_f64();
    found.resampling = Some(Resampling { distance, self_intersections: None });
    Ok(found)
}

/// Returns a mesh's vertices as unit vectors.
pub(crate) fn unit_vectors(sphere: &Mesh) -> Result<Vec<Vec3>, ParametrizeError> {
    let wrong =
        |found: String| ParametrizeError::Argument { what: "sphere", expected: "vertices off the origin", found };
    let directions = Directions::from_vertices(&sphere.vertices).map_err(|error| wrong(error.to_string()))?;
    Ok(directions.as_slice().to_vec())
}

/// Returns a locator over a sphere, or an error if the sphere has folds.
pub(crate) fn locator(sphere: &Mesh) -> Result<SphereLocator, ParametrizeError> {
    let locator = SphereLocator::new(sphere)?;
    let (flipped, triangles) = (locator.flipped(), sphere.faces.len());
    if flipped > 0 {
        let remedy = "map the surface anew";
        return Err(ParametrizeError::NotBijective { method: "given", flipped, degenerate: 0, triangles, remedy });
    }
    Ok(locator)
}

/// Returns the points of a surface in the given directions.
pub(crate) fn points(
    locator: &SphereLocator,
    surface: &Mesh,
    directions: &[Vec3],
) -> Result<Vec<Vec3>, ParametrizeError> {
    let values = ArrayView2::from_shape((surface.vertices.len(), 3), surface.vertices.as_flattened());
    // A list of triples is (n, 3) for any n.
    let Ok(values) = values else { return Ok(Vec::new()) };
    let found = locator.interpolate(values, directions)?;
    Ok(found.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
}
