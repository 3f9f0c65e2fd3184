//! A factor in single precision, to precondition with.
//!
//! It takes half of the time and of the memory of one in double precision. What is factorised is
//!
//! ```text
//! S = D N D + sigma I,   D = diag(N)^-1/2,
//! ```
//!
//! with sigma some rounding errors of single precision, so that S is definite where N is. `D S^-1 D N` has eigenvalues
//! near 1 but for those directions in which N is smaller than some sigma. Conjugate gradients with products in double
//! precision take five to ten iterations with it, even where sigma is a hundred times N's smallest eigenvalue. Measured
//! on head27618 at degree 100, whose N has a condition number of 1.6e8: seven to an optimality of 3e-14 for sigma =
//! 6e-7, eleven to 7e-15 for 2e-6.

use ndarray::Array2;
use spharm_monitor::{Monitor, Stage, Unit};

use crate::SolverError;
use crate::cholesky::build::{FactorParams, FactorPlan, plan_of};
use crate::cholesky::factorise::{Panels, factorise};
use crate::cholesky::tiles::MemoryTiles;
use crate::cholesky::triangular;
use crate::gram::{Equilibrated, GramMatrix, Penalised};
use crate::lsq::columns::scale_rows;

/// sigma: the smallest that made head27618's matrix definite is below half of it.
const SHIFT: f64 = 1e-6;

/// The factor of `D N D + sigma I`.
#[derive(Debug)]
pub(crate) struct SingleFactor {
    tiles: MemoryTiles,
    /// D, (K).
    scaling: Vec<f64>,
    threads: usize,
}

/// Plans the memory of a factorisation in single precision of a matrix of `size` columns.
///
/// # Errors
///
/// [`spharm_store::StoreError::Budget`] with the least that works.
pub(crate) fn plan_single(size: usize, params: &FactorParams) -> Result<FactorPlan, SolverError> {
    Ok(plan_of::<f32>(size, params, false)?.0)
}

/// Factorises a matrix N with positive diagonal `diagonal`, (K).
///
/// The monitor gets one stage, `factor`, in flops.
///
/// # Errors
///
/// [`SolverError::NotPositiveDefinite`], [`spharm_store::StoreError::Budget`], [`SolverError::Interrupted`], those of
/// the source.
pub(crate) fn factorise_single(
    source: &dyn GramMatrix,
    diagonal: &[f64],
    params: &FactorParams,
    monitor: &dyn Monitor,
) -> Result<SingleFactor, SolverError> {
    let scaling: Vec<f64> = diagonal.iter().map(|value| 1.0 / value.sqrt()).collect();
    let (plan, grid) = plan_of::<f32>(source.size(), params, false)?;
    let threads = crate::threads(params.threads);
    let panels = Panels { grid, width: plan.panel.div_ceil(grid.tile()), threads };
    let tiles = MemoryTiles::new(grid);
    monitor.begin(Stage { name: "factor", unit: Unit::Flops }, panels.flops() as u64);
    // D (N + sigma D^-2) D.
    let shifted = Penalised::new(source, diagonal.iter().map(|value| SHIFT * value).collect());
    factorise::<f32>(&Equilibrated::new(&shifted, &scaling), &tiles, &panels, monitor)?;
    monitor.end();
    Ok(SingleFactor { tiles, scaling, threads })
}

impl SingleFactor {
    /// Returns the number of rows and columns, K.
    pub(crate) fn size(&self) -> usize {
        self.scaling.len()
    }

    /// Computes `D S^-1 D r`, r (K, c).
    pub(crate) fn apply(&self, r: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        let mut z = r.clone();
        scale_rows(&mut z, &self.scaling);
        triangular::solve(&self.tiles, z.view_mut(), self.threads)?;
        scale_rows(&mut z, &self.scaling);
        Ok(z)
    }
}

#[cfg(test)]
mod tests {
    use std::ops::Range;

    use spharm_monitor::Silent;

    use super::*;

    /// `exp(-|i - j| / 40)` with rows and columns scaled by numbers from 1e-3 to 1e3, less `lack` of the diagonal.
    struct Correlated {
        size: usize,
        lack: f64,
    }

    impl Correlated {
        fn scale(&self, i: usize) -> f64 {
            10f64.powf(6.0 * i as f64 / self.size as f64 - 3.0)
        }

        fn entry(&self, i: usize, j: usize) -> f64 {
            let value = (-(i.abs_diff(j) as f64) / 40.0).exp() - if i == j { self.lack } else { 0.0 };
            value * self.scale(i) * self.scale(j)
        }
    }

    impl GramMatrix for Correlated {
        fn size(&self) -> usize {
            self.size
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
            for (j, out) in columns.zip(out.chunks_mut(leading)) {
                rows.clone().zip(out).for_each(|(i, out)| *out = self.entry(i, j));
            }
            Ok(())
        }
    }

    fn factor(matrix: &Correlated, threads: usize) -> Result<SingleFactor, SolverError> {
        let diagonal: Vec<f64> = (0..matrix.size).map(|i| matrix.scale(i).powi(2)).collect();
        // Panels of two tiles: products with earlier columns are taken, too.
        let narrow = FactorParams { tile: 64, threads, ..FactorParams::default() };
        let least = Panels { grid: spharm_store::TileGrid::new(matrix.size, 64).unwrap(), width: 2, threads };
        let most = plan_single(matrix.size, &narrow).unwrap().memory;
        let whole = Panels { width: plan_single(matrix.size, &narrow).unwrap().panel.div_ceil(64), ..least };
        let memory = most - whole.bytes::<f32>() + least.bytes::<f32>();
        factorise_single(matrix, &diagonal, &FactorParams { memory, ..narrow }, &Silent)
    }

    /// Solutions are some 1e-3 off: the condition of D N D is 6e3, single precision and sigma are 1e-6.
    #[test]
    fn it_nearly_inverts_and_scales() {
        for (size, threads) in [(1, 1), (63, 1), (64, 2), (700, 1), (700, 2), (700, 3), (1500, 2)] {
            let matrix = Correlated { size, lack: 0.0 };
            let factor = factor(&matrix, threads).unwrap();
            let expected = Array2::from_shape_fn((size, 2), |(i, c)| ((3 * i + c) as f64).sin() / matrix.scale(i));
            let product = |c: usize, i: usize| (0..size).map(|j| matrix.entry(i, j) * expected[[j, c]]).sum();
            let right = Array2::from_shape_fn((size, 2), |(i, c)| product(c, i));
            let found = factor.apply(&right).unwrap();
            for ((i, c), value) in expected.indexed_iter() {
                let off = (found[[i, c]] - value).abs() * matrix.scale(i);
                assert!(off < 5e-3, "{size} {threads} {i}: {off:e}");
            }
        }
    }

    #[test]
    fn what_is_not_definite_is_refused_with_its_column() {
        let found = factor(&Correlated { size: 700, lack: 0.2 }, 2);
        assert!(matches!(found, Err(SolverError::NotPositiveDefinite { column: 1.., .. })), "{:?}", found.err());
    }
}
