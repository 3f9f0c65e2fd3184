//! Finds meshes with the same triangles whose vertices nevertheless don't correspond.

use std::fmt;

use spharm_monitor::{Silent, number};

use super::pointwise::distances_to_surface;
use super::vertexwise::Distances;
use crate::error::SurfaceError;
use crate::geometry::{Vec3, sub};
use crate::mesh::Mesh;

/// Vertices with the same index are treated as not corresponding if their rms distance exceeds this multiple of the rms
/// distance between the surfaces.
const APART: f64 = 5.0;
/// Maximum number of vertices whose distances are compared, and of triangles whose edges are measured.
const MEASURED: usize = 500;
/// Distances below this fraction of the surface's scale are attributed to rounding.
const ROUNDING: f64 = 1e-6;

/// Warning that the vertices of two meshes with the same triangles don't correspond.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Unpaired {
    /// Root mean square distance between vertices with the same index, in units of the coordinates.
    pub rms: f64,
    /// Root mean square distance of the first mesh's vertices from the other surface, in units of the coordinates.
    pub between: f64,
}

impl Unpaired {
    /// Returns the number of bytes that [`of`](Self::of) needs if the other surface has `faces` triangles.
    #[must_use]
    pub fn bytes(faces: usize) -> u64 {
        super::distances_to_surface_bytes(faces, MEASURED)
    }

    /// Returns a warning if vertices with the same index are much farther apart than the two surfaces are, and also
    /// farther apart than neighbouring vertices of the original. `distances` are the distances at the vertices that the
    /// mask keeps. Up to 500 of these vertices are examined.
    ///
    /// # Errors
    ///
    /// The errors of [`distances_to_surface`].
    pub fn of(
        original: &Mesh,
        other: &Mesh,
        mask: Option<&[bool]>,
        distances: &Distances,
    ) -> Result<Option<Self>, SurfaceError> {
        let is_kept = |v: &usize| mask.is_none_or(|mask| mask[*v]);
        let kept: Vec<usize> = (0..original.vertices.len()).filter(is_kept).collect();
        let taken = kept.len().min(MEASURED);
        let places: Vec<usize> = (0..taken).map(|k| kept[k * kept.len() / taken]).collect();
        let apart = |v: &usize| sub(original.vertices[*v], other.vertices[*v]);
        let paired = root_mean_square(places.iter().map(apart).map(length));
        // Even in a good fit, vertices may slide along the surface, but by less than the length of an edge.
        let step = original.faces.len().div_ceil(MEASURED).max(1);
        let edges = original.faces.iter().step_by(step).flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let edges = edges.map(|edge| edge.map(|v| original.vertices[v as usize])).map(|[a, b]| length(sub(a, b)));
        if !paired.is_finite() || paired <= root_mean_square(edges).max(ROUNDING * distances.scale) {
            return Ok(None);
        }
        let points: Vec<Vec3> = places.iter().map(|v| original.vertices[*v]).collect();
        let between = root_mean_square(distances_to_surface(other, &points, &Silent)?.into_iter());
        Ok((paired > APART * between).then_some(Self { rms: distances.rms_raw, between }))
    }
}

fn length(v: Vec3) -> f64 {
    v.into_iter().fold(0.0, f64::hypot)
}

/// Returns the root mean square of lengths. The lengths are divided by the largest one before they are squared, so that
/// the squares stay within the range of f64.
fn root_mean_square(lengths: impl Iterator<Item = f64>) -> f64 {
    let lengths: Vec<f64> = lengths.collect();
    let largest = lengths.iter().copied().fold(0.0, f64::max);
    if largest == 0.0 {
        return 0.0;
    }
    largest * (lengths.iter().map(|x| (x / largest).powi(2)).sum::<f64>() / lengths.len() as f64).sqrt()
}

impl fmt::Display for Unpaired {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the rms distance between vertices with the same index is {}, but the surfaces are only {} apart: \
             the vertices don't correspond; measure the distance between the surfaces (--surface-distance, in Python \
             surface_distance=True)",
            number(self.rms),
            number(self.between)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;
    use crate::matrix3::{of_quaternion, times};
    use crate::metrics::compare_at;

    #[test]
    fn vertices_that_slide_along_the_surface_are_noticed() {
        let ball = icosphere(4);
        let turn = of_quaternion([0.8, 0.36, 0.48, 0.0]);
        let turned = ball.with_vertices(ball.vertices.iter().map(|v| times(&turn, *v)).collect());
        let larger = ball.with_vertices(ball.vertices.iter().map(|v| v.map(|x| 1.1 * x)).collect());
        let found = |other: &Mesh, mask: Option<&[bool]>| {
            Unpaired::of(&ball, other, mask, &compare_at(&ball, other, mask).unwrap()).unwrap()
        };
        let warning = found(&turned, None).expect("a warning");
        assert!(warning.rms > 0.5 && warning.between < 0.01, "{warning:?}");
        assert!(
            warning.to_string().contains("the vertices don't correspond; measure the distance between the surfaces")
        );
        let half: Vec<bool> = ball.vertices.iter().map(|v| v[2] > 0.0).collect();
        assert!(found(&turned, Some(&half)).is_some());
        assert_eq!([found(&larger, None), found(&ball, None)], [None, None]);
        // If a single vertex is moved, no warning is given, since the other vertices still correspond.
        let mut edited = ball.clone();
        edited.vertices[1] = [0.0, 0.0, 50.0];
        assert_eq!(found(&edited, None), None);
    }
}
