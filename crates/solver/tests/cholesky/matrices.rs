//! Provides Gram matrices of scattered directions, and their factors.

use std::ops::Range;
use std::path::Path;

use faer::Mat;
use ndarray::Array2;
use spharm_harmonics::{Directions, Recurrence, Sweep, basis_size};
use spharm_monitor::Silent;
use spharm_solver::cholesky::{build_factor, factorise, plan_factor};
use spharm_solver::{FactorParams, GramMatrix, MemoryFactor, SolverError, StoredFactor};
use spharm_store::factor::FactorFile;
use spharm_store::{FactorSpec, SchemeKey, StoreError, WeightsHash};

/// A Gram matrix in memory.
pub(crate) struct Dense(pub(crate) Array2<f64>);

impl GramMatrix for Dense {
    fn size(&self) -> usize {
        self.0.nrows()
    }

    fn bytes(&self) -> usize {
        8 * self.0.len()
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        for (column, out) in columns.zip(out.chunks_mut(leading)) {
            rows.clone().zip(out).for_each(|(row, out)| *out = self.0[[row, column]]);
        }
        Ok(())
    }
}

/// Returns the Gram matrix A^T A of the harmonics at `directions`, by direct sums.
pub(crate) fn gram(directions: &Directions, max_degree: usize) -> Dense {
    let (n, k) = (directions.len(), basis_size(max_degree));
    let recurrence = Recurrence::new(max_degree).unwrap();
    let mut sweep = Sweep::new(&recurrence, directions.as_slice());
    let mut basis = Vec::new();
    for l in 0..=max_degree {
        let mut block = vec![0.0; n * (2 * l + 1)];
        sweep.next_degree(&mut block);
        basis.extend(block);
    }
    let basis = Array2::from_shape_vec((k, n), basis).unwrap();
    Dense(basis.dot(&basis.t()))
}

pub(crate) fn scattered(n: usize) -> Directions {
    Directions::fibonacci(n).unwrap()
}

pub(crate) fn filled(rows: usize, columns: usize) -> Array2<f64> {
    Array2::from_shape_fn((rows, columns), |(i, j)| ((i * 7 + j * 13) as f64 * 0.37).sin())
}

pub(crate) fn spec(max_degree: usize, rows: usize) -> FactorSpec {
    FactorSpec { key: SchemeKey([3; 32]), rows, max_degree, weights: WeightsHash::ONES, smoothness: 0.0 }
}

pub(crate) fn in_memory(source: &dyn GramMatrix, params: &FactorParams) -> MemoryFactor {
    factorise(source, params, &Silent).unwrap()
}

/// Builds a factor out of core with the smallest sufficient memory, in panels of one tile column.
pub(crate) fn out_of_core(
    store: &Path,
    source: &dyn GramMatrix,
    spec: &FactorSpec,
    params: &FactorParams,
) -> FactorFile {
    let least = match plan_factor(source.size(), &FactorParams { memory: 0, ..params.clone() }, true) {
        Err(SolverError::Store(StoreError::Budget { needed, .. })) => needed,
        other => panic!("{other:?}"),
    };
    let params = FactorParams { memory: least, ..params.clone() };
    let (plan, _) = plan_factor(source.size(), &params, true).unwrap();
    assert_eq!((plan.memory, plan.panel), (least, params.tile.min(source.size())));
    let report = build_factor(store, spec, source, &params, &Silent).unwrap();
    assert!(!report.present);
    report.file
}

pub(crate) fn stored(file: &FactorFile, memory: usize, threads: usize) -> StoredFactor {
    StoredFactor::new(file.clone(), memory, threads)
}

/// Returns the factor C of a file, (K, K).
pub(crate) fn lower(file: &FactorFile) -> Array2<f64> {
    use spharm_store::factor::TileValues;
    let grid = file.header().grid;
    let mut c = Array2::zeros((grid.size(), grid.size()));
    for column in 0..grid.columns() {
        let window = file.window(column).unwrap();
        for row in column..grid.columns() {
            let values: Vec<f64> = match window.values(row).unwrap() {
                TileValues::F64(values) => values.to_vec(),
                TileValues::F32(values) => values.iter().map(|&value| f64::from(value)).collect(),
            };
            let height = grid.range(row).len();
            for (at, value) in values.into_iter().enumerate() {
                c[[grid.range(row).start + at % height, grid.range(column).start + at / height]] = value;
            }
        }
        window.check().unwrap();
    }
    c
}

pub(crate) fn to_faer(a: &Array2<f64>) -> Mat<f64> {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[[i, j]])
}

pub(crate) fn largest(values: &Array2<f64>) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}
