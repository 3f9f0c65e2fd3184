//! The plan of a transform: synthesis, adjoint synthesis and the normal operator at scattered directions.
//!
//! Channels are transformed in groups of [`TransformParams::channels`]. A call takes its working memory from the plan
//! and returns it to the plan for the next call.

mod steps;

use std::ops::Range;
use std::sync::Arc;

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use spharm_harmonics::Directions;
use spharm_harmonics::index::basis_size;
use spharm_harmonics::rings::MonicRecurrence;

use crate::fourier::Fourier;
use crate::grid::Layout;
use crate::gridding::Gridding;
use crate::interpolation::{interpolate, interpolate_and_spread, spread};
use crate::kernel::Kernel;
use crate::legendre::{Legendre, SomeColumns};
use crate::points::Points;
use crate::pool::Pool;
use crate::sorting::{Columns, sort, unsort};
use crate::workspace::{Sizes, Uses, Workspace};
use crate::{TransformError, TransformParams};

/// Number of samples that one task sorts.
const RUN: usize = 1 << 12;
/// Several groups of channels are sorted together if their samples take at most this number of bytes. This saves time
/// if rows have many channels, because sorting a single group would read as many cache lines as sorting all groups.
const SORTED: usize = 16 << 20;

/// A plan for transforms between coefficients to one degree and samples at one list of directions.
///
/// It holds everything that depends only on degree, accuracy and directions. Methods run on the rayon pool from which
/// they are called; results are bit-identical for any number of threads. Several threads can use a plan at once.
#[derive(Debug)]
pub struct Transform {
    max_degree: usize,
    accuracy: f64,
    channels: usize,
    gridding: Gridding,
    kernel: Kernel,
    legendre: Legendre,
    fourier: Fourier,
    points: Arc<Points>,
    /// Factor `1 / (2 p_m)` for each order m, with the kernel's Fourier transform p_m at frequency m.
    order_factor: Vec<f64>,
    /// Working memory of earlier calls, reused by later calls of this plan and of plans that share its sorted
    /// directions.
    spaces: Arc<Pool<Workspace>>,
}

impl Transform {
    /// Plans transforms for `directions` (n, 3). At degree 100 this takes about as long as one synthesis of three
    /// channels.
    ///
    /// # Errors
    ///
    /// - [`TransformError::Accuracy`] if the accuracy is out of range.
    /// - [`TransformError::TooManyDirections`] if there are more than 2^32 - 1 directions.
    /// - [`TransformError::Harmonics`] if the degree is above twice [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE). The
    ///   limit is twice `MAX_DEGREE`, because the [moments of a Gram matrix](crate::gram) go to twice the matrix's
    ///   degree.
    pub fn new(directions: &Directions, params: &TransformParams) -> Result<Self, TransformError> {
        let gridding = Gridding::choose(params.max_degree, directions.len(), params.accuracy)?;
        Self::on(gridding, directions.as_slice(), params)
    }

    /// Plans transforms on a gridding chosen by the caller.
    pub(crate) fn on(
        gridding: Gridding,
        directions: &[[f64; 3]],
        params: &TransformParams,
    ) -> Result<Self, TransformError> {
        let recurrence = MonicRecurrence::new(params.max_degree)?;
        let strip = Layout::new(gridding.grid, gridding.reach, 1).strip;
        let points = Arc::new(Points::new(directions, gridding.grid, strip)?);
        Ok(Self::over(points, gridding, &recurrence, params))
    }

    /// Plans transforms for the same directions to a degree that is at most this plan's degree. Both plans share the
    /// sorted directions and the grid, so the new plan is at least as accurate as this plan. If there are many
    /// directions, the cost is negligible compared with that of a plan made by [`new`](Self::new).
    ///
    /// # Errors
    ///
    /// [`TransformError::Degree`] if the degree is above this plan's.
    pub fn to_degree(&self, max_degree: usize, channels: usize) -> Result<Self, TransformError> {
        if max_degree > self.max_degree {
            return Err(TransformError::Degree { found: max_degree, max: self.max_degree });
        }
        let gridding = self.gridding.of_degree(max_degree, self.accuracy);
        let params = TransformParams { max_degree, accuracy: self.accuracy, channels };
        let plan = Self::over(self.points.clone(), gridding, &MonicRecurrence::new(max_degree)?, &params);
        Ok(Self { spaces: self.spaces.clone(), ..plan })
    }

