//! Computes the Gram matrix `A^T diag(w) A` of the canonical basis at n scattered weighted directions, without
//! evaluating the basis.
//!
//! The Gram matrix depends on weights and directions only through the *moments* `s_{lm} = sum_i w_i S_{lm}(x_i)` to
//! degree 2L, because a product of two harmonics of degrees up to L has degree 2L. One adjoint synthesis of the weights
//! computes the moments. With `S = sum s_{lm} S_{lm}`, `sum_i w_i h(x_i) = integral of S h` for every h of degree up to
//! 2L. The integrand has degree 4L, which 2L + 1 Gauss-Legendre rings integrate exactly. On these rings, for orders m,
//! m' >= 0 and s, s' in {cos, sin},
//!
//! ```text
//! G[(l, m, s), (l', m', s')] = sum_j P_{l,m}(theta_j) W_{m,m'}^{s,s'}(j) P_{l',m'}(theta_j)
//! W^{cos,cos} = c_{m-m'} + c_{m+m'}      W^{sin,cos} = d_{m+m'} + d_{m-m'}
//! W^{sin,sin} = c_{m-m'} - c_{m+m'}      W^{cos,sin} = d_{m+m'} - d_{m-m'}
//! ```
//!
//! where `c_k`, `d_k` are half the Fourier coefficients of S on the ring (`gram/measure.rs`). A product of three
//! harmonics of degrees l, l', l'' integrates to zero unless l + l' + l'' is even, because
//! `S_{lm}(-x) = (-1)^l S_{lm}(x)`. Therefore only moments whose degree has the parity of l + l' contribute. For these
//! moments the integrand is the same on mirrored rings, so the L + 1 rings from the north pole to the equator suffice.
//! This halves the number of flops.
//!
//! # Cost
//!
//! The cost doesn't depend on n. The lower triangle takes `L^5` flops (1.05e10 at L = 100, 3.3e11 at L = 200), and the
//! tables take about `40 L^3` flops. The memory of the tables is 12 MB at L = 100 and 65 MB at L = 200; see
//! [`MomentGram::bytes`]. The matrix itself takes `8 (L + 1)^4` bytes and is written once, column by column.
//!
//! # Range
//!
//! L is at most half of [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE). Weights may be negative. Errors are a few eps
//! times the largest entry. The bits of an entry depend neither on the number of threads nor on the tile in which it is
//! computed.
//!
//! On the circle, the Gram matrix of scattered data computed from its moments is the Toeplitz matrix of H. G.
//! Feichtinger, K. Gröchenig and T. Strohmer, "Efficient numerical methods in non-uniform sampling theory", Numer.
//! Math. 69 (1995). The Gram matrix computed here is the analogue on the sphere.
//!
//! ```
//! use spharm_transform::MomentGram;
//!
//! // The uniform measure: all moments but the first vanish, and the Gram matrix is the identity.
//! let mut moments = vec![0.0; 25]; // to degree 2 L = 4
//! moments[0] = (4.0 * std::f64::consts::PI).sqrt();
//! let gram = MomentGram::new(2, &moments)?;
//! let mut lower = vec![0.0; 81]; // (9, 9) column-major
//! gram.write_lower(&mut lower, 9);
//! assert!((lower[0] - 1.0).abs() < 1e-14 && lower[1].abs() < 1e-14);
//! # Ok::<(), spharm_transform::TransformError>(())
//! ```

mod kernel;
mod measure;
mod panel;
#[cfg(test)]
mod tests;

use std::ops::{Range, RangeInclusive};

use rayon::prelude::*;
use spharm_harmonics::basis_size;
use spharm_harmonics::index::{degree_order, first_column};

use crate::TransformError;
use crate::moments::check;
use measure::Measure;
use panel::{Columns, Part, Rows};

/// Number of pairs (l', m') per task. Every task reads the whole Legendre table, so tasks must not be too small, but
/// there must be enough tasks for all threads.
const TASK: usize = 32;
/// Number of columns and of rows of the tiles in which the matrix is mirrored. A tile takes 32 kB, which fits in the L1
/// cache.
const MIRROR: usize = 64;

/// The Gram matrix `A^T diag(w) A` (K, K) of the canonical basis to degree L, computed from the moments of the weights.
///
/// Entries are computed on request: the whole matrix, tiles or blocks of degrees. Methods run on the rayon pool from
/// which they are called.
#[derive(Debug)]
pub struct MomentGram {
    measure: Measure,
}

impl MomentGram {
    /// Builds the tables for the Gram matrix to degree L = `max_degree` from the moments `sum_i w_i S_{lm}(x_i)` to
    /// degree 2L, `(2L + 1)^2` values in canonical order.
    ///
    /// # Errors
    ///
    /// - [`TransformError::MomentCount`] if the number of moments isn't `(2L + 1)^2`.
    /// - [`TransformError::MomentNotFinite`] if a moment is NaN or infinite.
    /// - [`TransformError::Harmonics`] if 2L is above [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE).
    pub fn new(max_degree: usize, moments: &[f64]) -> Result<Self, TransformError> {
        check(max_degree, moments)?;
        Ok(Self { measure: Measure::new(max_degree, moments)? })
    }

    /// Returns the size in bytes of the tables for degree L, about `4 (L + 1)^3 + 768 (L + 1)^2`. During computation
    /// each thread needs about 1 MiB more.
    pub const fn bytes(max_degree: usize) -> usize {
        Measure::bytes(max_degree)
    }

