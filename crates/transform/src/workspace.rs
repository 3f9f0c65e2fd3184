//! Defines the working memory of a call, which the plan keeps for the next call, and the working memory of a thread.

use rayon::prelude::*;
use rustfft::num_complex::Complex64;

use crate::legendre::Work;

/// Working memory of a call.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    /// Values (order pairs, channels, M) on great circles of the grid.
    pub(crate) circles: Vec<Complex64>,
    /// Spectra (rows, channels, L + 1) of the grid's rows.
    pub(crate) spectra: Vec<Complex64>,
    /// The grid for interpolation and the grid for spreading, with margins.
    pub(crate) grids: [Vec<f64>; 2],
    /// Samples (groups, n, channels of a group) in sorted order, row-major.
    pub(crate) samples: Vec<f64>,
    /// Coefficients sorted by order: for each m an array (L + 1 - m, columns), row-major.
    pub(crate) by_order: Vec<f64>,
}

/// The parts of the working memory that a call uses. Unused parts cost nothing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Uses {
    /// Whether a call uses the grid for interpolation, and whether it uses the grid for spreading. The latter includes
    /// the memory for computing coefficients from this grid.
    grids: [bool; 2],
    samples: bool,
}

impl Uses {
    pub(crate) const SYNTHESIS: Self = Self { grids: [true, false], samples: true };
    pub(crate) const ADJOINT: Self = Self { grids: [false, true], samples: true };
    pub(crate) const NORMAL: Self = Self { grids: [true, true], samples: false };
}

/// Lengths of the parts of a [`Workspace`].
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sizes {
    pub(crate) circles: usize,
    pub(crate) spectra: usize,
    pub(crate) grid: usize,
    pub(crate) samples: usize,
    pub(crate) by_order: usize,
}

impl Workspace {
    /// Resizes the parts that are used.
    pub(crate) fn resize(&mut self, sizes: &Sizes, uses: Uses) {
        lengthen(&mut self.circles, sizes.circles);
        for (grid, used) in self.grids.iter_mut().zip(uses.grids) {
            if used {
                lengthen(grid, sizes.grid);
            }
        }
        if uses.grids[1] {
            lengthen(&mut self.spectra, sizes.spectra);
            lengthen(&mut self.by_order, sizes.by_order);
        }
        if uses.samples {
            lengthen(&mut self.samples, sizes.samples);
        }
    }
}

/// Resizes an array; the caller overwrites all values. If the array grows, all threads together create the new array,
/// because the first access to new pages takes longer than any other work on the array.
fn lengthen<T: Clone + Default + Send + Sync>(values: &mut Vec<T>, length: usize) {
    if length > values.capacity() {
        // The old values need not be copied.
        *values = Vec::new();
        values.par_extend(rayon::iter::repeat_n(T::default(), length));
    } else {
        values.resize(length, T::default());
    }
}

/// Working memory of one thread for two orders that are transformed together: an even order and the next odd order.
pub(crate) struct ThreadWorkspace {
    /// Scaled coefficients (L + 1 - m, columns) of an order, row-major.
    pub(crate) x: Vec<f64>,
    /// For the even order and then for the odd order: sums (rings, columns) over the degrees l with even `l - m`, and
    /// over those with odd `l - m`.
    pub(crate) sums: [[Vec<f64>; 2]; 2],
    pub(crate) work: Work,
}

impl ThreadWorkspace {
    pub(crate) fn new(columns: usize, rings: usize, max_degree: usize) -> Self {
        let zeros = || vec![0.0; rings * columns];
        Self {
            x: vec![0.0; (max_degree + 1) * columns],
            sums: [[zeros(), zeros()], [zeros(), zeros()]],
            work: Work::new(),
        }
    }
}