    fn over(points: Arc<Points>, gridding: Gridding, recurrence: &MonicRecurrence, params: &TransformParams) -> Self {
        let max_degree = params.max_degree;
        let kernel = Kernel::new(gridding.width, max_degree, gridding.grid, params.accuracy);
        let angles: Vec<[f64; 2]> = (0..gridding.rings.div_ceil(2)).map(|j| ring_angle(j, gridding.rings)).collect();
        let legendre = Legendre::new(recurrence, &angles, params.accuracy * 1e-4);
        Self {
            max_degree,
            accuracy: params.accuracy,
            channels: params.channels.max(1),
            fourier: Fourier::new(max_degree, gridding, &kernel),
            order_factor: (0..=max_degree).map(|m| 0.5 / kernel.transform(m, gridding.grid)).collect(),
            gridding,
            kernel,
            legendre,
            points,
            spaces: Arc::default(),
        }
    }

    /// Returns the total memory in bytes of a plan for n = `directions` directions and of one call with `channels`
    /// channels.
    ///
    /// # Errors
    ///
    /// [`TransformError::Accuracy`] if the accuracy is out of range.
    pub fn bytes(params: &TransformParams, directions: usize, channels: usize) -> Result<usize, TransformError> {
        let gridding = Gridding::choose(params.max_degree, directions, params.accuracy)?;
        let group = channels.min(params.channels.max(1));
        let layout = Layout::new(gridding.grid, gridding.reach, group);
        let (degrees, core) = (params.max_degree + 1, layout.core_rows());
        let tables = degrees * (18 * degrees + 8 * (gridding.rings / 2 + 8) + 100);
        let circles = 16 * (degrees / 2 + 1) * group * gridding.grid;
        let spectra = 16 * core * group * degrees;
        let sorted = (8 * directions * channels).min(SORTED).max(8 * directions * group);
        let samples = sorted + 16 * basis_size(params.max_degree) * group;
        Ok(2 * Points::bytes(directions) + tables + circles + spectra + 16 * layout.len() + samples)
    }

    /// Returns the highest degree, L.
    pub fn max_degree(&self) -> usize {
        self.max_degree
    }

    /// Returns the number of directions, n.
    pub fn directions(&self) -> usize {
        self.points.len()
    }

    /// Computes the synthesis `A x`: evaluates the c functions with the canonical `coefficients` (K, c) at the
    /// directions, and returns the samples (n, c).
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if `coefficients` doesn't have `K = (L + 1)^2` rows.
    pub fn synthesis(&self, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
        self.expect("coefficients", basis_size(self.max_degree), coefficients.nrows())?;
        let all = coefficients.ncols();
        let coefficients = coefficients.as_standard_layout();
        let coefficients = coefficients.as_slice().unwrap_or_default();
        let mut samples = Array2::zeros((self.points.len(), all));
        self.grouped(all, self.sorted_together(), Uses::SYNTHESIS, |space, block| {
            let (count, length) = self.group(&block);
            for (columns, place) in self.groups(&block).zip(0..) {
                let from = SomeColumns { values: coefficients, all, first: columns.start };
                let layout = self.grid_of(from, columns.len(), space);
                let sorted = &mut space.samples[place * length..(place + 1) * length];
                interpolate(layout, &space.grids[0], &self.kernel, &self.points, sorted);
            }
            let columns = Columns { first: block.start, count };
            let runs = samples.as_slice_mut().unwrap_or_default().par_chunks_mut(RUN * all);
            runs.zip(self.points.ranks().par_chunks(RUN)).for_each(|(samples, ranks)| {
                unsort(ranks, columns, &space.samples, length, samples, all);
            });
        });
        Ok(samples)
    }

    /// Computes the adjoint synthesis `A^T r` (K, c) of `samples` (n, c). At any accuracy, the adjoint synthesis is the
    /// transpose of [`synthesis`](Self::synthesis) up to rounding errors, but not the inverse.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if `samples` doesn't have n rows.
    pub fn adjoint_synthesis(&self, samples: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
        self.expect("samples", self.points.len(), samples.nrows())?;
        let channels = samples.ncols();
        let samples = samples.as_standard_layout();
        let samples = samples.as_slice().unwrap_or_default();
        Ok(self.adjoint_of(channels, &|direction, column, out| {
            out.copy_from_slice(&samples[direction * channels + column..][..out.len()]);
        }))
    }

