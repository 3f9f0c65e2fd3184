//! Computes singular values of 3 x 3 matrices, and the rotation that best fits two sets of vectors.
//!
//! W. Kabsch, "A solution for the best rotation to relate two sets of vectors", Acta Cryst. A32 (1976): for pairs of
//! vectors `f_i` and `g_i`, let `M = sum g_i f_i^T` have the singular value decomposition `M = U S V^T` with singular
//! values s_1 >= s_2 >= s_3, and let d = det(U V^T). Among all rotations Q, `tr Q^T M` is largest for `Q = U diag(1, 1,
//! d) V^T`, with the value `s_1 + s_2 + d s_3`. d is the sign of det M. If reflections are allowed, too, the trace is
//! largest for `Q = U V^T`.
//!
//! The singular value decomposition uses one-sided Jacobi rotations. A dozen of these rotations suffice for machine
//! precision, and small singular values have the same relative accuracy as large ones (J. Demmel and K. Veselic, SIAM
//! J. Matrix Anal. Appl. 13, 1992).

use crate::geometry::{cross, dot};
use crate::matrix3::{IDENTITY, Matrix3, determinant, product, transposed};

/// Singular value decomposition `M = U diag(values) V^T`: U and V orthogonal, the values descending and nonnegative.
#[derive(Debug, Clone, Copy)]
pub struct Svd {
    /// The orthogonal matrix U.
    pub u: Matrix3,
    /// The singular values, descending.
    pub values: [f64; 3],
    /// The orthogonal matrix V.
    pub v: Matrix3,
}

/// Largest number of sweeps of three rotations each. Four sweeps were enough for every matrix that was tried.
const SWEEPS: usize = 12;

/// Returns the singular value decomposition of a matrix, whose entries must be finite.
#[must_use]
pub fn svd(matrix: &Matrix3) -> Svd {
    // The columns of the matrix are stored as rows here. They are divided by a power of two, so that squares don't
    // overflow.
    let largest = matrix.iter().flatten().fold(0.0_f64, |largest, v| largest.max(v.abs()));
    let scale = if largest > 0.0 { largest.log2().floor().exp2() } else { 1.0 };
    let scale = if scale.is_normal() { scale } else { 1.0 };
    let mut columns = transposed(&matrix.map(|row| row.map(|v| v / scale)));
    let mut v = IDENTITY;
    for _ in 0..SWEEPS {
        let mut turned = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b, c) = (dot(columns[p], columns[p]), dot(columns[q], columns[q]), dot(columns[p], columns[q]));
            if c.abs() <= f64::EPSILON * (a * b).sqrt() {
                continue;
            }
            turned = true;
            let zeta = (b - a) / (2.0 * c);
            let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
            let cos = 1.0 / (1.0 + t * t).sqrt();
            for rows in [&mut columns, &mut v] {
                let (x, y) = (rows[p], rows[q]);
                rows[p] = std::array::from_fn(|i| cos * (x[i] - t * y[i]));
                rows[q] = std::array::from_fn(|i| cos * (t * x[i] + y[i]));
            }
        }
        if !turned {
            break;
        }
    }
    let lengths = columns.map(|column| dot(column, column).sqrt());
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| lengths[j].total_cmp(&lengths[i]));
    let values = order.map(|i| lengths[i]);
    let u = complete(order.map(|i| columns[i]), values);
    Svd { u: transposed(&u), values: values.map(|value| value * scale), v: transposed(&order.map(|i| v[i])) }
}

/// Normalises three orthogonal vectors, whose given lengths are in descending order. Vectors of negligible length are
/// replaced such that the result is an orthonormal basis.
fn complete(vectors: Matrix3, lengths: [f64; 3]) -> Matrix3 {
    let unit = |i: usize| vectors[i].map(|v| v / lengths[i]);
    let negligible = |i: usize| lengths[i] <= f64::EPSILON * f64::EPSILON * lengths[0] || lengths[i] == 0.0;
    if negligible(0) {
        return IDENTITY;
    }
    let first = unit(0);
    let second = if negligible(1) {
        // Starts from the coordinate axis along which `first` has its smallest component, and removes the axis's
        // component along `first`.
        let least = (0..3).fold(0, |least, i| if first[i].abs() < first[least].abs() { i } else { least });
        let rest: [f64; 3] = std::array::from_fn(|i| (if i == least { 1.0 } else { 0.0 }) - first[least] * first[i]);
        let length = dot(rest, rest).sqrt();
        rest.map(|v| v / length)
    } else {
        unit(1)
    };
    let third = if negligible(2) { cross(first, second) } else { unit(2) };
    [first, second, third]
}

