//! Where a Gram matrix comes from: tile by tile, so that nobody has to hold all of it.

use std::ops::Range;

use spharm_harmonics::index::order_count;

use crate::SolverError;

/// A symmetric matrix G = A^T diag(w) A, (K, K), columns in the order l^2 + l + m, that can be asked for by tiles.
pub trait GramSource: Sync {
    /// Rows and columns, K.
    fn size(&self) -> usize;

    /// Writes G[rows, columns] to `out`, column-major with `leading`; every entry, also above the diagonal.
    ///
    /// # Errors
    ///
    /// When the basis can't be evaluated or read.
    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError>;
}

/// G + diag(penalty).
#[derive(Debug)]
pub struct Penalised<'a, S: ?Sized> {
    source: &'a S,
    penalty: Vec<f64>,
}

impl<'a, S: GramSource + ?Sized> Penalised<'a, S> {
    /// Adds `penalty`, (K), to the diagonal.
    ///
    /// # Panics
    ///
    /// If it isn't of the matrix's size.
    pub fn new(source: &'a S, penalty: Vec<f64>) -> Self {
        assert_eq!(penalty.len(), source.size(), "penalty of the diagonal");
        Self { source, penalty }
    }
}

impl<S: GramSource + ?Sized> GramSource for Penalised<'_, S> {
    fn size(&self) -> usize {
        self.source.size()
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        self.source.tile(rows.clone(), columns.clone(), out, leading)?;
        for j in columns.start.max(rows.start)..columns.end.min(rows.end) {
            out[(j - columns.start) * leading + j - rows.start] += self.penalty[j];
        }
        Ok(())
    }
}

/// The diagonal of the smoothness penalty: lambda (l (l + 1))^2 for each column to `max_degree`, (K). It is the squared
/// norm of the Laplacian on the sphere.
pub fn smoothness_penalty(max_degree: usize, lambda: f64) -> Vec<f64> {
    let of = |l: usize| std::iter::repeat_n(lambda * ((l * (l + 1)) as f64).powi(2), order_count(l));
    (0..=max_degree).flat_map(of).collect()
}