    /// Computes the sums `A^T diag(w) [1 f]` (K, 1 + c) over samples f (n, c) with weights w (n). The first column
    /// contains the sums of the weights alone. If no weights are given, w = 1.
    ///
    /// This is faster than two adjoint syntheses, because each direction's kernel is evaluated once.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if the number of samples or of weights isn't n.
    pub fn weighted_sums(
        &self,
        samples: ArrayView2<'_, f64>,
        weights: Option<&[f64]>,
    ) -> Result<Array2<f64>, TransformError> {
        self.expect("samples", self.points.len(), samples.nrows())?;
        if let Some(weights) = weights {
            self.expect("weights", self.points.len(), weights.len())?;
        }
        let channels = samples.ncols();
        let samples = samples.as_standard_layout();
        let samples = samples.as_slice().unwrap_or_default();
        Ok(self.adjoint_of(1 + channels, &|direction, column, out| {
            let weight = weights.map_or(1.0, |weights| weights[direction]);
            let row = &samples[direction * channels..][..channels];
            for (out, column) in out.iter_mut().zip(column..) {
                *out = if column == 0 { weight } else { weight * row[column - 1] };
            }
        }))
    }

    /// Computes the adjoint synthesis of samples supplied by `fill`, which writes the values of a direction starting
    /// from a given column.
    fn adjoint_of(&self, channels: usize, fill: &(impl Fn(usize, usize, &mut [f64]) + Sync)) -> Array2<f64> {
        let mut coefficients = Array2::zeros((basis_size(self.max_degree), channels));
        self.grouped(channels, self.sorted_together(), Uses::ADJOINT, |space, block| {
            let (count, length) = self.group(&block);
            // Each task sorts one run of samples, for all groups of channels. Collect, for each run, its parts of the
            // groups' memory.
            let mut runs: Vec<Vec<&mut [f64]>> = self.points.order().chunks(RUN).map(|_| Vec::new()).collect();
            for sorted in space.samples.chunks_exact_mut(length.max(1)) {
                runs.iter_mut().zip(sorted.chunks_mut(RUN * count)).for_each(|(run, sorted)| run.push(sorted));
            }
            let columns = Columns { first: block.start, count };
            runs.into_par_iter().zip(self.points.order().par_chunks(RUN)).for_each(|(mut run, order)| {
                sort(order, columns, &mut run, fill);
            });
            let layout = self.layout(count);
            for (columns, place) in self.groups(&block).zip(0..) {
                space.grids[1].par_chunks_mut(1 << 14).for_each(|chunk| chunk.fill(0.0));
                let sorted = &space.samples[place * length..(place + 1) * length];
                spread(layout, &mut space.grids[1], &self.kernel, &self.points, sorted);
                self.coefficients_of(layout, space, coefficients.slice_mut(ndarray::s![.., columns]));
            }
        });
        coefficients
    }

    /// Computes the adjoint synthesis of samples that `spread` adds to a grid. For a range of columns, `spread` writes
    /// the whole grid, in the given layout and including its margins, regardless of the grid's previous contents.
    pub(crate) fn adjoint_of_grid(
        &self,
        channels: usize,
        spread: impl Fn(Layout, Range<usize>, &mut [f64]),
    ) -> Array2<f64> {
        let mut coefficients = Array2::zeros((basis_size(self.max_degree), channels));
        self.grouped(channels, 1, Uses::ADJOINT, |space, columns| {
            let layout = self.layout(columns.len());
            spread(layout, columns.clone(), &mut space.grids[1][..layout.len()]);
            self.coefficients_of(layout, space, coefficients.slice_mut(ndarray::s![.., columns]));
        });
        coefficients
    }

