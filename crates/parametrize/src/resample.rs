//! Resamples a surface: computes points of the surface for the vertices of another triangulated sphere.
//!
//! If the surfaces of all subjects in a study are resampled on one shared sphere, vertices with the same index
//! correspond, and all fits can use a single basis. Each vertex of the shared sphere is a direction that meets a
//! triangle of the surface's own sphere. The new vertex is the point of the surface with the same barycentric weights
//! ([`SphereLocator`]). If a direction coincides with a vertex of the surface's sphere, the new vertex has exactly that
//! vertex's position. Elsewhere the new vertices lie on the old surface, but the new triangles cut across its edges;
//! [`Resampling::distance`] measures the difference.

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

/// Resamples a surface on the vertices of another sphere.
///
/// `sphere` must have the surface's vertices and triangles; `shared` may be any sphere. Only the directions of the
/// spheres' vertices matter, not their lengths. The result's sphere is an exact copy of `shared`, so a stored basis of
/// `shared` can be used with it.
///
/// # Errors
///
/// [`NotBijective`](ParametrizeError::NotBijective) if one of the spheres has folds;
/// [`Surface`](ParametrizeError::Surface) if a sphere isn't closed, or if `sphere` doesn't match the surface;
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
    // The metadata describe the coordinate space, which is the same for the new surface.
    new.meta.clone_from(&surface.meta);
    let unit = Mesh::new(vertices, shared.faces.clone());
    let mut found = measured("resample", surface, new, unit, started, monitor)?;
    // The shared sphere is used unchanged. Normalising its vectors again could change their last bits, and therefore
    // the key that identifies the sphere's basis.
    found.sphere = shared.clone();
    Ok(found)
}

impl Parametrization {
    /// Returns this map's surface resampled on `shared` by [`resample`], with the reports of both maps merged.
    ///
    /// # Errors
    ///
    /// The errors of [`resample`].
    pub fn resampled(&self, shared: &Mesh, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        Ok(resample(&self.surface, &self.sphere, shared, monitor)?.after(&self.report))
    }
}

/// Verifies that the map of a new surface is one to one, and measures the distance between the given surface and the
/// new one.
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

/// Returns the vertices of a mesh, scaled to length 1.
pub(crate) fn unit_vectors(sphere: &Mesh) -> Result<Vec<Vec3>, ParametrizeError> {
    let wrong =
        |found: String| ParametrizeError::Argument { what: "sphere", expected: "vertices away from the origin", found };
    let directions = Directions::from_vertices(&sphere.vertices).map_err(|error| wrong(error.to_string()))?;
    Ok(directions.as_slice().to_vec())
}

/// Returns a locator for the triangles of a sphere; an error if the sphere has folds.
pub(crate) fn locator(sphere: &Mesh) -> Result<SphereLocator, ParametrizeError> {
    let locator = SphereLocator::new(sphere)?;
    let (flipped, triangles) = (locator.flipped(), sphere.faces.len());
    if flipped > 0 {
        let remedy = "map the surface to a sphere again";
        return Err(ParametrizeError::NotBijective { method: "given", flipped, degenerate: 0, triangles, remedy });
    }
    Ok(locator)
}

/// Returns the point of a surface that corresponds to each direction, found by the locator of the surface's sphere.
pub(crate) fn points(
    locator: &SphereLocator,
    surface: &Mesh,
    directions: &[Vec3],
) -> Result<Vec<Vec3>, ParametrizeError> {
    let values = ArrayView2::from_shape((surface.vertices.len(), 3), surface.vertices.as_flattened());
    // The list has three numbers per vertex, so the conversion can't fail.
    let Ok(values) = values else { return Ok(Vec::new()) };
    let found = locator.interpolate(values, directions)?;
    Ok(found.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
}
