//! Represents similarity transforms of space: a rotation or reflection, a scaling and a translation.

use serde::{Deserialize, Serialize};

use crate::geometry::{Vec3, add, scale, sub};
use crate::hemisphere::Hemisphere;
use crate::matrix3::{IDENTITY, Matrix3, determinant, product, times, transposed};
use crate::mesh::Mesh;

/// A similarity transform of space: `x -> scale Q x + translation`.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Similarity {
    /// The matrix Q, stored by rows: a rotation, or a reflection if one was requested.
    pub orthogonal: Matrix3,
    /// Scale factor, above zero.
    pub scale: f64,
    /// Translation, in the surface's unit.
    pub translation: Vec3,
}

impl Default for Similarity {
    fn default() -> Self {
        Self { orthogonal: IDENTITY, scale: 1.0, translation: [0.0; 3] }
    }
}

impl Similarity {
    /// Returns a similarity that consists of a rotation only.
    #[must_use]
    pub fn rotation(rotation: impl Into<Matrix3>) -> Self {
        Self { orthogonal: rotation.into(), ..Self::default() }
    }

    /// Returns the reflection (x, y, z) -> (-x, y, z), which exchanges left and right in frames whose first axis runs
    /// between left and right, such as RAS and LPS.
    #[must_use]
    pub const fn reflection() -> Self {
        let orthogonal = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        Self { orthogonal, scale: 1.0, translation: [0.0; 3] }
    }

    /// Returns whether the similarity contains a reflection.
    #[must_use]
    pub fn mirrors(&self) -> bool {
        determinant(&self.orthogonal) < 0.0
    }

    /// Returns scale Q x + translation.
    #[must_use]
    pub fn apply(&self, x: Vec3) -> Vec3 {
        let Self { orthogonal: q, scale, translation } = self;
        std::array::from_fn(|i| scale * (q[i][0] * x[0] + q[i][1] * x[1] + q[i][2] * x[2]) + translation[i])
    }

    /// Returns the inverse similarity: `x -> Q^T (x - translation) / scale`.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (orthogonal, factor) = (transposed(&self.orthogonal), 1.0 / self.scale);
        let translation = scale(times(&orthogonal, self.translation), -factor);
        Self { orthogonal, scale: factor, translation }
    }

    /// Returns the similarity that applies this one first, then `next`.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            orthogonal: product(&next.orthogonal, &self.orthogonal),
            scale: next.scale * self.scale,
            translation: add(scale(times(&next.orthogonal, self.translation), next.scale), next.translation),
        }
    }

    /// Returns this similarity with a different scale factor. The translation is adjusted such that `centre` is still
    /// mapped to the same point.
    #[must_use]
    pub fn with_scale(&self, factor: f64, centre: Vec3) -> Self {
        let translation = sub(self.apply(centre), scale(times(&self.orthogonal, centre), factor));
        Self { scale: factor, translation, ..*self }
    }

    /// Returns a mesh to which the similarity has been applied. A reflection also reverses the triangles' winding, so
    /// that they still face outwards, and exchanges left and right in the anatomical structure. Unless the similarity
    /// is the identity, metadata about the mesh's position in a volume are dropped, since they are no longer valid. A
    /// rotation or reflection also drops the axes that the file states.
    #[must_use]
    pub fn apply_mesh(&self, mesh: &Mesh) -> Mesh {
        let mut moved = mesh.with_vertices(mesh.vertices.iter().map(|v| self.apply(*v)).collect());
        if *self != Self::default() {
            let meta = &mut moved.meta;
            (meta.coordinate_system, meta.freesurfer_footer) = (None, None);
            meta.surface_metadata.retain(|(name, _)| !name.starts_with("VolGeom"));
            if self.orthogonal != Self::default().orthogonal {
                meta.forget_axes();
            }
        }
        if self.mirrors() {
            moved.faces.iter_mut().for_each(|face| face.swap(1, 2));
            let structure = &mut moved.meta.anatomical_structure_primary;
            *structure = structure.take().map(|structure| Hemisphere::mirrored_structure(&structure));
        }
        moved
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;
    use crate::geometry::{dot, face_normal, sub};

    fn some(mirror: bool) -> Similarity {
        let (sin, cos) = 0.7_f64.sin_cos();
        let sign = if mirror { -1.0 } else { 1.0 };
        Similarity {
            orthogonal: [[cos, -sin, 0.0], [0.0, 0.0, sign], [-sin, -cos, 0.0]],
            scale: 2.5,
            translation: [3.0, -20.0, 0.5],
        }
    }

    #[test]
    fn another_scale_keeps_the_centre_and_the_rotation() {
        let (own, centre) = (some(true), [1.0, 2.0, -3.0]);
        let other = own.with_scale(0.5, centre);
        let off = sub(other.apply(centre), own.apply(centre));
        assert!(dot(off, off).sqrt() < 1e-12 && other.orthogonal == own.orthogonal && other.scale == 0.5);
    }

    #[test]
    fn the_inverse_brings_back_and_motions_are_done_in_turn() {
        let p = [0.3, -7.0, 11.0];
        for (mirror, other) in [(false, true), (true, true), (true, false)] {
            let (first, second) = (some(mirror), some(other));
            let close = |a: Vec3, b: Vec3| dot(sub(a, b), sub(a, b)).sqrt() < 1e-12;
            assert!(close(first.inverse().apply(first.apply(p)), p));
            assert!(close(first.then(&second).apply(p), second.apply(first.apply(p))));
            assert_ne!(first.mirrors(), first.then(&first).mirrors() || !first.mirrors());
        }
    }

    #[test]
    fn the_outside_of_a_mirrored_mesh_stays_outside() {
        let mut ball = icosphere(1);
        ball.meta.anatomical_structure_primary = Some("CortexRight".to_owned());
        for (mirror, structure) in [(false, "CortexRight"), (true, "CortexLeft")] {
            let moved = some(mirror).apply_mesh(&ball);
            assert_eq!(moved.meta.anatomical_structure_primary.as_deref(), Some(structure));
            for face in &moved.faces {
                let corners = face.map(|v| moved.vertices[v as usize]);
                let out = sub(corners[0], some(mirror).translation);
                assert!(dot(face_normal(corners), out) > 0.0, "{mirror}");
            }
        }
    }
}
