//! Where the normal equations of a factor come from.

use std::ops::Range;

use anyhow::Result;
use rayon::prelude::*;
use spharm_harmonics::index::{degree_order, first_column, order_count};
use spharm_harmonics::product::Matrix;
use spharm_harmonics::{Directions, HarmonicsError, Recurrence, Sweep, basis_size};
use spharm_solver::dense::{accumulate_adjoint, set_blas_threads};
use spharm_solver::{GramSource, SolverError};

/// Bytes that evaluated harmonics may take.
const WORK: usize = 64 << 20;

/// The Gram matrix of the harmonics to `max_degree` at `directions`, and the bytes of memory that it takes.
pub(super) fn gram_source(
    directions: &Directions,
    max_degree: usize,
    threads: usize,
) -> Result<(Box<dyn GramSource + '_>, usize)> {
    let source = Direct::new(directions, max_degree, threads)?;
    let bytes = source.bytes();
    Ok((Box::new(source), bytes))
}

/// By direct sums over the directions: 2 n flops an entry.
struct Direct<'a> {
    directions: &'a Directions,
    recurrence: Recurrence,
    max_degree: usize,
    threads: usize,
    /// Directions of a run; some runs are evaluated at a time, by a thread each.
    run: usize,
}

impl<'a> Direct<'a> {
    fn new(directions: &'a Directions, max_degree: usize, threads: usize) -> Result<Self, HarmonicsError> {
        let run = (WORK / (8 * basis_size(max_degree) * threads)).clamp(8, 256);
        Ok(Self { directions, recurrence: Recurrence::new(max_degree)?, max_degree, threads, run })
    }

    fn bytes(&self) -> usize {
        let run = 8 * self.run * (basis_size(self.max_degree) + order_count(self.max_degree));
        Recurrence::bytes(self.max_degree) + self.threads * (run + Sweep::bytes(self.run, self.max_degree))
    }

    /// The columns of a range at some directions, (directions, columns) column-major.
    fn columns(&self, directions: &[[f64; 3]], columns: &Range<usize>) -> Vec<f64> {
        let rows = directions.len();
        let mut sweep = Sweep::new(&self.recurrence, directions);
        let (mut values, mut block) = (Vec::with_capacity(rows * columns.len()), Vec::new());
        for degree in 0..=degree_order(columns.end - 1).0 {
            let first = first_column(degree);
            if first + order_count(degree) <= columns.start {
                sweep.skip_degree();
                continue;
            }
            block.resize(rows * order_count(degree), 0.0);
            sweep.next_degree(&mut block);
            let from = columns.start.saturating_sub(first);
            let to = order_count(degree).min(columns.end - first);
            values.extend_from_slice(&block[from * rows..to * rows]);
        }
        values
    }
}

impl GramSource for Direct<'_> {
    fn size(&self) -> usize {
        basis_size(self.max_degree)
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        let both = rows.start.min(columns.start)..rows.end.max(columns.end);
        let height = rows.len();
        // The product is made without gaps.
        let mut sums = vec![0.0; if leading == height { 0 } else { height * columns.len() }];
        let sum = if leading == height { &mut out[..height * columns.len()] } else { &mut sums[..] };
        sum.fill(0.0);
        for together in self.directions.as_slice().chunks(self.run * self.threads) {
            let runs: Vec<&[[f64; 3]]> = together.chunks(self.run).collect();
            let blocks: Vec<Vec<f64>> = runs.par_iter().map(|run| self.columns(run, &both)).collect();
            set_blas_threads(self.threads);
            for (run, block) in runs.iter().zip(&blocks) {
                let of = |range: &Range<usize>| {
                    let count = run.len();
                    Matrix::new(&block[(range.start - both.start) * count..], count, range.len(), count)
                };
                // Row-major (columns, rows) is column-major (rows, columns).
                accumulate_adjoint(of(&columns), of(&rows), sum);
            }
            set_blas_threads(1);
        }
        for (out, sums) in out.chunks_mut(leading).zip(sums.chunks_exact(height)) {
            out[..height].copy_from_slice(sums);
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_are_sums_over_the_directions() {
        let angles: Vec<_> = (0..300).map(|i| [0.01 * i as f64 + 0.05, 2.4 * i as f64]).collect();
        let directions = Directions::from_angles(&angles).expect("directions");
        let (source, _) = gram_source(&directions, 5, 2).expect("a source");
        for (rows, columns, gap) in [(0..36, 0..36, 0), (9..36, 9..20, 0), (30..36, 0..7, 3), (2..5, 11..12, 1)] {
            let leading = rows.len() + gap;
            let mut tile = vec![7.0; leading * columns.len()];
            source.tile(rows.clone(), columns.clone(), &mut tile, leading).expect("a tile");
            for (j, column) in columns.enumerate() {
                for (i, row) in rows.clone().enumerate() {
                    let harmonic = |at: usize, u: [f64; 3]| {
                        let (degree, order) = degree_order(at);
                        spharm_harmonics::textbook::harmonic(degree, order, u)
                    };
                    let sum: f64 = directions.as_slice().iter().map(|&u| harmonic(row, u) * harmonic(column, u)).sum();
                    assert!((tile[j * leading + i] - sum).abs() < 1e-11, "({row}, {column})");
                }
            }
        }
    }
}
