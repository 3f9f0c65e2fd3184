//! Rotations of space and of the sphere of parameters.
//!
//! A rotation R moves the point u to R u. Euler angles are in radians, `R = Rz(al) Ry(be) Rz(ga)`, with `al` and `ga`
//! in (-pi, pi] and `be` in [0, pi]: R rotates first about z by `ga`, then about y by `be`, then about z by `al`. A
//! matrix that includes a reflection is rejected, not corrected, so a [`Rotation`] is never a reflection.

use std::ops::Mul;

use spharm_harmonics::double_double::DoubleDouble;
use spharm_surface::matrix3::of_quaternion;

use crate::error::ShapeError;
pub use crate::matrix3::Matrix3;
use crate::matrix3::{IDENTITY, determinant, product, transposed};
use spharm_surface::kabsch::kabsch;

/// A matrix R is accepted as a rotation if no element of `R^T R` deviates from the identity by more than this value.
pub const ORTHOGONALITY_TOLERANCE: f64 = 1e-6;

/// A rotation of space: an orthogonal matrix of determinant 1.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rotation {
    matrix: Matrix3,
}

impl Default for Rotation {
    fn default() -> Self {
        Self::IDENTITY
    }
}

impl From<&Rotation> for Matrix3 {
    fn from(rotation: &Rotation) -> Self {
        rotation.matrix
    }
}

impl Rotation {
    /// The identity rotation.
    pub const IDENTITY: Self = Self { matrix: IDENTITY };

