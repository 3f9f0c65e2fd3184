//! Accumulates sums over weighted samples for a least-squares fit, chunk by chunk.
//!
//! For samples at directions `x_i` with weights `w_i` and values `f_i`, the sums consist of three parts: the moments
//! `s_{lm} = sum_i w_i S_{lm}(x_i)` to degree 2L, from which [`gram`](crate::gram) computes `A^T W A`; the right-hand
//! sides `A^T W f` to degree L; and a few scalars. Sums over parts of the data can be added, and take less memory than
//! the data.
//!
//! Adding a sample costs as much as spreading it to the oversampled grids of two [adjoint
//! syntheses](crate::Transform::adjoint_synthesis): the weight w to the grid of degree 2L, and the product w f to the
//! grid of degree L. The grids are converted to coefficients once, at the end. The second grid consists of every second
//! point of the first in either direction, so that samples are placed and sorted once for both grids. Samples are
//! gathered in *blocks* that fit in the cache, and each block is sorted by *strip*, a run of grid rows. Once enough
//! samples have been gathered, all samples of a strip are spread together.
//!
//! Memory: the grids take `4 M^2 + c M^2` bytes for c channels and a fine grid of M points around the sphere, with M
//! from 2.4 to 5.6 times 2L. Up to 8 million samples are held, with `32 + 8 c` bytes each. At the end, spectra take
//! about `16 L M` bytes. At L = 1,000 the total is about 1 GB. Results are bit-identical for any number of threads.

mod blocks;
mod griddings;
mod occupied;
mod strips;

use std::time::Instant;

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use spharm_harmonics::index::basis_size;

use crate::accumulator::blocks::{BLOCK, Block, Samples};
use crate::accumulator::griddings::Griddings;
pub use crate::accumulator::occupied::Occupied;
use crate::kernel::Kernel;
use crate::{FINEST, SampleSums, Transform, TransformError, TransformParams};

/// Accumulates the sums of weighted samples; see the [module](self).
///
/// ```
/// use ndarray::array;
/// use spharm_transform::Accumulator;
///
/// // Two samples of the constant 3, to degree 0.
/// let mut sums = Accumulator::new(0, 1)?;
/// sums.add(&[[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]], None, array![[3.0], [3.0]].view())?;
/// let found = sums.finish()?.sums;
/// let s = (1.0 / (4.0 * std::f64::consts::PI)).sqrt();
/// assert!((found.moments[0] - 2.0 * s).abs() < 1e-12 && (found.right_sides[[0, 0]] - 6.0 * s).abs() < 1e-12);
/// assert_eq!((found.count, found.weight, found.squares[0]), (2, 2.0, 18.0));
/// # Ok::<(), spharm_transform::TransformError>(())
/// ```
#[derive(Debug)]
pub struct Accumulator {
    max_degree: usize,
    channels: usize,
    griddings: Griddings,
    kernels: [Kernel; 2],
    /// The grid of the weights and the grid of the weighted values.
    grids: [Vec<f64>; 2],
    /// Blocks of samples. The first `full` of them haven't been spread to the grids yet; the remaining blocks can be
    /// refilled.
    blocks: Vec<Block>,
    full: usize,
    /// Number of samples in the full blocks; `most_held` is its limit.
    held: usize,
    most_held: usize,
    count: u64,
    rows: u64,
    weight: f64,
    squares: Vec<f64>,
    occupied: Occupied,
    seconds: SumsSeconds,
}

/// Wall time of accumulation in seconds, by kind of work.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct SumsSeconds {
    /// Time for placing samples on the grids and sorting them in blocks.
    pub place: f64,
    /// Time for spreading the samples to the grids.
    pub spread: f64,
}

/// Result of an [`Accumulator`].
#[derive(Debug, Clone, PartialEq)]
pub struct Accumulated {
    /// The accumulated sums.
    pub sums: SampleSums,
    /// Number of samples added, including those of weight 0.
    pub rows: u64,
    /// Cells of the sphere that contain samples of nonzero weight.
    pub occupied: Occupied,
}

impl Accumulator {
    /// Creates empty sums for fits of `channels` channels to degree L = `max_degree`. With 0 channels, only weights are
    /// summed.
    ///
    /// # Errors
    ///
    /// [`TransformError::Harmonics`] if the degree is above [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE).
    pub fn new(max_degree: usize, channels: usize) -> Result<Self, TransformError> {
        if max_degree > spharm_harmonics::MAX_DEGREE {
            let max = spharm_harmonics::MAX_DEGREE;
            return Err(spharm_harmonics::HarmonicsError::DegreeTooHigh { degree: max_degree, max }.into());
        }
        let griddings = Griddings::choose(max_degree, channels);
        let [fine, coarse] = griddings.layouts(channels);
        Ok(Self {
            max_degree,
            channels,
            kernels: griddings.kernels(max_degree),
            grids: [vec![0.0; fine.len()], vec![0.0; coarse.len()]],
            most_held: griddings.held(channels),
            griddings,
            blocks: Vec::new(),
            full: 0,
            held: 0,
            count: 0,
            rows: 0,
            weight: 0.0,
            squares: vec![0.0; channels],
            occupied: Occupied::new(max_degree),
            seconds: SumsSeconds::default(),
        })
    }

