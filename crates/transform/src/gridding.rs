//! Chooses the grid size and the kernel width: the cheapest pair that reaches the requested accuracy.
//!
//! The finer the grid, the narrower the kernel can be. The cost of the Fourier transforms grows with the square of the
//! grid size, and the cost of the interpolation with the square of the kernel width and with the number of directions.

use crate::TransformError;
use crate::kernel::{MAX_WIDTH, aliasing, magnification};

/// The finest accuracy for which a transform can be planned.
pub const FINEST: f64 = 1e-13;
/// The coarsest accuracy for which a transform can be planned.
pub const COARSEST: f64 = 1e-3;

/// The smallest number of grid points around the sphere. The grid must have several strips of rows, to be shared by
/// threads.
pub(crate) const MIN_GRID: usize = 64;
/// The largest oversampling, the ratio of grid points to the Nyquist number `2 L + 2`.
pub(crate) const MAX_OVERSAMPLING: f64 = 2.8;

/// Grid sizes and kernel width of a transform.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Gridding {
    /// Number of points of the oversampled grid around the sphere, M, along meridians and along parallels; a multiple
    /// of 8.
    pub(crate) grid: usize,
    /// Number of grid points under the kernel in each direction, w.
    pub(crate) width: usize,
    /// Kernel width for which the strips of the grid are laid out. It is the width of the plan that sorted the
    /// directions, and at least w.
    pub(crate) reach: usize,
    /// Number of rings from pole to pole on which Legendre functions are summed, N. A great circle has 2 N points.
    pub(crate) rings: usize,
}

impl Gridding {
    /// Chooses the cheapest gridding for `directions` directions that reaches the relative `accuracy`.
    pub(crate) fn choose(max_degree: usize, directions: usize, accuracy: f64) -> Result<Self, TransformError> {
        // The condition also rejects NaN.
        if !(FINEST..=COARSEST).contains(&accuracy) {
            return Err(TransformError::Accuracy { found: accuracy, min: FINEST, max: COARSEST });
        }
        let rings = smooth(max_degree + 1, 1);
        let bandwidth = 2 * max_degree + 2;
        let largest = (MAX_OVERSAMPLING * bandwidth as f64) as usize;
        let mut grids = Vec::new();
        let mut next = (bandwidth * 6 / 5).max(MIN_GRID);
        while grids.is_empty() || next <= largest {
            let grid = smooth(next, 8);
            grids.push(grid);
            next = grid + 8;
        }
        let best = (4..=MAX_WIDTH)
            .filter_map(|width| {
                // The error falls as the grid grows.
                let found = grids.partition_point(|&grid| error(width, max_degree, grid) > accuracy);
                grids.get(found).map(|&grid| Self { grid, width, reach: width, rings })
            })
            .min_by(|a, b| a.cost(max_degree, directions).total_cmp(&b.cost(max_degree, directions)));
        // Fallback if no kernel reaches the finest accuracy: the widest kernel on the largest grid.
        Ok(best.unwrap_or(Self { grid: grids[grids.len() - 1], width: MAX_WIDTH, reach: MAX_WIDTH, rings }))
    }

    /// Returns the gridding of the same grid for a lower degree. A narrower kernel may suffice, because the grid is
    /// finer relative to the degree.
    pub(crate) fn of_degree(&self, max_degree: usize, accuracy: f64) -> Self {
        let width = (4..self.width).find(|&width| error(width, max_degree, self.grid) <= accuracy);
        Self { width: width.unwrap_or(self.width), rings: smooth(max_degree + 1, 1), ..*self }
    }

    /// Estimates the time in nanoseconds that one thread takes per channel. The constants were measured.
    fn cost(&self, max_degree: usize, directions: usize) -> f64 {
        let (m, l) = (self.grid as f64, max_degree as f64 + 1.0);
        let fourier = m * m.log2() * (l / 2.0 + m / 4.0);
        let density = directions as f64 / (m * m / 2.0);
        0.9 * fourier + point_cost(self.width, 1, density) * directions as f64
    }
}

/// Estimates the time in nanoseconds that one thread takes to spread a direction's values to a grid in the cache, if
/// `density` directions per grid point are sorted together. The constants were measured.
pub(crate) fn point_cost(width: usize, channels: usize, density: f64) -> f64 {
    let lanes = width.next_multiple_of(4) as f64 / 8.0;
    // If the kernel's width is even, kernels of a cell's directions cover the same grid points; otherwise each kernel
    // covers one of four sets of grid points.
    let density = if width.is_multiple_of(2) { density } else { density / 4.0 };
    // Number of distinct sets of covered grid points per direction. The values of directions whose kernels cover the
    // same grid points are summed in registers and added to the grid once.
    let places = if density > 0.0 { -(-density).exp_m1() / density } else { 1.0 };
    let product = (0.36 + places).min(0.9);
    width as f64 * lanes * product * channels as f64 + 12.0 * lanes + 4.0
}

/// Returns the expected relative error of a transform with a kernel of this width on a grid: aliasing in both
/// directions plus magnified rounding errors.
pub(crate) fn error(width: usize, max_degree: usize, grid: usize) -> f64 {
    if (2 * max_degree + 1) as f64 > 0.9 * grid as f64 {
        return f64::INFINITY;
    }
    2.0 * aliasing(width, max_degree, grid) + 1e-16 * magnification(width, max_degree, grid)
}

/// Returns the smallest multiple of `step`, at least `at_least`, whose prime factors are 2, 3, 5, 7 and those of
/// `step`.
pub(crate) fn smooth(at_least: usize, step: usize) -> usize {
    let mut candidate = at_least.max(1).next_multiple_of(step);
    loop {
        let mut rest = candidate;
        for prime in [2, 3, 5, 7] {
            while rest.is_multiple_of(prime) {
                rest /= prime;
            }
        }
        if rest == 1 {
            return candidate;
        }
        candidate += step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accuracies_outside_are_refused() {
        for accuracy in [0.0, 1e-14, 0.01, f64::NAN] {
            assert!(Gridding::choose(10, 100, accuracy).is_err());
        }
    }

    #[test]
    fn every_degree_and_accuracy_has_a_gridding_that_reaches_it() {
        for max_degree in [0, 1, 2, 10, 63, 100, 1000, 2000] {
            for accuracy in [1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10, 1e-11, 1e-12, 1e-13] {
                let gridding = Gridding::choose(max_degree, 40_962, accuracy).unwrap();
                assert!(
                    error(gridding.width, max_degree, gridding.grid) <= accuracy,
                    "{max_degree} {accuracy:e} {gridding:?}"
                );
                assert!(gridding.grid.is_multiple_of(8) && 2 * gridding.rings > 2 * max_degree);
            }
        }
    }
}
