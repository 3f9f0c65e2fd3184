//! Defines pairs of grids, for degrees 2L and L, with kernels of equal width. The second grid consists of every second
//! point of the first.

use crate::FINEST;
use crate::grid::Layout;
use crate::gridding::{Gridding, MAX_OVERSAMPLING, MIN_GRID, error, point_cost, smooth};
use crate::kernel::{Kernel, MAX_WIDTH};

/// Held samples are spread when their number reaches the number of grid points divided by this value. Spreading passes
/// over all points of the grids, so it pays off only for many samples.
const POINTS_A_SAMPLE: usize = 8;
/// Minimum number of samples that are held in memory before they are spread to the grids.
const FEWEST_HELD: usize = 1 << 16;
/// Maximum number of samples that are held in memory before they are spread to the grids.
const MOST_HELD: usize = 1 << 23;

/// The griddings of the weights (degree 2L) and of the weighted values (degree L).
#[derive(Debug, Clone, Copy)]
pub(super) struct Griddings {
    pub(super) both: [Gridding; 2],
}

impl Griddings {
    /// Chooses the pair of griddings with the least time per sample at the finest accuracy.
    pub(super) fn choose(max_degree: usize, channels: usize) -> Self {
        let degrees = [2 * max_degree, max_degree];
        let rings = degrees.map(|degree| smooth(degree + 1, 1));
        let of = |width: usize, grid: usize| {
            let one = |grid: usize, rings: usize| Gridding { grid, width, reach: width, rings };
            Self { both: [one(grid, rings[0]), one(grid / 2, rings[1])] }
        };
        let bandwidth = 4 * max_degree + 2;
        let largest = (2 * MIN_GRID).max((MAX_OVERSAMPLING * bandwidth as f64) as usize);
        let mut best: Option<(f64, Self)> = None;
        let mut next = (bandwidth * 6 / 5).max(2 * MIN_GRID);
        let mut last = of(MAX_WIDTH, smooth(next, 16));
        while next <= largest {
            let grid = smooth(next, 16);
            next = grid + 16;
            last = of(MAX_WIDTH, grid);
            let accurate = |width: usize| {
                let of_degree = |i: usize| error(width, degrees[i], grid / (i + 1));
                of_degree(0).max(of_degree(1)) <= FINEST
            };
            let Some(width) = (4..=MAX_WIDTH).find(|&width| accurate(width)) else { continue };
            let cost = cost(width, grid, channels);
            if best.as_ref().is_none_or(|(least, _)| cost < *least) {
                best = Some((cost, of(width, grid)));
            }
        }
        // If no kernel reaches the finest accuracy, use the widest kernel on the largest grid.
        best.map_or(last, |(_, best)| best)
    }

    /// Returns the layouts of the fine grid, with one channel, and of the coarse grid, with `channels` channels.
    pub(super) fn layouts(&self, channels: usize) -> [Layout; 2] {
        let [fine, coarse] = self.both;
        [Layout::new(fine.grid, fine.width, 1), Layout::new(coarse.grid, coarse.width, channels)]
    }

    /// Returns the kernels of both grids.
    pub(super) fn kernels(&self, max_degree: usize) -> [Kernel; 2] {
        let [fine, coarse] = self.both;
        let kernel = |gridding: Gridding, degree| Kernel::new(gridding.width, degree, gridding.grid, FINEST);
        [kernel(fine, 2 * max_degree), kernel(coarse, max_degree)]
    }

    /// Returns the number of samples that are held in memory before they are spread to the grids.
    pub(super) fn held(&self, channels: usize) -> usize {
        held(self.both[0].grid, channels)
    }

    /// Returns the number of rows of the fine grid to which one task spreads samples: two strips. They correspond to
    /// one strip of the coarse grid.
    pub(super) fn rows_together(&self) -> usize {
        2 * Layout::new(self.both[0].grid, self.both[0].width, 1).strip
    }

    /// Returns the number of strips, one for each task.
    pub(super) fn strips(&self) -> usize {
        (self.both[0].grid / 2 + 1).div_ceil(self.rows_together())
    }

    /// Returns the size in bytes of the tables and spectra that are needed to compute coefficients from a grid: the
    /// larger of the sizes for the two grids.
    pub(super) fn spectra_bytes(&self, max_degree: usize, channels: usize) -> usize {
        let of = |gridding: Gridding, degree: usize, channels: usize| {
            let orders = degree + 1;
            let tables = 8 * orders * (orders + gridding.rings / 2 + 8);
            let circles = 16 * (orders / 2 + 1) * channels * gridding.grid;
            let spectra = 16 * (gridding.grid / 2 + 1) * channels * orders;
            tables + circles + spectra + 16 * orders * orders * channels
        };
        of(self.both[0], 2 * max_degree, 1).max(of(self.both[1], max_degree, channels))
    }
}

/// Returns the number of points of the fine grid, which has one channel, plus the number of points of the coarse grid
/// in all channels. The fine grid has `grid` points around the sphere.
fn points(grid: usize, channels: usize) -> usize {
    grid * grid / 2 + channels * grid * grid / 8
}

/// Returns the number of samples that are held in memory before they are spread to the grids.
fn held(grid: usize, channels: usize) -> usize {
    (points(grid, channels) / POINTS_A_SAMPLE).clamp(FEWEST_HELD, MOST_HELD)
}

/// Estimates a thread's time per sample in nanoseconds: the time for the sample's products, plus the sample's share of
/// the time for reading and writing the grids.
fn cost(width: usize, grid: usize, channels: usize) -> f64 {
    /// Memory bandwidth of a thread, in bytes per nanosecond, while another thread is running.
    const BYTES_PER_NANOSECOND: f64 = 6.0;
    // The memory traffic of the grids is divided by the same number of samples for every grid, although the number of
    // held samples depends on the grid. Otherwise a finer grid could offset its traffic by holding more samples, and
    // both would take more memory.
    let traffic = 16.0 * points(grid, channels) as f64 / (MOST_HELD / 2) as f64;
    let density = held(grid, channels) as f64 / (grid * grid / 2) as f64;
    point_cost(width, 1, density) + point_cost(width, channels, 4.0 * density) + traffic / BYTES_PER_NANOSECOND
}
