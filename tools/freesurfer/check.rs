//! Whether a sphere is that of the hemisphere that is fitted over it.

use std::path::Path;

use spharm::io::read_mesh;
use spharm::{Error, Kind, Sphere, Target, read_target};
use spharm_cohort::Row;
use spharm_cohort::run::RunError;
use spharm_surface::SurfaceError;
use spharm_surface::geometry::{cross, dot};

use super::other_hemisphere;

/// Surfaces that a hemisphere's values are on, of which FreeSurfer writes all; the first that is there is taken.
const SURFACES: [&str; 4] = ["white", "pial", "smoothwm", "orig"];

/// Refuses a surface whose orientation its sphere turns round, and says of one that doesn't fit its sphere whether that
/// is the other hemisphere's.
///
/// A sphere keeps the side of its surface that is outside. A mirrored one, as another hemisphere's is, turns it inside
/// out: the volumes that the triangles enclose on the two have different signs. Values say nothing of that: the
/// hemisphere's own surface does, and is held against the sphere in their place.
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
                    "{}: {} turns it inside out, as the sphere of the other hemisphere does; expected that of this one",
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
            // A signal has no vertices of its own to count.
            match other.filter(|path| read_mesh(path).is_ok_and(|mesh| mesh.vertices.len() == vertices)) {
                Some(path) => {
                    let (sphere, path) = (sphere.name().display(), path.display());
                    Err(RunError::Check(format!(
                        "{error}; {sphere} has the {vertices} vertices of {path}: is it of that hemisphere?"
                    )))
                }
                None => Err(error),
            }
        }
    }
}

/// Whether a target was refused because it is of another sphere, in place of being broken.
fn is_of_another(error: &RunError) -> bool {
    use SurfaceError::{OtherTriangles, VertexCount};
    matches!(error, RunError::Fit(Error::Surface(VertexCount { .. } | OtherTriangles { .. })))
}

/// The surface that values are on, of their hemisphere, where there is one that can be read.
///
/// # Errors
///
/// When the sphere isn't that of the surface, so that it isn't that of the values either.
fn of_values(path: &Path, sphere: &Sphere) -> Result<Option<Vec<f64>>, RunError> {
    let Some((hemi, _)) = other_hemisphere(path) else { return Ok(None) };
    let mut refused = None;
    for name in SURFACES {
        let surface = path.with_file_name(format!("{}.{name}", hemi.name()));
        // One that is damaged says nothing.
        let Ok(mesh) = read_mesh(&surface) else { continue };
        if mesh.vertices.len() == sphere.directions.len() && mesh.faces == sphere.faces {
            return Ok(Some(mesh.vertices.into_flattened()));
        }
        // Its triangles may be the same in another order; else this says how they differ.
        match read_target(&surface, sphere) {
            Ok(target) => return Ok(Some(target.values)),
            Err(error) => refused = refused.or(Some(RunError::from(error))),
        }
    }
    match refused {
        Some(error) => Err(error.of(format_args!("{}: the sphere is not of its surface", path.display()))),
        None => Ok(None),
    }
}

/// Six times the volume that triangles enclose, positive where they are counter-clockwise seen from outside.
fn volume(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> f64 {
    let origin = vertices.first().copied().unwrap_or_default();
    let from_origin = |v: u32| vertices.get(v as usize).map_or([0.0; 3], |p| std::array::from_fn(|k| p[k] - origin[k]));
    faces.iter().map(|face| face.map(from_origin)).map(|[a, b, c]| dot(a, cross(b, c))).sum()
}