    /// Applies the normal operator to `coefficients` (K, c), and returns `A^T diag(w) A x` (K, c). If no weights are
    /// given, w = 1.
    ///
    /// This is faster than synthesis followed by adjoint synthesis, because each direction's kernel is evaluated once.
    /// Weights come from [`sorted_weights`](Self::sorted_weights) of the same plan.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if `coefficients` doesn't have `K = (L + 1)^2` rows, or the number of weights isn't n.
    pub fn normal(
        &self,
        coefficients: ArrayView2<'_, f64>,
        weights: Option<&SortedWeights>,
    ) -> Result<Array2<f64>, TransformError> {
        self.expect("coefficients", basis_size(self.max_degree), coefficients.nrows())?;
        if let Some(SortedWeights(weights)) = weights {
            self.expect("weights", self.points.len(), weights.len())?;
        }
        let mut result = Array2::zeros(coefficients.dim());
        let all = coefficients.ncols();
        let coefficients = coefficients.as_standard_layout();
        let coefficients = coefficients.as_slice().unwrap_or_default();
        self.grouped(all, 1, Uses::NORMAL, |space, columns| {
            let from = SomeColumns { values: coefficients, all, first: columns.start };
            let layout = self.grid_of(from, columns.len(), space);
            let [from, to] = &mut space.grids;
            to.par_chunks_mut(1 << 14).for_each(|chunk| chunk.fill(0.0));
            interpolate_and_spread(layout, [from, to], &self.kernel, &self.points, weights.map(|w| &w.0[..]));
            self.coefficients_of(layout, space, result.slice_mut(ndarray::s![.., columns]));
        });
        Ok(result)
    }

    /// Sorts the weights (n) of the directions into the order in which [`normal`](Self::normal) uses them.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`] if the number of weights isn't n.
    pub fn sorted_weights(&self, weights: &[f64]) -> Result<SortedWeights, TransformError> {
        self.expect("weights", self.points.len(), weights.len())?;
        Ok(SortedWeights((0..weights.len()).map(|place| weights[self.points.direction(place)]).collect()))
    }

    fn expect(&self, what: &'static str, expected: usize, found: usize) -> Result<(), TransformError> {
        if expected == found { Ok(()) } else { Err(TransformError::Shape { what, expected, found }) }
    }

    fn layout(&self, channels: usize) -> Layout {
        Layout::new(self.gridding.grid, self.gridding.reach, channels)
    }

    /// Returns the number of groups of channels that are sorted together: the groups whose samples fit in [`SORTED`]
    /// bytes.
    fn sorted_together(&self) -> usize {
        SORTED / (8 * self.points.len() * self.channels).max(1)
    }

    /// Divides a block of channels into groups. Returns the number of channels in each group, and the number of samples
    /// of all channels of a group.
    fn group(&self, block: &Range<usize>) -> (usize, usize) {
        let count = block.len().min(self.channels);
        (count, count * self.points.len())
    }

    /// Returns the groups of a block of channels.
    fn groups(&self, block: &Range<usize>) -> impl Iterator<Item = Range<usize>> + use<> {
        let count = block.len().min(self.channels);
        block.clone().step_by(count.max(1)).map(move |first| first..first + count)
    }

    /// Calls `work` for blocks of channels. A group has `self.channels` channels. Each block consists of up to
    /// `together` complete groups, except for a last block of the remaining channels. The working memory has the parts
    /// that `uses` selects: samples for all groups of the block, and everything else for one group.
    fn grouped(
        &self,
        channels: usize,
        together: usize,
        uses: Uses,
        mut work: impl FnMut(&mut Workspace, Range<usize>),
    ) {
        self.spaces.with(Workspace::default, |space| {
            let mut first = 0;
            while first < channels {
                let whole = ((channels - first) / self.channels).min(together.max(1));
                let block = first..if whole > 0 { first + whole * self.channels } else { channels };
                let (count, samples) = self.group(&block);
                let sizes = Sizes {
                    circles: self.fourier.order_pairs() * count * self.gridding.grid,
                    spectra: self.layout(count).core_rows() * count * (self.max_degree + 1),
                    grid: self.layout(count).len(),
                    samples: samples * whole.max(1),
                    by_order: (self.max_degree + 1) * (self.max_degree + 2) * count,
                };
                space.resize(&sizes, uses);
                first = block.end;
                work(space, block);
            }
        });
    }
}

/// Returns cosine and sine of the colatitude `(j + 1/2) pi / rings` of a northern ring. The angle is measured from the
/// pole or the equator, whichever is nearer, because the angle's rounding error is multiplied by the degree.
fn ring_angle(j: usize, rings: usize) -> [f64; 2] {
    let angle = |numerator: usize| numerator as f64 * std::f64::consts::PI / (2 * rings) as f64;
    if 4 * j + 2 < rings {
        let (sine, cosine) = angle(2 * j + 1).sin_cos();
        [cosine, sine]
    } else {
        let (cosine, sine) = angle(rings - 2 * j - 1).sin_cos();
        [cosine, sine]
    }
}

/// Weights of directions, in the order of the [`Transform`] that sorted them.
#[derive(Debug, Clone)]
pub struct SortedWeights(Vec<f64>);
