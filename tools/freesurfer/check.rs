//! Checks that a sphere belongs to the hemisphere that is fitted over it.

use std::path::Path;

use spharm::io::read_mesh;
use spharm::{Error, Kind, Sphere, Target, read_target};
use spharm_cli::freesurfer::other_hemisphere;
use spharm_cohort::Row;
use spharm_cohort::run::RunError;
use spharm_surface::SurfaceError;
use spharm_surface::geometry::{cross, dot};

/// Names of FreeSurfer surfaces whose vertices are those of a hemisphere's per-vertex values. FreeSurfer writes all of
/// these surfaces; the first one found is used.
const SURFACES: [&str; 4] = ["white", "pial", "smoothwm", "orig"];

/// Checks the orientation of a row's sphere, and refuses a surface whose sphere has the opposite orientation. If a
/// target doesn't match its sphere, the error states whether the sphere matches the other hemisphere.
///
/// A surface and its sphere have the same orientation. A mirrored sphere, such as the sphere of the other hemisphere,
/// has the opposite orientation: the volume enclosed by its triangles and the volume enclosed by the surface's
/// triangles have different signs. Per-vertex values have no orientation, so the hemisphere's own surface is compared
/// with the sphere instead.
pub(super) fn hemisphere(row: &Row, sphere: &Sphere, target: Result<Target, RunError>) -> Result<Target, RunError> {
    match target {
        Ok(target) if !sphere.faces.is_empty() => {
            let own = if target.kind == Kind::Surface { None } else { of_values(&row.surface, sphere)? };
            let positions = match target.kind {
                Kind::Surface => target.values.as_slice(),
                _ => own.as_deref().unwrap_or_default(),
            };
            let of_surface = volume(positions.as_chunks::<3>().0, &sphere.faces);
            if of_surface * volume(sphere.directions.as_slice(), &sphere.faces) < 0.0 {
                return Err(RunError::Check(format!(
                    "{}: the sphere {} reverses the orientation of the surface; is this the sphere of the other \
                     hemisphere?",
                    row.surface.display(),
                    sphere.name().display()
                )));
            }
            Ok(target)
        }
        Ok(target) => Ok(target),
        Err(error) if !is_of_another(&error) => Err(error),
        Err(error) => {
            let vertices = sphere.directions.len();
            let other = other_hemisphere(&row.surface).map(|(_, path)| path);
            // The other hemisphere's number of vertices is known only if that hemisphere's file is a mesh. A per-vertex
            // file of values isn't a mesh.
            match other.filter(|path| read_mesh(path).is_ok_and(|mesh| mesh.vertices.len() == vertices)) {
                Some(path) => {
                    let (sphere, path) = (sphere.name().display(), path.display());
                    Err(RunError::Check(format!(
                        "{error}; {sphere} has {vertices} vertices, as many as {path}; is this the sphere of the other \
                         hemisphere?"
                    )))
                }
                None => Err(error),
            }
        }
    }
}

/// Returns whether a target was refused because it doesn't match the sphere, rather than because its file is malformed.
fn is_of_another(error: &RunError) -> bool {
    use SurfaceError::{OtherTriangles, VertexCount};
    matches!(error, RunError::Fit(Error::Surface(VertexCount { .. } | OtherTriangles { .. })))
}

/// Returns the vertex positions of the surface to which a file of values belongs. The name of this file determines the
/// hemisphere. Returns `None` if no surface of the hemisphere can be read.
///
/// # Errors
///
/// If the sphere doesn't match the surface, and therefore doesn't match the values.
fn of_values(path: &Path, sphere: &Sphere) -> Result<Option<Vec<f64>>, RunError> {
    let Some((hemi, _)) = other_hemisphere(path) else { return Ok(None) };
    let mut refused = None;
    for name in SURFACES {
        let surface = path.with_file_name(format!("{}.{name}", hemi.name()));
        // If this surface can't be read, try the next surface.
        let Ok(mesh) = read_mesh(&surface) else { continue };
        if mesh.vertices.len() == sphere.directions.len() && mesh.faces == sphere.faces {
            return Ok(Some(mesh.vertices.into_flattened()));
        }
        // `read_target` accepts the same triangles in another order; otherwise its error states the difference.
        match read_target(&surface, sphere) {
            Ok(target) => return Ok(Some(target.values)),
            Err(error) => refused = refused.or(Some(RunError::from(error))),
        }
    }
    match refused {
        Some(error) => {
            Err(error.of(format_args!("{}: the sphere doesn't match the surface of these values", path.display())))
        }
        None => Ok(None),
    }
}

/// Returns six times the volume enclosed by triangles; positive if the corners of each triangle are in
/// counter-clockwise order seen from outside.
fn volume(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> f64 {
    let origin = vertices.first().copied().unwrap_or_default();
    let from_origin = |v: u32| vertices.get(v as usize).map_or([0.0; 3], |p| std::array::from_fn(|k| p[k] - origin[k]));
    faces.iter().map(|face| face.map(from_origin)).map(|[a, b, c]| dot(a, cross(b, c))).sum()
}