    /// Returns the highest degree, L.
    pub fn max_degree(&self) -> usize {
        self.measure.max_degree()
    }

    /// Returns the number of rows and of columns of the whole matrix, `K = (L + 1)^2`.
    pub fn size(&self) -> usize {
        basis_size(self.max_degree())
    }

    /// Writes the lower triangle, including the diagonal, to `out`, a column-major matrix (K, K) in canonical order
    /// whose columns are `leading` values apart. Values above the diagonal are left unchanged.
    ///
    /// # Panics
    ///
    /// If `leading` is below K or `out` is too short.
    pub fn write_lower(&self, out: &mut [f64], leading: usize) {
        self.fill(0..self.size(), 0..self.size(), true, out, leading);
    }

    /// Writes the entries in `rows` and `columns`, anywhere in the symmetric matrix, to `out`, a column-major matrix
    /// (rows, columns) whose columns are `leading` values apart.
    ///
    /// Tiles of several complete degrees cost least per entry, because the cosine and sine columns of a degree and
    /// order share their sums, and because a kernel processes three degrees of equal parity at a time. Tiles of fewer
    /// than two degrees per side cost three times as much per entry.
    ///
    /// # Panics
    ///
    /// If a range ends above K, `leading` is below the number of rows or `out` is too short.
    pub fn tile(&self, rows: Range<usize>, columns: Range<usize>, out: &mut [f64], leading: usize) {
        self.fill(rows, columns, false, out, leading);
    }

    /// Writes both triangles of the Gram matrix of a range of degrees to `out`, a column-major matrix (k, k), where k
    /// is the number of basis functions of these degrees. The result is exactly symmetric, to the last bit.
    ///
    /// # Panics
    ///
    /// If the degrees go above L or `out` isn't `k^2` long.
    pub fn block(&self, degrees: RangeInclusive<usize>, out: &mut [f64]) {
        let columns = first_column(*degrees.start())..first_column(degrees.end() + 1);
        let size = columns.len();
        assert_eq!(out.len(), size * size, "expected a block of {size} x {size} values");
        self.fill(columns.clone(), columns, true, out, size);
        mirror_lower(out, size);
    }

    /// Writes the entries in `rows` and `columns`. If `lower` is set, writes only the entries on and below the
    /// diagonal.
    fn fill(&self, rows: Range<usize>, columns: Range<usize>, lower: bool, out: &mut [f64], leading: usize) {
        let size = self.size();
        assert!(rows.end <= size && columns.end <= size, "rows {rows:?} and columns {columns:?} must lie in 0..{size}");
        if rows.is_empty() || columns.is_empty() {
            return;
        }
        assert!(leading >= rows.len(), "leading dimension {leading} is below the number of rows, {}", rows.len());
        let needed = (columns.len() - 1) * leading + rows.len();
        assert!(
            out.len() >= needed,
            "{} columns with leading dimension {leading} need {needed} values, found {}",
            columns.len(),
            out.len()
        );

        // Group the columns by order, because the sums of the cosine and the sine column of one order have factors in
        // common.
        let mut orders: Vec<Vec<Part<'_>>> = (0..=self.max_degree()).map(|_| Vec::new()).collect();
        for (column, values) in columns.zip(out[..needed].chunks_mut(leading)) {
            let (degree, order) = degree_order(column);
            let parts = &mut orders[order.unsigned_abs()];
            let skipped = if lower { column.clamp(rows.start, rows.end) - rows.start } else { 0 };
            let values = &mut values[skipped..rows.len()];
            if parts.last().is_none_or(|part| part.degree != degree) {
                parts.push(Part::new(degree));
            }
            if let Some(part) = parts.last_mut() {
                part.signs[usize::from(order < 0)] = Some(values);
            }
        }
        let rows = Rows { range: rows, lower };
        self.tasks(orders).into_par_iter().with_max_len(1).for_each(|mut task| {
            panel::fill(&self.measure, &rows, &mut task);
        });
    }

    /// Groups the columns, which are sorted by order, into tasks of about [`TASK`] degrees. A task consists of one
    /// order if the order has that many degrees, and otherwise of as many orders as fit in the cache together.
    fn tasks<'a>(&self, orders: Vec<Vec<Part<'a>>>) -> Vec<Vec<Columns<'a>>> {
        let most = panel::most_orders(self.measure.rings());
        let mut tasks: Vec<Vec<Columns<'a>>> = Vec::new();
        let mut room = 0;
        for (order, mut parts) in orders.into_iter().enumerate() {
            while !parts.is_empty() {
                let rest = parts.split_off(TASK.min(parts.len()));
                match tasks.last_mut() {
                    Some(task) if parts.len() <= room && task.len() < most => {
                        room -= parts.len();
                        task.push(Columns { order, parts });
                    }
                    _ => {
                        room = TASK - parts.len();
                        tasks.push(vec![Columns { order, parts }]);
                    }
                }
                parts = rest;
            }
        }
        tasks
    }
}

/// Copies the lower triangle of a matrix (size, size) to its upper triangle.
fn mirror_lower(matrix: &mut [f64], size: usize) {
    for first in (0..size).step_by(MIRROR) {
        for start in (first..size).step_by(MIRROR) {
            for column in first..size.min(first + MIRROR) {
                for row in start.max(column + 1)..size.min(start + MIRROR) {
                    matrix[row * size + column] = matrix[column * size + row];
                }
            }
        }
    }
}
