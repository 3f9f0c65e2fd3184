//! Checks whether the models of a group are in the same pose. A mean, modes and tests require a common pose.
//!
//! The degree 1 rows of a surface, B (3 x 3), map a direction to its point on the first-order ellipsoid. If surfaces
//! correspond, their matrices B resemble each other. If a surface is rotated in space or in its parameters, B becomes Q
//! B R, where Q and R are rotations. Matrices of surfaces in different poses partly cancel each other in the sum. The
//! sum is largest if all matrices have the same singular vectors: `|sum Q_i B_i R_i| <= |sum s_i|`, where s_i is the
//! vector of the singular values of B_i in descending order (von Neumann's trace inequality). The ratio
//!
//! ```text
//! |sum B_i| / |sum s_i|
//! ```
//!
//! is 1 for surfaces in one pose, regardless of their sizes and shapes. For n surfaces in random poses, the ratio is
//! about 1 / sqrt(n). For ellipsoids with axes 9, 5 and 3 in random poses, it is 0.27 for 12 surfaces, 0.42 for 5
//! surfaces and 0.55 for 3 surfaces. Computing the ratio requires no search. The ratio can't detect a half turn about
//! an axis of the ellipsoid that is applied both to the parameters and to space, because it leaves B unchanged.

use std::fmt;

use spharm_harmonics::Coefficients;

use crate::matrix3::Matrix3;
use spharm_surface::kabsch::svd;

/// Surfaces are treated as being in one pose if the ratio `|sum B_i| / |sum s_i|` (see the module's documentation) is
/// at least this value. In random poses, 1 in 200 groups of 5 surfaces and 1 in 12 groups of 3 surfaces exceed this
/// value.
const LEAST: f64 = 0.75;

/// Warning that surfaces aren't in the same pose.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PosesDiffer {
    /// Fraction of the first-order ellipsoids' size that remains after averaging them; 1 if all surfaces are in one
    /// pose.
    pub left: f64,
}

impl PosesDiffer {
    /// Checks a group of surfaces (K, 3). Returns `None` if the surfaces are in one pose, or if this can't be
    /// determined from the coefficients of degree 1.
    #[must_use]
    pub fn of(group: &[Coefficients]) -> Option<Self> {
        let first_order = |surface: &Coefficients| -> Option<Matrix3> {
            let values = surface.values();
            let known = values.nrows() >= 4 && values.ncols() == 3;
            known.then(|| std::array::from_fn(|row| std::array::from_fn(|c| values[[1 + row, c]])))
        };
        let group: Vec<Matrix3> = group.iter().map(first_order).collect::<Option<_>>()?;
        let largest = group.iter().flatten().flatten().fold(0.0_f64, |largest, v| largest.max(v.abs()));
        if largest == 0.0 || !largest.is_finite() {
            return None;
        }
        // The matrices are scaled, so that squares neither overflow nor underflow.
        let (mut sum, mut values) = (Matrix3::default(), [0.0; 3]);
        for matrix in group.iter().map(|matrix| matrix.map(|row| row.map(|v| v / largest))) {
            sum.as_flattened_mut().iter_mut().zip(matrix.as_flattened()).for_each(|(sum, v)| *sum += v);
            values.iter_mut().zip(svd(&matrix).values).for_each(|(sum, value)| *sum += value);
        }
        let norm = |numbers: &[f64]| numbers.iter().map(|v| v * v).sum::<f64>().sqrt();
        let left = norm(sum.as_flattened()) / norm(&values);
        (left < LEAST).then_some(Self { left })
    }
}

impl fmt::Display for PosesDiffer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the surfaces are not aligned: averaging the first-order ellipsoids keeps only a fraction of {:.2} of \
             their size (1 if perfectly aligned); align the surfaces first, or fit them over one common sphere if \
             their vertices correspond",
            self.left
        )
    }
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;

    use super::*;
    use crate::samples::{blob, ellipsoid, posed, reflected, some_pose};

    #[test]
    fn poses_that_differ_are_told_from_shapes_that_do() {
        let shapes = [ellipsoid([9.0, 5.0, 3.0]), ellipsoid([3.0, 2.9, 1.0]), ellipsoid([20.0, 6.0, 6.0])];
        assert_eq!(PosesDiffer::of(&shapes), None);
        let together: Vec<_> = (0..8).map(|n| posed(&blob(4, n), &some_pose(1))).collect();
        assert_eq!(PosesDiffer::of(&together), None);
        let apart: Vec<_> = (0..8).map(|n| posed(&blob(4, 1), &some_pose(n))).collect();
        let found = PosesDiffer::of(&apart).unwrap();
        assert!(found.left < 0.6 && found.to_string().contains("align"), "{found}");
        // Surfaces are rotated in their parameters alone, as if they had been mapped to the sphere independently.
        let still = |n: usize| crate::Transform { rotation: some_pose(n).rotation, ..crate::Transform::default() };
        let turned: Vec<_> = (0..8).map(|n| posed(&blob(4, 1), &still(n))).collect();
        assert!(PosesDiffer::of(&turned).is_some());
    }

    #[test]
    fn what_has_no_ellipsoid_tells_nothing() {
        let points = [(); 3].map(|()| Coefficients::new(Array2::zeros((4, 3))).unwrap());
        assert_eq!(PosesDiffer::of(&points), None);
        assert_eq!(PosesDiffer::of(&[]), None);
        let constants = [Coefficients::new(Array2::ones((1, 3))).unwrap()];
        assert_eq!(PosesDiffer::of(&constants), None);
        let large = [blob(3, 1), reflected(&blob(3, 1))].map(|s| Coefficients::new(s.values() * 1e300).unwrap());
        assert!(PosesDiffer::of(&large).is_some_and(|found| found.left.is_finite()));
    }
}
