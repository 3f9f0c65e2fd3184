//! Represents the affine maps by which nodes (glTF, VRML) and components (3MF) place the parts of a scene.

/// An affine map. Row k has the three factors and the shift that give coordinate k of a mapped point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Placement(pub(super) [[f64; 4]; 3]);

impl Placement {
    pub(super) const IDENTITY: Self = Self([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);

    /// Returns the map for the 16 numbers of a 4 x 4 matrix, column by column, as in OpenGL. The last row must be (0,
    /// 0, 0, 1) and isn't used.
    pub(super) fn from_columns(m: &[f64; 16]) -> Self {
        let row = |k: usize| [0, 4, 8, 12].map(|column| m.get(column + k).copied().unwrap_or_default());
        Self([row(0), row(1), row(2)])
    }

    pub(super) fn shift([x, y, z]: [f64; 3]) -> Self {
        Self([[1.0, 0.0, 0.0, x], [0.0, 1.0, 0.0, y], [0.0, 0.0, 1.0, z]])
    }

    pub(super) fn scale([x, y, z]: [f64; 3]) -> Self {
        Self([[x, 0.0, 0.0, 0.0], [0.0, y, 0.0, 0.0], [0.0, 0.0, z, 0.0]])
    }

    /// Returns the rotation by a quaternion (x, y, z, w) of any length. Zero gives the identity.
    pub(super) fn rotation([x, y, z, w]: [f64; 4]) -> Self {
        let squares = x * x + y * y + z * z + w * w;
        let s = if squares > 0.0 { 2.0 / squares } else { 0.0 };
        Self([
            [1.0 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w), 0.0],
            [s * (x * y + z * w), 1.0 - s * (x * x + z * z), s * (y * z - x * w), 0.0],
            [s * (x * z - y * w), s * (y * z + x * w), 1.0 - s * (x * x + y * y), 0.0],
        ])
    }

    /// Returns the map that applies `inner` first, then `self`.
    pub(super) fn after(&self, inner: &Self) -> Self {
        let [r0, r1, r2] = inner.0;
        Self(self.0.map(|[a, b, c, shift]| {
            let mut row = [0, 1, 2, 3].map(|k| a * r0[k] + b * r1[k] + c * r2[k]);
            row[3] += shift;
            row
        }))
    }

    pub(super) fn apply(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        self.0.map(|[a, b, c, shift]| a * x + b * y + c * z + shift)
    }

    /// Returns whether the map contains a reflection, which turns surfaces inside out.
    fn mirrors(&self) -> bool {
        let [[a, b, c, _], [d, e, f, _], [g, h, i, _]] = self.0;
        a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g) < 0.0
    }

    /// Moves the vertices. If the map contains a reflection, also reverses the triangles, so that their outer side
    /// stays the same. The identity leaves every bit unchanged.
    pub(super) fn place(&self, vertices: &mut [[f64; 3]], faces: &mut [[u32; 3]]) {
        if *self == Self::IDENTITY {
            return;
        }
        for vertex in vertices {
            *vertex = self.apply(*vertex);
        }
        if self.mirrors() {
            faces.iter_mut().for_each(|face| face.swap(1, 2));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn maps_compose_from_the_inside_out() {
        let turn = Placement::rotation([0.0, 0.0, 2.0, 2.0]);
        let map = Placement::shift([1.0, 2.0, 3.0]).after(&turn).after(&Placement::scale([2.0, 3.0, 4.0]));
        assert_eq!(map.apply([1.0, 1.0, 1.0]), [-2.0, 4.0, 7.0]);
        let columns = [0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 7.0, 8.0, 9.0, 1.0];
        assert_eq!(Placement::from_columns(&columns).apply([1.0, 0.0, 0.0]), [7.0, 9.0, 9.0]);
    }

    #[test]
    fn a_mirror_image_keeps_its_outer_side() {
        let (mut vertices, mut faces) = ([[1.0, 2.0, 3.0]], [[0, 1, 2]]);
        Placement::scale([-1.0, 1.0, 1.0]).place(&mut vertices, &mut faces);
        assert_eq!((vertices, faces), ([[-1.0, 2.0, 3.0]], [[0, 2, 1]]));
        Placement::scale([-1.0, -1.0, 1.0]).place(&mut vertices, &mut faces);
        assert_eq!((vertices, faces), ([[1.0, -2.0, 3.0]], [[0, 2, 1]]));
    }
}
