//! Recognises two surfaces that differ only because they are in different coordinate systems.

use spharm_surface::geometry::{add, dot, scale, sub};
use spharm_surface::{Mesh, VolumeGeometry};

/// Largest distance, in mm, between two vectors that are treated as equal. Rounding coordinates to 32 bits causes such
/// differences between a vertex's displacement and the recorded centre of the volume.
const ROUNDING: f64 = 1e-3;

/// Returns whether all vertices of two surfaces differ by the same vector, and this vector is the centre of the volume
/// that the file of one surface records. If so, one surface is in FreeSurfer's surface coordinates (tkRAS), and the
/// other is in scanner coordinates.
pub(super) fn differ_by_centre(original: &Mesh, reconstruction: &Mesh) -> bool {
    let (a, b) = (&original.vertices, &reconstruction.vertices);
    if a.len() != b.len() || a.is_empty() {
        return false;
    }
    let offset = sub(b[0], a[0]);
    let near = |x: [f64; 3], y: [f64; 3]| dot(sub(x, y), sub(x, y)) <= ROUNDING * ROUNDING;
    let is_centre =
        |centre: [f64; 3]| !near(centre, [0.0; 3]) && (near(offset, centre) || near(offset, scale(centre, -1.0)));
    let recorded = [original, reconstruction].into_iter().filter_map(|mesh| VolumeGeometry::of(&mesh.meta));
    recorded.map(|geometry| geometry.axes_and_centre[3]).any(is_centre)
        && a.iter().zip(b).all(|(a, b)| near(add(*a, offset), *b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_surface::generate::icosphere;

    #[test]
    fn surfaces_apart_by_the_centre_of_the_volume_are_recognised() {
        let geometry = VolumeGeometry {
            filename: None,
            size: [256; 3],
            voxel_size: [1.0; 3],
            axes_and_centre: [[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0], [5.0, -17.5, 18.25]],
        };
        let mut own = icosphere(2);
        own.meta.freesurfer_footer = Some(geometry.to_footer());
        let moved = |by: [f64; 3]| Mesh::new(own.vertices.iter().map(|v| add(*v, by)).collect(), own.faces.clone());
        let scanner = moved([5.0, -17.5, 18.25]);
        assert!(differ_by_centre(&own, &scanner) && differ_by_centre(&scanner, &own));
        assert!(!differ_by_centre(&own, &own) && !differ_by_centre(&own, &moved([5.0, -17.5, 18.0])));
        let mut bent = scanner.clone();
        bent.vertices[9][2] += 0.1;
        assert!(!differ_by_centre(&own, &bent) && !differ_by_centre(&icosphere(2), &scanner));
    }
}
