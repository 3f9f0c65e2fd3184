//! A surface on another sampling of its sphere.
//!
//! Where every subject of a study has the same vertices over the same sphere, one basis serves them all and vertices
//! correspond. For each direction of the shared sphere: the triangle of the surface's own sphere that the ray meets,
//! and the point of the surface with the same barycentric weights ([`SphereLocator`]). Where the two spheres have a
//! vertex in common it keeps its position to the last bit; elsewhere the new surface has its vertices on the old one
//! and its triangles cut corners; [`Resampling::distance`] measures how far.

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

/// Vertices between which the monitor is asked and given the progress.
pub(crate) const CHUNK: usize = 4096;

/// Puts a surface on the sampling of another sphere.
///
/// `sphere` has the surface's vertices and triangles, `shared` any; only their directions count. The result's sphere is
/// `shared`, bit for bit and of its radius, so that its basis is found under the same key.
///
/// # Errors
///
/// [`NotBijective`](ParametrizeError::NotBijective) where one of the spheres has folds;
/// [`Surface`](ParametrizeError::Surface) where they aren't closed, or the surface isn't the sphere's;
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
    // The surface's metadata speak of its space, which the new surface shares.
    new.meta.clone_from(&surface.meta);
    let unit = Mesh::new(vertices, shared.faces.clone());
    let mut found = measured("resample", surface, new, unit, started, monitor)?;
    // Vectors of length 1 may change in their last bits when they are normalised once more, and with them the key of
    // their basis: the shared sphere stays as it is.
    found.sphere = shared.clone();
    Ok(found)
}

impl Parametrization {
    /// This map's surface on the sampling of `shared`, by [`resample`]; the reports are joined.
    ///
    /// # Errors
    ///
    /// As [`resample`].
    pub fn resampled(&self, shared: &Mesh, monitor: &dyn Monitor) -> Result<Self, ParametrizeError> {
        Ok(resample(&self.surface, &self.sphere, shared, monitor)?.after(&self.report))
    }
}

/// Checks a new surface's map, and measures the surface against the given one.
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

/// A mesh's vertices as directions.
pub(crate) fn unit_vectors(sphere: &Mesh) -> Result<Vec<Vec3>, ParametrizeError> {
    let wrong =
        |found: String| ParametrizeError::Argument { what: "sphere", expected: "vertices off the origin", found };
    let directions = Directions::from_vertices(&sphere.vertices).map_err(|error| wrong(error.to_string()))?;
    Ok(directions.as_slice().to_vec())
}

/// A locator over a sphere without folds.
pub(crate) fn locator(sphere: &Mesh) -> Result<SphereLocator, ParametrizeError> {
    let locator = SphereLocator::new(sphere)?;
    let (flipped, triangles) = (locator.flipped(), sphere.faces.len());
    if flipped > 0 {
        let remedy = "map the surface anew";
        return Err(ParametrizeError::NotBijective { method: "given", flipped, degenerate: 0, triangles, remedy });
    }
    Ok(locator)
}

/// The points of a surface under directions.
pub(crate) fn points(
    locator: &SphereLocator,
    surface: &Mesh,
    directions: &[Vec3],
) -> Result<Vec<Vec3>, ParametrizeError> {
    let values = ArrayView2::from_shape((surface.vertices.len(), 3), surface.vertices.as_flattened());
    // A list of triples is (n, 3) whatever n is.
    let Ok(values) = values else { return Ok(Vec::new()) };
    let found = locator.interpolate(values, directions)?;
    Ok(found.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
}