    /// The rotation by 180 degrees about the first axis.
    pub(crate) const HALF_TURN_X: Self = Self { matrix: [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]] };

    /// Creates a rotation from a matrix, given row by row. The matrix is replaced by the nearest orthogonal matrix,
    /// because a matrix from a file may have few digits.
    ///
    /// # Errors
    ///
    /// [`ShapeError::NotARotation`] if an element isn't finite, `R^T R` deviates from the identity by more than
    /// [`ORTHOGONALITY_TOLERANCE`], or the matrix is a reflection.
    pub fn from_matrix(matrix: Matrix3) -> Result<Self, ShapeError> {
        let refuse = |problem: String| Err(ShapeError::NotARotation { problem });
        if matrix.iter().flatten().any(|v| !v.is_finite()) {
            return refuse("an element isn't finite".to_owned());
        }
        let gram = product(&transposed(&matrix), &matrix);
        let off = |i: usize, j: usize| (gram[i][j] - if i == j { 1.0 } else { 0.0 }).abs();
        let worst = (0..9).map(|n| off(n / 3, n % 3)).fold(0.0, f64::max);
        if worst > ORTHOGONALITY_TOLERANCE {
            return refuse(format!(
                "the columns aren't orthonormal: R^T R differs from the identity by {worst:.2e}, but at most \
                 {ORTHOGONALITY_TOLERANCE:e} is allowed"
            ));
        }
        if determinant(&matrix) < 0.0 {
            return refuse("the determinant is -1, so the matrix is a reflection".to_owned());
        }
        Ok(Self { matrix: kabsch(&matrix, false) })
    }

    /// Wraps a matrix that is orthogonal by construction, up to rounding.
    pub(crate) const fn of_orthogonal(matrix: Matrix3) -> Self {
        Self { matrix }
    }

    /// Returns the rotation `Rz(alpha) Ry(beta) Rz(gamma)`, with angles in radians.
    ///
    /// # Errors
    ///
    /// [`ShapeError::NotARotation`] if an angle isn't finite.
    pub fn from_euler(alpha: f64, beta: f64, gamma: f64) -> Result<Self, ShapeError> {
        if ![alpha, beta, gamma].iter().all(|angle| angle.is_finite()) {
            let problem = format!("the Euler angles {alpha}, {beta}, {gamma} aren't all finite");
            return Err(ShapeError::NotARotation { problem });
        }
        let z = |t: f64| Self { matrix: [[t.cos(), -t.sin(), 0.0], [t.sin(), t.cos(), 0.0], [0.0, 0.0, 1.0]] };
        let (s, c) = beta.sin_cos();
        let y = Self { matrix: [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]] };
        Ok(z(alpha) * y * z(gamma))
    }

    /// Returns the rotation about an axis of nonzero length, by an angle in radians, counter-clockwise seen from the
    /// axis's tip.
    ///
    /// # Errors
    ///
    /// [`ShapeError::NotARotation`] if the axis has length zero, or a value isn't finite.
    pub fn from_axis_angle(axis: [f64; 3], angle: f64) -> Result<Self, ShapeError> {
        // The axis is scaled first, so that no square overflows or underflows.
        let largest = axis.iter().fold(0.0_f64, |largest, v| largest.max(v.abs()));
        if !(axis.iter().all(|v| v.is_finite()) && angle.is_finite() && largest > 0.0) {
            let problem = format!("the axis {axis:?} has length zero, or the axis or the angle {angle} isn't finite");
            return Err(ShapeError::NotARotation { problem });
        }
        let axis = axis.map(|v| v / largest);
        let (s, c) = (angle / 2.0).sin_cos();
        let length = axis.iter().map(|v| v * v).sum::<f64>().sqrt();
        Self::from_quaternion([c, s * axis[0] / length, s * axis[1] / length, s * axis[2] / length])
    }

    /// Creates a rotation from a quaternion (w, x, y, z) of nonzero length.
    ///
    /// # Errors
    ///
    /// [`ShapeError::NotARotation`] if the quaternion has length zero, or a value isn't finite.
    pub fn from_quaternion(quaternion: [f64; 4]) -> Result<Self, ShapeError> {
        let largest = quaternion.iter().fold(0.0_f64, |largest, v| largest.max(v.abs()));
        if !(quaternion.iter().all(|v| v.is_finite()) && largest > 0.0) {
            let problem = format!("the quaternion {quaternion:?} has length zero or isn't finite");
            return Err(ShapeError::NotARotation { problem });
        }
        let q = quaternion.map(|v| v / largest);
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let [w, x, y, z] = q.map(|v| v / length);
        Ok(Self::of_orthogonal(of_quaternion([w, x, y, z])))
    }

    /// Returns a rotation that is uniformly distributed if the three numbers are uniform in [0, 1). The method is from
    /// K. Shoemake, "Uniform random rotations", Graphics Gems III (1992).
    #[must_use]
    pub fn uniform(numbers: [f64; 3]) -> Self {
        let [a, b, c] = numbers.map(|v| if v.is_finite() { v } else { 0.0 });
        let (r, s) = ((1.0 - a).max(0.0).sqrt(), a.max(0.0).sqrt());
        let (b, c) = (std::f64::consts::TAU * b, std::f64::consts::TAU * c);
        Self::from_quaternion([s * c.cos(), r * b.sin(), r * b.cos(), s * c.sin()]).unwrap_or_default()
    }

    /// Returns the rotation about the axis w by an angle equal to the length of w, in radians.
    pub(crate) fn exponential(w: [f64; 3]) -> Self {
        let angle = w.iter().map(|v| v * v).sum::<f64>().sqrt();
        // The quotient sin(t/2) / t, without a division by zero.
        let half = if angle < 1e-8 { 0.5 } else { (angle / 2.0).sin() / angle };
        let quaternion = [(angle / 2.0).cos(), half * w[0], half * w[1], half * w[2]];
        Self::from_quaternion(quaternion).unwrap_or_default()
    }

    /// Returns the matrix as an array of rows.
    #[must_use]
    pub fn matrix(&self) -> Matrix3 {
        self.matrix
    }

    /// Returns the inverse rotation, whose matrix is the transpose.
    #[must_use]
    pub fn inverse(&self) -> Self {
        Self { matrix: transposed(&self.matrix) }
    }

    /// Returns R u, the rotated vector.
    #[must_use]
    pub fn apply(&self, u: [f64; 3]) -> [f64; 3] {
        self.matrix.map(|row| row[0] * u[0] + row[1] * u[1] + row[2] * u[2])
    }

    /// Returns the angle of the rotation, in [0, pi].
    #[must_use]
    pub fn angle(&self) -> f64 {
        let r = &self.matrix;
        let sine = [r[2][1] - r[1][2], r[0][2] - r[2][0], r[1][0] - r[0][1]];
        sine.iter().map(|v| v * v).sum::<f64>().sqrt().atan2(r[0][0] + r[1][1] + r[2][2] - 1.0)
    }

    /// Returns the Euler angles `al`, `be` and `ga`, in radians. The matrix determines only `al + ga` at `be = 0`, and
    /// only `al - ga` at `be = pi`. If it doesn't determine `al`, `al` is 0.
    #[must_use]
    pub fn euler(&self) -> [f64; 3] {
        self.turns().map(|turn| turn.sin.value().atan2(turn.cos.value()))
    }

    /// Returns the rotations by the Euler angles `al`, `be` and `ga`. The angle `ga` is computed from R after removing
    /// `Rz(al)`, so the product of the three rotations equals R to rounding error, even if `be` is tiny.
    pub(crate) fn turns(&self) -> [Turn; 3] {
        let exact = self.matrix.map(|row| row.map(Number::new));
        let alpha = Turn::of(exact[0][2], exact[1][2]);
        let along = |column: usize| alpha.cos * exact[0][column] + alpha.sin * exact[1][column];
        let across = |column: usize| alpha.cos * exact[1][column] - alpha.sin * exact[0][column];
        [alpha, Turn::of(exact[2][2], along(2)), Turn::of(across(1), across(0))]
    }
}

