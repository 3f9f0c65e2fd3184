//! Whether a sphere is that of the hemisphere that is fitted over it.

use std::path::Path;

use anyhow::{Result, anyhow, bail};
use spharm::cohort::Row;
use spharm::io::read_mesh;
use spharm::{Kind, Mesh, Sphere, Target};
use spharm_surface::geometry::{cross, dot};

use super::other_hemisphere;

/// Refuses a surface whose orientation its sphere turns round, and says of one that doesn't fit its sphere whether that is the
/// other hemisphere's.
///
/// A sphere keeps the side of its surface that is outside. A mirrored one, as another hemisphere's is, turns it inside out: the
/// volumes that the triangles enclose on the two have different signs.
pub(super) fn hemisphere(row: &Row, sphere: &Sphere, target: Result<Target>) -> Result<Target> {
    match target {
        Ok(target) if !sphere.faces.is_empty() => {
            let positions = match target.kind {
                Kind::Surface => Some(target.values.as_chunks::<3>().0.to_vec()),
                // Values don't tell; the white surface that they are on does.
                _ => white(&row.surface).map(|mesh| mesh.vertices).filter(|v| v.len() == sphere.directions.len()),
            };
            let of_surface = positions.map_or(0.0, |positions| volume(&positions, &sphere.faces));
            if of_surface * volume(sphere.directions.as_slice(), &sphere.faces) < 0.0 {
                bail!(
                    "{}: {} turns it inside out, as the sphere of the other hemisphere does; expected that of this one",
                    row.surface.display(),
                    sphere.name().display()
                );
            }
            Ok(target)
        }
        Ok(target) => Ok(target),
        Err(error) => {
            let vertices = sphere.directions.len();
            let other = other_hemisphere(&row.surface).map(|(_, path)| path);
            // A signal has no vertices of its own to count.
            match other.filter(|path| read_mesh(path).is_ok_and(|mesh| mesh.vertices.len() == vertices)) {
                Some(path) => {
                    let (sphere, path) = (sphere.name().display(), path.display());
                    Err(anyhow!("{error}; {sphere} has the {vertices} vertices of {path}: is it of that hemisphere?"))
                }
                None => Err(error),
            }
        }
    }
}

/// The white surface of the hemisphere that a file is of, where it is there.
fn white(path: &Path) -> Option<Mesh> {
    let (hemi, _) = other_hemisphere(path)?;
    read_mesh(path.with_file_name(format!("{}.white", hemi.name()))).ok()
}

/// Six times the volume that triangles enclose, positive where they are counter-clockwise seen from outside.
fn volume(vertices: &[[f64; 3]], faces: &[[u32; 3]]) -> f64 {
    let origin = vertices.first().copied().unwrap_or_default();
    let from_origin = |v: u32| vertices.get(v as usize).map_or([0.0; 3], |p| std::array::from_fn(|k| p[k] - origin[k]));
    faces.iter().map(|face| face.map(from_origin)).map(|[a, b, c]| dot(a, cross(b, c))).sum()
}