    /// Returns the peak memory of the accumulation in bytes, including its result.
    pub fn bytes(max_degree: usize, channels: usize) -> usize {
        let griddings = Griddings::choose(max_degree, channels);
        let [fine, coarse] = griddings.layouts(channels).map(|layout| 8 * layout.len());
        let held = griddings.held(channels) * (32 + 8 * channels);
        let spectra = griddings.spectra_bytes(max_degree, channels);
        fine + coarse + held.max(spectra)
    }

    /// Returns the highest degree of fits, L.
    pub fn max_degree(&self) -> usize {
        self.max_degree
    }

    /// Adds samples at the unit vectors `directions` (n, 3) with `weights` (n) and `values` (n, c). If no weights are
    /// given, w = 1. The values must be finite, and the weights finite and at least 0.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if an array doesn't have n rows, or the number of channels isn't c.
    pub fn add(
        &mut self,
        directions: &[[f64; 3]],
        weights: Option<&[f64]>,
        values: ArrayView2<'_, f64>,
    ) -> Result<(), TransformError> {
        let n = directions.len();
        for (what, expected, found) in [
            ("values", n, values.nrows()),
            ("weights", n, weights.map_or(n, <[f64]>::len)),
            ("channels of the values", self.channels, values.ncols()),
        ] {
            if expected != found {
                return Err(TransformError::Shape { what, expected, found });
            }
        }
        let values = values.as_standard_layout();
        let values = values.as_slice().unwrap_or_default();
        let starts: Vec<usize> = (0..n).step_by(BLOCK).collect();
        // Each round takes as many blocks as can still be held in memory before the held samples must be spread.
        let mut at = 0;
        while at < starts.len() {
            let most = (self.most_held - self.held).div_ceil(BLOCK);
            let some = &starts[at..starts.len().min(at + most)];
            let (griddings, channels) = (&self.griddings, self.channels);
            let started = Instant::now();
            let end = self.full + some.len();
            self.blocks.resize_with(self.blocks.len().max(end), || Block::new(channels));
            let blocks = &mut self.blocks[self.full..end];
            blocks.par_iter_mut().zip(some).for_each_init(Vec::new, |places, (block, &start)| {
                let rows = start..n.min(start + BLOCK);
                let weights = weights.map(|weights| &weights[rows.clone()]);
                let values = &values[rows.start * channels..rows.end * channels];
                let samples = Samples { directions: &directions[rows], weights, values };
                block.fill(samples, griddings, places);
            });
            self.full = end;
            for block in blocks {
                self.rows += block.rows as u64;
                self.held += block.len();
                self.count += block.len() as u64;
                self.weight += block.weight;
                for (sum, square) in self.squares.iter_mut().zip(&block.squares) {
                    *sum += square;
                }
            }
            self.seconds.place += started.elapsed().as_secs_f64();
            at += some.len();
            if self.held >= self.most_held {
                self.spread();
            }
        }
        Ok(())
    }

    /// Returns the time spent accumulating so far.
    pub fn seconds(&self) -> SumsSeconds {
        self.seconds
    }

    /// Spreads all held samples to the grids. [`add`](Self::add) calls this function when there are enough samples, and
    /// [`finish`](Self::finish) calls it at the end.
    pub fn spread(&mut self) {
        let started = Instant::now();
        let blocks = &self.blocks[..self.full];
        strips::spread(&self.griddings, self.channels, &self.kernels, &mut self.grids, blocks, &self.occupied);
        (self.full, self.held) = (0, 0);
        self.seconds.spread += started.elapsed().as_secs_f64();
    }

    /// Spreads the remaining samples and returns the sums.
    ///
    /// # Errors
    ///
    /// Errors of planning the transforms, which can't occur once [`new`](Self::new) has accepted the degree.
    pub fn finish(mut self) -> Result<Accumulated, TransformError> {
        self.spread();
        self.blocks = Vec::new();
        let [fine, coarse] = std::mem::take(&mut self.grids);
        let degrees = [2 * self.max_degree, self.max_degree];
        let channels = [1, self.channels];
        // The transforms run one after the other, so that the memory of the first is freed before the second
        // allocates its own.
        let mut found = Vec::with_capacity(2);
        for (which, grid) in [fine, coarse].into_iter().enumerate() {
            if channels[which] == 0 {
                found.push(Array2::zeros((basis_size(degrees[which]), 0)));
                continue;
            }
            let params = TransformParams { max_degree: degrees[which], accuracy: FINEST, channels: channels[which] };
            let transform = Transform::on(self.griddings.both[which], &[], &params)?;
            found.push(transform.coefficients_of_grid(grid, channels[which]));
        }
        let right_sides = found.pop().unwrap_or_default();
        let moments = found.pop().map(|moments| moments.into_raw_vec_and_offset().0).unwrap_or_default();
        let Self { max_degree, rows, count, weight, squares, occupied, .. } = self;
        let sums = SampleSums { max_degree, moments, right_sides, squares, weight, count };
        Ok(Accumulated { sums, rows, occupied })
    }
}

