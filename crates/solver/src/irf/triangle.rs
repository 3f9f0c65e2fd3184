//! Computes the triangular factor R of a tall matrix that arrives in chunks of rows.
//!
//! The R of the first chunks is updated for each further chunk: the chunk is stacked below R, and the stack is
//! factorised again. This is the sequential tall-skinny QR of Demmel, Grigori, Hoemmen and Langou (SIAM J. Sci. Comput.
//! 34, 2012, section 3). For n rows and k columns it keeps a small multiple of k^2 numbers in memory and takes 2 n k^2
//! flops. Unlike a Gram matrix, R preserves singular values down to the largest one times the machine epsilon.

use spharm_harmonics::product::Matrix;

use crate::dense::triangularise;

/// The triangular factor R (height, columns) of the rows so far, with height at most columns, and the rows that haven't
/// been folded into R yet.
#[derive(Debug, Clone)]
pub(super) struct Triangle {
    values: Vec<f64>,
    height: usize,
    columns: usize,
    /// Runs of rows that haven't been folded into R yet: for each run the number of rows, and the rows, column-major.
    /// The rows are folded when there are about as many of them as columns, because folding fewer rows at a time takes
    /// longer in total.
    waiting: Vec<(usize, Vec<f64>)>,
}

impl Triangle {
    pub(super) fn new(columns: usize) -> Self {
        Self { values: Vec::new(), height: 0, columns, waiting: Vec::new() }
    }

    pub(super) fn push(&mut self, rows: Matrix<'_>) {
        assert_eq!(rows.columns(), self.columns, "the rows must have as many columns as the factor");
        let values = (0..self.columns).flat_map(|j| rows.column(j)).copied().collect();
        self.waiting.push((rows.rows(), values));
        if self.waiting.iter().map(|(rows, _)| rows).sum::<usize>() >= self.columns {
            self.fold();
        }
    }

    /// Adds the rows of another triangular factor to R.
    pub(super) fn push_triangle(&mut self, other: Self) {
        let other = other.folded();
        if other.height > 0 {
            self.waiting.push((other.height, other.values));
            self.fold();
        }
    }

    fn folded(mut self) -> Self {
        if !self.waiting.is_empty() {
            self.fold();
        }
        self
    }

    fn fold(&mut self) {
        let stacked = self.height + self.waiting.iter().map(|(rows, _)| rows).sum::<usize>();
        let mut values = Vec::with_capacity(stacked * self.columns);
        for j in 0..self.columns {
            values.extend_from_slice(&self.values[j * self.height..(j + 1) * self.height]);
            for (rows, run) in &self.waiting {
                values.extend_from_slice(&run[j * rows..(j + 1) * rows]);
            }
        }
        self.waiting.clear();
        triangularise(&mut values, stacked, self.columns);
        let height = stacked.min(self.columns);
        self.values = values.chunks_exact(stacked).flat_map(|column| &column[..height]).copied().collect();
        self.height = height;
    }

    /// Splits the triangular factor of `[A | r]`, where A has k columns, into R (m, k) and the transformed right-hand
    /// sides z (m, c), with m = min(height, k), both column-major. `min |A x - r|` and `min |R x - z|` have the same
    /// solution. Also returns m.
    pub(super) fn split(self, k: usize) -> (Vec<f64>, Vec<f64>, usize) {
        let this = self.folded();
        let m = this.height.min(k);
        let mut top = this.values.chunks_exact(this.height).map(|column| &column[..m]);
        let r = top.by_ref().take(k).flatten().copied().collect();
        (r, top.flatten().copied().collect(), m)
    }
}
