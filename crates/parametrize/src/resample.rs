//! A surface on another sampling of its sphere.
//!
//! Where every subject of a study has the same vertices over the same sphere, one basis serves them all and vertices
//! correspond. For each direction of the shared sphere: the triangle of the surface's own sphere that the ray meets, and
//! the point of the surface with the same weights there ([`SphereLocator`]). Where the two spheres have a vertex in
//! common it keeps its position to the last bit; between, the new surface lies on the old one in its vertices and cuts
//! its corners in its triangles, by how much the distance tells.

use std::time::Instant;

use ndarray::ArrayView2;
use spharm_harmonics::Directions;
use spharm_surface::Mesh;
use spharm_surface::metrics::{SurfaceDistance, SurfaceDistanceParams, surface_distance};
use spharm_surface::sphere_locator::SphereLocator;

use crate::geometry::Vec3;
use crate::{Parametrization, ParametrizeError, Report};

/// A surface over a sphere that is shared, and how far it is from the surface it was made of.
#[derive(Clone, Debug)]
pub struct Resampled {
    /// The new surface, the shared sphere, and how the one is mapped onto the other.
    pub map: Parametrization,
    /// From the given surface (first) to the new one.
    pub distance: SurfaceDistance,
    /// Pairs of the new surface's triangles that cut through each other, where that was looked for.
    pub self_intersections: Option<usize>,
}

impl Resampled {
    /// Measures a new surface against the given one.
    pub(crate) fn new(
        method: &'static str,
        given: &Mesh,
        surface: Mesh,
        sphere: Mesh,
        started: Instant,
    ) -> Result<Self, ParametrizeError> {
        let mut report = Report::new(method, &surface, &sphere, "give a sphere without folds")?;
        let distance = surface_distance(given, &surface, &SurfaceDistanceParams::default())?;
        report.converged = true;
        report.notes.push(format!(
            "distance from the given surface: mean {:.3e}, Hausdorff {:.3e}, in its unit; {:.3e} and {:.3e} once its \
             bounding box has volume 1",
            distance.mean,
            distance.hausdorff,
            distance.mean / distance.scale,
            distance.hausdorff / distance.scale
        ));
        report.seconds = started.elapsed().as_secs_f64();
        Ok(Self { map: Parametrization { surface, sphere, report }, distance, self_intersections: None })
    }
}

/// Puts a surface on the sampling of another sphere.
///
/// `sphere` has the surface's vertices and triangles, `shared` any; of either only the directions count. The result's
/// sphere is `shared`, bit for bit and of its radius, so that its basis is found under the same key.
///
/// # Errors
///
/// [`NotBijective`](ParametrizeError::NotBijective) where one of the spheres has folds;
/// [`Surface`](ParametrizeError::Surface) where they aren't closed, or the surface isn't the sphere's.
pub fn resample(surface: &Mesh, sphere: &Mesh, shared: &Mesh) -> Result<Resampled, ParametrizeError> {
    let started = Instant::now();
    let locator = locator(sphere)?;
    let vertices = unit_vectors(shared)?;
    let positions = positions(&locator, surface, &vertices)?;
    let mut new = Mesh::new(positions, shared.faces.clone());
    new.meta.clone_from(&surface.meta);
    // What a FreeSurfer or GIfTI file says of its space still holds; of its triangles nothing is said there.
    let unit = Mesh::new(vertices, shared.faces.clone());
    let mut found = Resampled::new("resample", surface, new, unit, started)?;
    // Vectors of length 1 may change in their last bits when they are normalised once more, and with them the key of their
    // basis: what is shared stays as it is.
    found.map.sphere = shared.clone();
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
pub(crate) fn positions(
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