#[cfg(test)]
mod tests {
    use spharm_harmonics::Directions;

    use super::*;

    fn samples(n: usize, channels: usize) -> (Directions, Vec<f64>, Array2<f64>) {
        // The samples aren't evenly spread, and include both poles and the seam.
        let mut vertices = Directions::fibonacci(n - 3).unwrap().as_slice().to_vec();
        for v in &mut vertices {
            v[0] += 0.3;
        }
        vertices.extend([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, -1e-12, 0.2]]);
        let weights = (0..n).map(|i| if i % 11 == 0 { 0.0 } else { 1.0 + (i as f64).sin() }).collect();
        let values = Array2::from_shape_fn((n, channels), |(i, c)| ((i * (c + 3)) as f64).cos());
        (Directions::from_vertices(&vertices).unwrap(), weights, values)
    }

    fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
        values.into_iter().fold(0.0, |a: f64, b| a.max(b.abs()))
    }

    #[test]
    fn sums_are_the_adjoint_syntheses() {
        for (max_degree, n, channels) in
            [(0, 10, 1), (1, 100, 2), (7, 3_000, 3), (40, 70_000, 5), (150, 20_000, 1), (9, 500, 0)]
        {
            let (directions, weights, values) = samples(n, channels);
            let mut sums = Accumulator::new(max_degree, channels).unwrap();
            let (first, second) = (n / 3, n - n / 3);
            let (a, b) = values.view().split_at(ndarray::Axis(0), first);
            sums.add(&directions.as_slice()[..first], Some(&weights[..first]), a).unwrap();
            sums.add(&directions.as_slice()[first..], Some(&weights[first..]), b).unwrap();
            let found = sums.finish().unwrap();
            assert_eq!(second + first, found.rows as usize);
            let found = found.sums;
            assert_eq!(found.count as usize, weights.iter().filter(|w| **w > 0.0).count());
            let exact = |max_degree: usize, f: &Array2<f64>| {
                let params = TransformParams { max_degree, accuracy: FINEST, channels: 3 };
                Transform::new(&directions, &params).unwrap().adjoint_synthesis(f.view()).unwrap()
            };
            let w = Array2::from_shape_fn((n, 1), |(i, _)| weights[i]);
            let moments = exact(2 * max_degree, &w);
            let scale = largest(moments.iter().copied());
            let off = largest(moments.iter().zip(&found.moments).map(|(a, b)| a - b));
            assert!(off < 2e-13 * scale, "degree {max_degree}: moments off by {:.1e}", off / scale);
            let right = exact(max_degree, &(&values * &w));
            let off = largest((&right - &found.right_sides).iter().copied());
            assert!(off < 2e-13 * scale, "degree {max_degree}: right-hand sides off by {:.1e}", off / scale);
            if channels == 0 {
                assert!(found.squares.is_empty());
                continue;
            }
            let square: f64 = (0..n).map(|i| weights[i] * values[[i, 0]].powi(2)).sum();
            assert!((found.squares[0] / square - 1.0).abs() < 1e-13);
        }
    }

    #[test]
    fn bits_depend_on_neither_threads_nor_sizes_of_whole_blocks() {
        let (directions, weights, values) = samples(5 * BLOCK, 2);
        let on = |threads: usize, step: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let mut sums = Accumulator::new(20, 2).unwrap();
                for at in (0..weights.len()).step_by(step) {
                    let rows = at..weights.len().min(at + step);
                    let values = values.slice(ndarray::s![rows.clone(), ..]);
                    sums.add(&directions.as_slice()[rows.clone()], Some(&weights[rows]), values).unwrap();
                }
                sums.finish().unwrap()
            })
        };
        let one = on(1, 5 * BLOCK);
        assert_eq!(one, on(2, 2 * BLOCK));
        assert_eq!(one, on(3, BLOCK));
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        let mut sums = Accumulator::new(2, 1).unwrap();
        assert!(sums.add(&[[0.0, 0.0, 1.0]], None, Array2::zeros((2, 1)).view()).is_err());
        assert!(sums.add(&[[0.0, 0.0, 1.0]], None, Array2::zeros((1, 2)).view()).is_err());
        assert!(sums.add(&[[0.0, 0.0, 1.0]], Some(&[]), Array2::zeros((1, 1)).view()).is_err());
        assert!(Accumulator::new(spharm_harmonics::MAX_DEGREE + 1, 1).is_err());
    }
}
