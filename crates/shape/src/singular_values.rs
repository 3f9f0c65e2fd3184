//! Computes singular values of matrices with few columns, to full relative accuracy.
//!
//! One-sided Jacobi rotations (M. R. Hestenes, J. SIAM 6 (1958)) make the columns orthogonal. The lengths of the
//! resulting columns are the singular values. Small singular values keep full accuracy, unlike the square roots of the
//! eigenvalues of `A^T A`, which lose half of the digits (J. Demmel and K. Veselic, SIAM J. Matrix Anal. Appl. 13
//! (1992)). Cost for a matrix (n, c): about 6 n c^2 flops per sweep; three columns take 4 to 6 sweeps.

use ndarray::ArrayView2;

/// Maximum number of sweeps. It is never reached: a matrix of three columns takes 4 to 6 sweeps.
const MOST_SWEEPS: usize = 60;

/// Returns the c singular values of a matrix (n, c), largest first; values beyond the matrix's rank are 0 to rounding
/// error.
#[must_use]
pub fn singular_values(matrix: ArrayView2<'_, f64>) -> Vec<f64> {
    let mut columns: Vec<Vec<f64>> = matrix.columns().into_iter().map(|column| column.to_vec()).collect();
    // Columns are scaled, so that no square overflows or underflows.
    let largest = matrix.iter().fold(0.0f64, |most, value| most.max(value.abs()));
    if largest == 0.0 || !largest.is_finite() {
        return vec![if largest == 0.0 { 0.0 } else { f64::NAN }; columns.len()];
    }
    columns.iter_mut().flatten().for_each(|value| *value /= largest);
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    for _ in 0..MOST_SWEEPS {
        let mut turned = false;
        for first in 0..columns.len() {
            for second in first + 1..columns.len() {
                let (left, right) = columns.split_at_mut(second);
                let (a, b) = (&mut left[first], &mut right[0]);
                let (aa, bb, ab) = (dot(a, a), dot(b, b), dot(a, b));
                if ab.abs() <= f64::EPSILON * (aa * bb).sqrt() {
                    continue;
                }
                turned = true;
                let zeta = (bb - aa) / (2.0 * ab);
                let tangent = zeta.signum() / (zeta.abs() + zeta.hypot(1.0));
                let cosine = 1.0 / tangent.hypot(1.0);
                let sine = cosine * tangent;
                for (a, b) in a.iter_mut().zip(b) {
                    (*a, *b) = (cosine * *a - sine * *b, sine * *a + cosine * *b);
                }
            }
        }
        if !turned {
            break;
        }
    }
    let mut values: Vec<f64> = columns.iter().map(|column| largest * dot(column, column).sqrt()).collect();
    values.sort_by(|a, b| b.total_cmp(a));
    values
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::{Array2, array};

    #[test]
    fn values_of_a_graded_matrix_keep_their_digits() {
        // The matrix is a product of orthogonal columns of length 2, a diagonal matrix and a rotation.
        let q = array![[1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, -1.0]];
        let known = [3.0, 2e-5, 5e-11];
        let turn = array![[0.6, 0.8, 0.0], [-0.8, 0.6, 0.0], [0.0, 0.0, 1.0]];
        let matrix = crate::product::product((q * array![1.5, 1e-5, 2.5e-11]).view(), turn.view());
        for (found, known) in singular_values(matrix.view()).into_iter().zip(known) {
            // The matrix product itself has rounding errors of a few eps times the largest value.
            assert!((found - known).abs() < 4e-16 * 3.0, "{found:e} {known:e}");
        }
        let scaled = matrix.mapv(|value| value * 1e200);
        assert!((singular_values(scaled.view())[0] / 3e200 - 1.0).abs() < 1e-15);
    }

    #[test]
    fn zeros_and_wide_matrices_have_values_too() {
        assert_eq!(singular_values(Array2::zeros((3, 2)).view()), [0.0, 0.0]);
        let wide = singular_values(array![[3.0, 4.0, 0.0]].view());
        assert!((wide[0] - 5.0).abs() < 1e-15 && wide[1] < 1e-15 && wide[2] < 1e-15, "{wide:?}");
    }
}