/// Returns the rotation Q for which tr Q^T M is largest, `U diag(1, 1, d) V^T`. With `mirror`, returns the best of all
/// orthogonal matrices, including reflections.
#[must_use]
pub fn kabsch(matrix: &Matrix3, mirror: bool) -> Matrix3 {
    let Svd { u, values: _, v } = svd(matrix);
    let sign = if mirror { 1.0 } else { determinant(&product(&u, &transposed(&v))).signum() };
    let turned = u.map(|row| [row[0], row[1], sign * row[2]]);
    product(&turned, &transposed(&v))
}

/// Returns the largest tr Q^T M over all rotations Q, which is `s_1 + s_2 + d s_3`. With `mirror`, returns the largest
/// value over all orthogonal Q, which is `s_1 + s_2 + s_3`.
///
/// The trace is computed from the invariants of `M^T M` by Newton's iteration, at a tenth of the cost of the
/// decomposition. The relative error is about 1e-8 if singular values coincide, so the function is meant for searches.
#[must_use]
pub fn best_trace(m: &Matrix3, mirror: bool) -> f64 {
    // The result is the largest root of x^4 - 2 e1 x^2 - 8 d x + e1^2 - 4 e2, with e1 = |M|^2, e2 the sum of squared
    // minors and d = det M (B. Horn, J. Opt. Soc. Am. A 4, 1987, in the form of D. Theobald, Acta Cryst. A61, 2005).
    let e1: f64 = m.iter().flatten().map(|v| v * v).sum();
    if e1 == 0.0 {
        return 0.0;
    }
    let rows = [cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])];
    let e2: f64 = rows.iter().flatten().map(|v| v * v).sum();
    let d = dot(m[0], rows[0]);
    let d = if mirror { d.abs() } else { d };
    let constant = e1 * e1 - 4.0 * e2;
    // Newton's iteration starts at sqrt(3) |M|, which is at least the sum of the singular values, s_1 + s_2 + s_3. From
    // there, x decreases monotonically to the root.
    let mut x = (3.0 * e1).sqrt();
    for _ in 0..60 {
        let square = x * x;
        let value = (square - 2.0 * e1) * square - 8.0 * d * x + constant;
        let slope = 4.0 * (square - e1) * x - 8.0 * d;
        if slope <= 0.0 {
            break;
        }
        let step = value / slope;
        x -= step;
        if step.abs() <= 1e-11 * x {
            break;
        }
    }
    x
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix3::of_quaternion;
    use proptest::prelude::*;

    fn check(m: &Matrix3) {
        let Svd { u, values, v } = svd(m);
        let size = m.iter().flatten().fold(0.0_f64, |size, x| size.max(x.abs()));
        let scaled = u.map(|row| std::array::from_fn(|j| row[j] * values[j]));
        let back = product(&scaled, &transposed(&v));
        for (i, j) in (0..9).map(|n| (n / 3, n % 3)) {
            assert!((back[i][j] - m[i][j]).abs() <= 1e-14 * size, "{m:?}: {back:?}");
            for side in [&u, &v] {
                let gram = product(&transposed(side), side);
                assert!((gram[i][j] - if i == j { 1.0 } else { 0.0 }).abs() < 1e-13, "{m:?}: {side:?}");
            }
        }
        assert!(values[0] >= values[1] && values[1] >= values[2] && values[2] >= 0.0);
    }

    #[test]
    fn matrices_of_low_rank_and_extreme_size_are_decomposed() {
        let zero = [[0.0; 3]; 3];
        let one = [[1.0, 2.0, -1.0], [2.0, 4.0, -2.0], [0.0; 3]];
        let axis = [[0.0; 3], [0.0, 0.0, -7.0], [0.0; 3]];
        for m in [zero, one, axis, IDENTITY, one.map(|row| row.map(|x| x * 1e-200)), [[1e200; 3]; 3]] {
            check(&m);
        }
    }

    proptest! {
        #[test]
        fn decompositions_give_the_matrix_back(m in prop::array::uniform9(-1.0..1.0)) {
            check(&[[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]]);
        }

        /// The two ways of computing the largest trace agree, and no rotation has a larger trace.
        #[test]
        fn no_rotation_beats_kabschs(m in prop::array::uniform9(-1.0..1.0), r in prop::array::uniform4(-1.0..1.0)) {
            let m = [[m[0], m[1], m[2]], [m[3], m[4], m[5]], [m[6], m[7], m[8]]];
            let trace = |q: &Matrix3| -> f64 { (0..3).map(|i| dot(q[i], m[i])).sum() };
            for mirror in [false, true] {
                let q = kabsch(&m, mirror);
                prop_assert!(mirror || determinant(&q) > 0.0);
                prop_assert!((trace(&q) - best_trace(&m, mirror)).abs() < 1e-7);
                let length = r.iter().map(|v: &f64| v * v).sum::<f64>().sqrt();
                let other = of_quaternion([r[0] / length, -r[1] / length, r[2] / length, r[3] / length]);
                prop_assert!(trace(&other) <= trace(&q) + 1e-12);
            }
        }
    }
}
