//! QR factorisation by Householder reflections, a panel of columns at a time.
//!
//! faer's factorisation isn't used: if the rest of a column is below 16 m eps of the column's norm, for m rows, faer
//! treats the column as linearly dependent on the previous columns and drops the rest. The singular values of the
//! result then have errors of 16 m eps times the largest one, which can exceed the tolerance of a rank computation.
//! This factorisation drops nothing.

use faer::{Accum, Mat, MatMut};

use crate::dense::{add_gram, matmul, solve_lower};

/// Number of columns per panel. Wider panels spend more time on matrix-vector products.
const PANEL: usize = 32;

/// Replaces a matrix (m, n) by the triangular factor R of its QR factorisation, with zeros below the diagonal. Takes
/// `2 m n^2 - 2/3 n^3` flops for m >= n.
///
/// The algorithm is by Schreiber and Van Loan (SIAM J. Sci. Stat. Comput. 10, 1989).
pub fn triangularise(mut matrix: MatMut<'_, f64>) {
    let (rows, columns) = matrix.shape();
    let reflections = rows.min(columns);
    for first in (0..reflections).step_by(PANEL) {
        let width = PANEL.min(reflections - first);
        let rest = matrix.as_mut().submatrix_mut(first, first, rows - first, columns - first);
        let (panel, rest) = rest.split_at_col_mut(width);
        let reflectors = Reflectors::of_panel(panel);
        if columns > first + width {
            reflectors.apply(rest);
        }
    }
}

/// Reflections `I - v v^T / tau`, in the order in which they are applied.
struct Reflectors {
    /// The vectors v, as the k columns of a matrix (m, k); v is 0 if a column needs no reflection.
    vectors: Mat<f64>,
    /// The value tau of each reflection: `|v|^2 / 2`, or 1 if v is 0.
    taus: Vec<f64>,
}

impl Reflectors {
    /// Replaces a panel of columns (m, k), with m >= k, by its triangular factor, and returns the reflections that
    /// produce this factor.
    fn of_panel(mut panel: MatMut<'_, f64>) -> Self {
        let (rows, width) = panel.shape();
        let mut vectors = Mat::zeros(rows, width);
        let mut taus = vec![1.0; width];
        for (j, tau) in taus.iter_mut().enumerate() {
            let below = rows - j;
            let (mut column, mut rest) = panel.as_mut().submatrix_mut(j, j, below, width - j).split_at_col_mut(1);
            let tail = column.as_ref().col(0).subrows(1, below - 1).norm_l2();
            if tail == 0.0 {
                continue;
            }
            let head = column[(0, 0)];
            let diagonal = -head.hypot(tail).copysign(head);
            let pivot = head - diagonal;
            let mut vector = vectors.as_mut().submatrix_mut(j, j, below, 1);
            vector[(0, 0)] = 1.0;
            for i in 1..below {
                vector[(i, 0)] = column[(i, 0)] / pivot;
                column[(i, 0)] = 0.0;
            }
            column[(0, 0)] = diagonal;
            *tau = 0.5 * (1.0 + (tail / pivot).powi(2));
            if width > j + 1 {
                let mut products = Mat::zeros(1, width - j - 1);
                matmul(products.as_mut(), Accum::Replace, vector.as_ref().transpose(), rest.as_ref(), 1.0 / *tau);
                matmul(rest.as_mut(), Accum::Add, vector.as_ref(), products.as_ref(), -1.0);
            }
        }
        Self { vectors, taus }
    }

    /// Applies the reflections to a matrix (m, n), by matrix-matrix products.
    fn apply(&self, mut matrix: MatMut<'_, f64>) {
        let vectors = self.vectors.as_ref();
        let width = vectors.ncols();
        // The reflections subtract multiples w_i of the vectors v_i from each column a. The multiples solve the system
        // tau_i w_i = v_i^T (a - v_1 w_1 - .. - v_i-1 w_i-1).
        let mut system = Mat::zeros(width, width);
        add_gram(system.as_mut(), vectors.transpose(), 1.0);
        self.taus.iter().enumerate().for_each(|(i, tau)| system[(i, i)] = *tau);
        let mut multiples = Mat::zeros(width, matrix.ncols());
        matmul(multiples.as_mut(), Accum::Replace, vectors.transpose(), matrix.as_ref(), 1.0);
        solve_lower(system.as_ref(), multiples.as_mut());
        matmul(matrix.as_mut(), Accum::Add, vectors, multiples.as_ref(), -1.0);
    }
}