/// The product of two rotations applies the right operand first.
impl Mul for Rotation {
    type Output = Self;

    fn mul(self, right: Self) -> Self {
        Self { matrix: product(&self.matrix, &right.matrix) }
    }
}

type Number = DoubleDouble<false>;

/// Cosine and sine of an angle in double-double precision. Cosines and sines of m times the angle are computed as
/// powers, and are accurate to one rounding error. For comparison, the error of `cos(m t)` for a rounded angle t is m
/// rounding errors.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Turn {
    cos: Number,
    sin: Number,
}

impl Turn {
    /// Returns the rotation by the polar angle of the direction (x, y); the identity for the zero vector.
    fn of(x: Number, y: Number) -> Self {
        let length = (x * x + y * y).sqrt();
        if length.hi < 1e-150 {
            return Self { cos: Number::new(1.0), sin: Number::ZERO };
        }
        Self { cos: x / length, sin: y / length }
    }

    /// Returns the pairs (cos(m t), sin(m t)) of the angle t, for m from 0 to `max_degree`.
    pub(crate) fn multiples(self, max_degree: usize) -> Vec<[f64; 2]> {
        let (mut cos, mut sin) = (Number::new(1.0), Number::ZERO);
        let multiples = (0..=max_degree).map(|_| {
            let now = [cos.value(), sin.value()];
            (cos, sin) = (cos * self.cos - sin * self.sin, cos * self.sin + sin * self.cos);
            now
        });
        multiples.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn apart(a: &Rotation, b: &Rotation) -> f64 {
        (*a * b.inverse()).angle()
    }

    #[test]
    fn all_ways_to_say_a_rotation_agree() {
        let turn = Rotation::from_axis_angle([0.0, 0.0, 3.0], 0.7).unwrap();
        let half = 0.35_f64;
        for other in [
            Rotation::from_euler(0.7, 0.0, 0.0),
            Rotation::from_quaternion([2.0 * half.cos(), 0.0, 0.0, 2.0 * half.sin()]),
            Rotation::from_matrix([
                [0.7_f64.cos(), -0.7_f64.sin(), 0.0],
                [0.7_f64.sin(), 0.7_f64.cos(), 0.0],
                [0.0, 0.0, 1.0],
            ]),
        ] {
            assert!(apart(&turn, &other.unwrap()) < 1e-15);
        }
        let [x, y, _] = turn.apply([1.0, 0.0, 0.0]);
        assert!((x - 0.7_f64.cos()).abs() < 1e-15 && (y - 0.7_f64.sin()).abs() < 1e-15);
        assert!((turn.angle() - 0.7).abs() < 1e-15);
    }

    #[test]
    fn what_is_no_rotation_is_refused() {
        let mirror = [[-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let sheared = [[1.0, 0.1, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        for (matrix, said) in [(mirror, "reflection"), (sheared, "orthonormal"), ([[f64::NAN; 3]; 3], "finite")] {
            let error = Rotation::from_matrix(matrix).unwrap_err().to_string();
            assert!(error.contains(said), "{error}");
        }
        assert!(Rotation::from_axis_angle([0.0; 3], 1.0).is_err());
        assert!(Rotation::from_quaternion([0.0; 4]).is_err() && Rotation::from_euler(0.0, f64::INFINITY, 0.0).is_err());
    }

    #[test]
    fn a_matrix_of_few_digits_becomes_orthogonal() {
        let rounded =
            Rotation::from_euler(0.3, 1.2, -2.0).unwrap().matrix().map(|row| row.map(|v| (v * 1e7).round() / 1e7));
        let gram = Rotation::from_matrix(rounded).unwrap();
        let off = product(&gram.inverse().matrix(), &gram.matrix());
        assert!((0..9).all(|n| (off[n / 3][n % 3] - if n % 4 == 0 { 1.0 } else { 0.0 }).abs() < 1e-15));
    }

    proptest! {
        /// The Euler angles reproduce the rotation, even near beta = 0 and pi. At beta = 0 and pi, only the sum or the
        /// difference of alpha and gamma is determined.
        #[test]
        fn euler_angles_give_the_rotation_back(a in -3.1..3.1, b in 0.0..3.1, c in -3.1..3.1, small in 0i32..18) {
            let near = 10.0_f64.powi(-small);
            for beta in [b, near, std::f64::consts::PI - near] {
                let rotation = Rotation::from_euler(a, beta, c).unwrap();
                let [x, y, z] = rotation.euler();
                prop_assert!((0.0..=std::f64::consts::PI).contains(&y));
                prop_assert!(apart(&Rotation::from_euler(x, y, z).unwrap(), &rotation) < 1e-14);
            }
        }
    }
}
