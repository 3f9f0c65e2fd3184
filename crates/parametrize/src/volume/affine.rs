//! Maps voxel coordinates to positions in space.

use crate::geometry::{cross, dot};

/// If a given voxel size is a power of ten times the file's size, to within this fraction, it is taken to be the same
/// size in another unit. The tolerance allows for sizes that were rounded to a few digits.
const ROUNDING: f64 = 0.01;

/// The rows of a 3 x 4 matrix that maps voxel coordinates (i, j, k) to RAS+ mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Affine(pub [[f64; 4]; 3]);

impl Affine {
    /// The matrix for voxels of 1 mm, with voxel (0, 0, 0) at the origin.
    pub const IDENTITY: Self = Self([[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0]]);

    /// Returns the matrix for voxels of a given size, with voxel (0, 0, 0) at the origin.
    #[must_use]
    pub fn of_voxel_size([x, y, z]: [f64; 3]) -> Self {
        Self([[x, 0.0, 0.0, 0.0], [0.0, y, 0.0, 0.0], [0.0, 0.0, z, 0.0]])
    }

    /// Returns the matrix with the same directions and origin, but voxels of the given size. If the given size differs
    /// from the current size only by a power of ten, it is taken to be the same size in another unit, so the origin is
    /// converted, too.
    pub(super) fn with_voxel_size(&self, size: [f64; 3]) -> Self {
        let lengths = self.voxel_size();
        let factors = [0, 1, 2].map(|axis| size[axis] / lengths[axis]);
        let unit = 10_f64.powi(factors[0].log10().round() as i32);
        let is_unit = factors.iter().all(|factor| (factor / unit - 1.0).abs() < ROUNDING);
        let of_origin = if is_unit { unit } else { 1.0 };
        Self(self.0.map(|[a, b, c, d]| [a * factors[0], b * factors[1], c * factors[2], d * of_origin]))
    }

    /// Returns the matrix with all positions multiplied by a factor.
    pub(super) fn scaled(&self, factor: f64) -> Self {
        Self(self.0.map(|row| row.map(|x| factor * x)))
    }

    /// Returns the lengths of a voxel's edges, in mm.
    #[must_use]
    pub fn voxel_size(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.0.iter().map(|row| row[axis] * row[axis]).sum::<f64>().sqrt())
    }

    /// Returns the position in mm of a point given in voxel coordinates.
    #[must_use]
    pub fn apply(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        self.0.map(|[a, b, c, d]| a * x + b * y + c * z + d)
    }

    /// Returns the volume of a voxel in mm^3; negative if the voxels' axes are left-handed.
    #[must_use]
    pub fn determinant(&self) -> f64 {
        let [a, b, c] = self.0.map(|[x, y, z, _]| [x, y, z]);
        dot(a, cross(b, c))
    }

    /// Returns whether the volume of a voxel is nonzero and all entries are finite.
    pub(super) fn is_valid(&self) -> bool {
        let volume = self.determinant();
        volume.is_finite() && volume != 0.0 && self.0.as_flattened().iter().all(|x| x.is_finite())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_in_another_unit_converts_the_origin() {
        let affine = Affine([[0.0, -0.8, 0.0, 12.0], [1.0, 0.0, 0.0, -30.0], [0.0, 0.0, 2.0, 44.0]]).scaled(1e-3);
        let found = affine.with_voxel_size([1.0, 0.8, 2.0]).apply([0.0; 3]);
        assert!((0..3).all(|k| (found[k] - [12.0, -30.0, 44.0][k]).abs() < 1e-12), "{found:?}");
        // The given size may be rounded.
        let found = affine.with_voxel_size([1.004, 0.8, 2.0]).apply([0.0; 3]);
        assert!((found[0] - 12.0).abs() < 1e-12, "{found:?}");
        // A size that isn't a power of ten times the current size leaves the origin and the directions unchanged.
        let found = affine.with_voxel_size([1.0, 1.0, 2.0]);
        assert_eq!((found.apply([0.0; 3]), found.voxel_size()), (affine.apply([0.0; 3]), [1.0, 1.0, 2.0]));
        assert!(found.0[0][1] < 0.0);
    }
}
