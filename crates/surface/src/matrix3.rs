//! Operations on 3 x 3 matrices, including rotations.

use crate::geometry::{Vec3, dot};

/// A 3 x 3 matrix, stored by rows.
pub type Matrix3 = [[f64; 3]; 3];

/// The identity matrix.
pub const IDENTITY: Matrix3 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

/// Returns the matrix product a b.
#[must_use]
pub fn product(a: &Matrix3, b: &Matrix3) -> Matrix3 {
    a.map(|row| std::array::from_fn(|j| row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]))
}

/// Returns the transpose of a.
#[must_use]
pub fn transposed(a: &Matrix3) -> Matrix3 {
    std::array::from_fn(|i| std::array::from_fn(|j| a[j][i]))
}

/// Returns the determinant of a.
#[must_use]
pub fn determinant(a: &Matrix3) -> f64 {
    let minor = |i: usize, j: usize| a[1][i] * a[2][j] - a[1][j] * a[2][i];
    a[0][0] * minor(1, 2) - a[0][1] * minor(0, 2) + a[0][2] * minor(0, 1)
}

/// Returns the product of a matrix and a vector.
#[must_use]
pub fn times(a: &Matrix3, x: Vec3) -> Vec3 {
    a.map(|row| row[0] * x[0] + row[1] * x[1] + row[2] * x[2])
}

/// Returns the rotation that a unit quaternion (w, x, y, z) represents.
#[must_use]
pub fn of_quaternion([w, x, y, z]: [f64; 4]) -> Matrix3 {
    [
        [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
    ]
}

/// Returns the rotation about the direction of `turn` by an angle equal to its length, in radians.
#[must_use]
pub fn exponential(turn: Vec3) -> Matrix3 {
    let angle = dot(turn, turn).sqrt();
    // sin(angle / 2) / angle; its limit for small angles is 0.5.
    let half = if angle < 1e-8 { 0.5 } else { (0.5 * angle).sin() / angle };
    let q = [(0.5 * angle).cos(), half * turn[0], half * turn[1], half * turn[2]];
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    of_quaternion(q.map(|v| v / length))
}

/// Returns the angle, in radians, of the rotation that relates two orthogonal matrices of the same determinant.
///
/// It is computed from the Frobenius norm `|a - b| = 2 sqrt(2) sin(angle / 2)`, which is accurate for small angles.
#[must_use]
pub fn angle_between(a: &Matrix3, b: &Matrix3) -> f64 {
    let square: f64 = a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b) * (a - b)).sum();
    2.0 * (square / 8.0).sqrt().min(1.0).asin()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_quaternion_turns_by_its_angle() {
        for angle in [1e-9, 0.3, 2.0, 3.1] {
            let (sin, cos) = (0.5_f64 * angle).sin_cos();
            let turn = of_quaternion([cos, 0.36 * sin, 0.48 * sin, 0.8 * sin]);
            assert!((angle_between(&turn, &IDENTITY) - angle).abs() < 1e-14 + 1e-7 * angle, "{angle}");
            assert!((determinant(&turn) - 1.0).abs() < 1e-14);
            let axis = times(&turn, [0.36, 0.48, 0.8]);
            assert!((axis[0] - 0.36).abs() + (axis[1] - 0.48).abs() + (axis[2] - 0.8).abs() < 1e-14);
        }
    }
}
