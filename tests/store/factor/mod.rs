//! Guarantees of stored factors, one file for each guarantee.

mod bits;
mod golden;
mod hostile;
mod tool;

use std::ops::Range;
use std::path::Path;

use spharm_harmonics::index::degree_order;
use spharm_harmonics::{Directions, textbook};
use spharm_monitor::Silent;
use spharm_solver::SolverError;
use spharm_solver::cholesky::{FactorParams, build_factor};
use spharm_solver::gram::{GramMatrix, smoothness_penalty};
use spharm_store::factor::TileValues;
use spharm_store::{FactorFile, FactorSpec, Scalar, SchemeKey, WeightsHash};

/// Context with which the root hash of a factor is derived.
const ROOT_CONTEXT: &str = "spharm-rs 2026-11 factor file root v1";

/// The Gram matrix G of harmonics by textbook formulas, with weights and penalty, computed entry by entry.
struct Textbook<'a> {
    directions: &'a Directions,
    max_degree: usize,
    weights: Option<&'a [f64]>,
    smoothness: f64,
}

impl Textbook<'_> {
    fn entry(&self, row: usize, column: usize) -> f64 {
        let harmonic = |at: usize, u: [f64; 3]| {
            let (degree, order) = degree_order(at);
            textbook::harmonic(degree, order, u)
        };
        let weight = |i: usize| self.weights.map_or(1.0, |weights| weights[i]);
        let directions = self.directions.as_slice().iter().enumerate();
        let sum: f64 = directions.map(|(i, &u)| weight(i) * harmonic(row, u) * harmonic(column, u)).sum();
        sum + if row == column { smoothness_penalty(self.max_degree, self.smoothness)[row] } else { 0.0 }
    }

    fn spec(&self, scalar: Scalar) -> FactorSpec {
        FactorSpec {
            key: SchemeKey::of(self.directions, scalar),
            rows: self.directions.len(),
            max_degree: self.max_degree,
            weights: WeightsHash::of(self.weights),
            smoothness: self.smoothness,
        }
    }

    /// Builds the factor under the key of a basis of f64, in tiles of 8.
    fn build(&self, store: &Path, scalar: Scalar) -> FactorFile {
        let params = FactorParams { scalar, tile: 8, threads: 1, ..FactorParams::default() };
        build_factor(store, &self.spec(Scalar::F64), self, &params, &Silent).expect("a factor").file
    }
}

impl GramMatrix for Textbook<'_> {
    fn size(&self) -> usize {
        spharm_harmonics::basis_size(self.max_degree)
    }

    fn bytes(&self) -> usize {
        0
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        for (column, out) in columns.zip(out.chunks_mut(leading)) {
            rows.clone().zip(out).for_each(|(row, out)| *out = self.entry(row, column));
        }
        Ok(())
    }
}

/// Returns the factor C in a file, (K, K), row by row.
pub(super) fn lower(file: &FactorFile) -> Vec<f64> {
    let grid = file.header().grid;
    let mut c = vec![0.0; grid.size() * grid.size()];
    for column in 0..grid.columns() {
        let window = file.window(column).expect("a window");
        for row in column..grid.columns() {
            let values: Vec<f64> = match window.values(row).expect("values") {
                TileValues::F64(values) => values.to_vec(),
                TileValues::F32(values) => values.iter().map(|&value| f64::from(value)).collect(),
            };
            let height = grid.range(row).len();
            for (at, value) in values.into_iter().enumerate() {
                let (i, j) = (grid.range(row).start + at % height, grid.range(column).start + at / height);
                c[i * grid.size() + j] = value;
            }
        }
        window.check().expect("an unchanged file");
    }
    c
}
