//! Checks that a sphere belongs to the hemisphere that is fitted over it.

use std::path::Path;

use spharm::io::read_mesh;
use spharm::{Error, Kind, Sphere, Target, read_target};
use spharm_cohort::Row;
use spharm_cohort::run::RunError;
use spharm_surface::SurfaceError;
use spharm_surface::geometry::{cross, dot};

use super::other_hemisphere;

/// Names of surfaces that have the same vertices as a hemisphere's values. FreeSurfer writes all of these surfaces; the
/// first one found is used.
const SURFACES: [&str; 4] = ["white", "pial", "smoothwm", "orig"];

/// Refuses a surface whose orientation its sphere reverses. If a target doesn't match its sphere, the error says
/// whether the sphere matches the other hemisphere.
///
/// A sphere has the same outside as its surface. A mirrored sphere, such as the other hemisphere's, turns the surface
/// inside out: the volumes enclosed by the triangles of the two have different signs. Values have no orientation, so
/// the hemisphere's own surface is compared with the sphere instead.
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
            // Only a mesh tells the other hemisphere's number of vertices; a per-vertex file of values isn't a mesh.
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

/// Returns whether a target was refused because it belongs to another sphere, rather than because its file is
/// malformed.
fn is_of_another(error: &RunError) -> bool {
    use SurfaceError::{OtherTriangles, VertexCount};
    matches!(error, RunError::Fit(Error::Surface(VertexCount { .. } | OtherTriangles { .. })))
}

/// Returns the vertex positions of the surface to which values belong, in the hemisphere given by the file name of the
/// values, if a readable surface exists.
///
/// # Errors
///
/// If the sphere doesn't belong to that surface; then it doesn't belong to the values either.
fn of_values(path: &Path, sphere: &Sphere) -> Result<Option<Vec<f64>>, RunError> {
    let Some((hemi, _)) = other_hemisphere(path) else { return Ok(None) };
    let mut refused = None;
    for name in SURFACES {
        let surface = path.with_file_name(format!("{}.{name}", hemi.name()));
        // A surface that can't be read says nothing about the sphere: try the next one.
        let Ok(mesh) = read_mesh(&surface) else { continue };
        if mesh.vertices.len() == sphere.directions.len() && mesh.faces == sphere.faces {
            return Ok(Some(mesh.vertices.into_flattened()));
        }
        // `read_target` accepts the same triangles in another order; otherwise its error says how they differ.
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

/// Returns six times the volume enclosed by triangles, positive if they are counter-clockwise seen from outside.
fn volume(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> f64 {
    let origin = vertices.first().copied().unwrap_or_default();
    let from_origin = |v: u32| vertices.get(v as usize).map_or([0.0; 3], |p| std::array::from_fn(|k| p[k] - origin[k]));
    faces.iter().map(|face| face.map(from_origin)).map(|[a, b, c]| dot(a, cross(b, c))).sum()
}
