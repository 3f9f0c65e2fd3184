//! Computes products with `A_g^T D A_g`, where A_g is the basis at the points of a grid and D is a diagonal matrix.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use spharm_harmonics::basis_size;

use super::ring_grid::{CHANNELS, RingGrid, Task, Workspace};
use crate::TransformError;
use crate::legendre::SomeColumns;
use crate::pool::Pool;

/// Sizes of an [`OnGrid`] in bytes.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    pub(super) held: usize,
    /// Additional bytes during construction from a function of degree 2L.
    pub(super) made: usize,
    /// Additional bytes in calls.
    pub(super) called: usize,
}

/// The operator `A_g^T D A_g`, with A_g the basis at the points of a grid, stored as the grid and the diagonal of D.
#[derive(Debug)]
pub(super) struct OnGrid {
    grid: RingGrid,
    /// The diagonal of the matrix D: real parts for the points of northern rings, imaginary parts for their mirror
    /// images on southern rings.
    diagonal: Vec<Complex64>,
    /// Working memory of earlier calls, reused by later calls.
    spaces: Pool<Workspace>,
    tasks: Pool<Task>,
}

impl OnGrid {
    pub(super) fn new(grid: RingGrid, diagonal: Vec<Complex64>) -> Self {
        Self { grid, diagonal, spaces: Pool::default(), tasks: Pool::default() }
    }

    /// Returns the memory sizes of the operator for a grid of `rings` pairs of rings with up to `points` points each.
    /// `rings` is a multiple of 8.
    pub(super) const fn sizes(
        max_degree: usize,
        rings: usize,
        points: usize,
        channels: usize,
        threads: usize,
    ) -> Sizes {
        let orders = max_degree + 1;
        // Bytes of the Legendre tables (`alpha`, `scale`, the factors for pairs of degrees, and the powers of the
        // sine), and of the points of all pairs of rings.
        let held = 18 * orders * (orders + 1) + 80 * orders + 8 * orders * rings + 16 * rings * points;
        // Bytes used only during construction: the tables for functions of degree 2L, and the sums that are computed
        // with these tables.
        let made =
            18 * 2 * orders * (2 * orders + 1) + 160 * orders + 2 * 8 * orders * rings + 2 * 8 * orders * 4 * rings;
        let group = if channels < CHANNELS { channels } else { CHANNELS };
        let groups = channels.div_ceil(CHANNELS);
        let groups = if groups < threads { groups } else { threads };
        let tasks = threads * (8 * 18 * rings + 96 * orders + 2 * 16 * points + (32 << 10));
        let called = tasks + groups * 2 * group * (2 * 8 * 2 * orders * rings + 4 * orders * (orders + 1));
        Sizes { held, made, called }
    }

    pub(super) fn max_degree(&self) -> usize {
        self.grid.max_degree()
    }

    /// Computes `A_g^T D A_g x` for x (K, c).
    pub(super) fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
        let (expected, found) = (basis_size(self.max_degree()), x.nrows());
        if found != expected {
            return Err(TransformError::Shape { what: "coefficients", expected, found });
        }
        let mut out = Array2::zeros(x.dim());
        let all = x.ncols();
        let x = x.as_standard_layout();
        let x = x.as_slice().unwrap_or_default();
        // Groups of channels are independent: if there are several groups, each thread processes groups of its own.
        out.axis_chunks_iter_mut(Axis(1), CHANNELS).into_par_iter().enumerate().with_max_len(1).for_each(
            |(group, out)| {
                let x = SomeColumns { values: x, all, first: group * CHANNELS };
                self.spaces
                    .with(Workspace::default, |space| self.grid.product(&self.diagonal, x, out, space, &self.tasks));
            },
        );
        Ok(out)
    }
}
