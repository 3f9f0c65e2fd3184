//! The plan of a transform: synthesis, adjoint synthesis and the normal operator at scattered directions.
//!
//! Channels are transformed in groups of [`TransformParams::channels`]. A call takes its working memory from the plan
//! and leaves it there for the next call.

use std::sync::{Arc, Mutex};

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use spharm_harmonics::Directions;
use spharm_harmonics::index::{basis_size, first_column};
use spharm_harmonics::rings::MonicRecurrence;

use crate::fourier::{Fourier, RingPair};
use crate::grid::Layout;
use crate::gridding::Gridding;
use crate::interpolation::{interpolate, interpolate_and_spread, spread};
use crate::kernel::Kernel;
use crate::legendre::Legendre;
use crate::points::Points;
use crate::workspace::{Sizes, ThreadWorkspace, Uses, Workspace};
use crate::{TransformError, TransformParams};

/// A plan for transforms between coefficients to one degree and samples at one list of directions.
///
/// It holds everything that depends on degree, accuracy and directions alone. Methods run on the rayon pool that they
/// are called in; results are the same bits on any number of threads. A plan can be used by several threads at once.
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
    /// `1 / (2 p_m)`.
    order_factor: Vec<f64>,
    /// Working memory of earlier calls, for later ones: a fresh page costs more than writing to it.
    spaces: Mutex<Vec<Workspace>>,
}

impl Transform {
    /// Plans transforms for `directions`, (n, 3). At degree 100 this takes about as long as one synthesis of three
    /// channels.
    ///
    /// # Errors
    ///
    /// - [`TransformError::Accuracy`]: the accuracy is out of range.
    /// - [`TransformError::TooManyDirections`]: there are more than 2^32 - 1 directions.
    /// - [`TransformError::Harmonics`]: the degree is above twice [`MAX_DEGREE`](spharm_harmonics::MAX_DEGREE). (Twice,
    ///   as the [moments of a Gram matrix](crate::gram) go to twice its degree.)
    pub fn new(directions: &Directions, params: &TransformParams) -> Result<Self, TransformError> {
        let gridding = Gridding::choose(params.max_degree, directions.len(), params.accuracy)?;
        Self::on(gridding, directions.as_slice(), params)
    }

    /// Plans transforms on a gridding of the caller's choice.
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

    /// Plans transforms to another degree for the same directions, which share their sorting and the grid: to a lower
    /// degree at least as accurate as this one. Where directions are many this costs next to nothing.
    ///
    /// # Errors
    ///
    /// [`TransformError::Degree`]: the degree is above this plan's.
    pub fn to_degree(&self, max_degree: usize, channels: usize) -> Result<Self, TransformError> {
        if max_degree > self.max_degree {
            return Err(TransformError::Degree { found: max_degree, max: self.max_degree });
        }
        let gridding = self.gridding.of_degree(max_degree, self.accuracy);
        let params = TransformParams { max_degree, accuracy: self.accuracy, channels };
        Ok(Self::over(self.points.clone(), gridding, &MonicRecurrence::new(max_degree)?, &params))
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
            spaces: Mutex::default(),
        }
    }

    /// Returns the bytes that a plan for n = `directions` directions and one call with `channels` channels take
    /// together.
    ///
    /// # Errors
    ///
    /// [`TransformError::Accuracy`]: the accuracy is out of range.
    pub fn bytes(params: &TransformParams, directions: usize, channels: usize) -> Result<usize, TransformError> {
        let gridding = Gridding::choose(params.max_degree, directions, params.accuracy)?;
        let group = channels.min(params.channels.max(1));
        let layout = Layout::new(gridding.grid, gridding.reach, group);
        let (degrees, core) = (params.max_degree + 1, layout.core_rows());
        let tables = 8 * degrees * (degrees + gridding.rings / 2 + 8);
        let circles = 16 * (degrees / 2 + 1) * group * gridding.grid;
        let spectra = 16 * core * group * degrees;
        let samples = 8 * directions * group + 16 * basis_size(params.max_degree) * group;
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

    /// Computes coefficients, (K, c), from a grid with its margins to which the values of c channels have been spread.
    pub(crate) fn coefficients_of_grid(&self, grid: Vec<f64>, channels: usize) -> Array2<f64> {
        let layout = self.layout(channels);
        let complex = Complex64::default();
        let mut space = Workspace {
            circles: vec![complex; self.fourier.order_pairs() * channels * self.gridding.grid],
            spectra: vec![complex; layout.core_rows() * channels * (self.max_degree + 1)],
            grids: [Vec::new(), grid],
            samples: Vec::new(),
            by_order: vec![0.0; (self.max_degree + 1) * (self.max_degree + 2) * channels],
        };
        let mut coefficients = Array2::zeros((basis_size(self.max_degree), channels));
        self.coefficients_of(layout, &mut space, coefficients.view_mut());
        coefficients
    }

    /// Synthesis, `A x`: returns the samples, (n, c), at the directions of the c functions with the canonical
    /// coefficients `coefficients`, (K, c).
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`]: `coefficients` doesn't have `K = (L + 1)^2` rows.
    pub fn synthesis(&self, coefficients: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
        self.expect("coefficients", basis_size(self.max_degree), coefficients.nrows())?;
        let mut samples = Array2::zeros((self.points.len(), coefficients.ncols()));
        self.grouped(coefficients.ncols(), Uses::SYNTHESIS, |space, columns| {
            let count = columns.len();
            let layout = self.grid_of(coefficients.slice(ndarray::s![.., columns.clone()]), space);
            interpolate(layout, &space.grids[0], &self.kernel, &self.points, &mut space.samples);
            let sorted = &space.samples;
            let mut samples = samples.slice_mut(ndarray::s![.., columns]);
            ndarray::Zip::indexed(samples.rows_mut()).par_for_each(|i, mut row| {
                let at = self.points.rank(i) * count;
                for (value, sorted) in row.iter_mut().zip(&sorted[at..at + count]) {
                    *value = *sorted;
                }
            });
        });
        Ok(samples)
    }

    /// Adjoint synthesis, `A^T r`: returns (K, c) for the samples `samples`, (n, c). This is the transpose of
    /// [`synthesis`](Self::synthesis) to rounding, whatever the accuracy; it is not its inverse.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`]: `samples` doesn't have n rows.
    pub fn adjoint_synthesis(&self, samples: ArrayView2<'_, f64>) -> Result<Array2<f64>, TransformError> {
        self.expect("samples", self.points.len(), samples.nrows())?;
        let mut coefficients = Array2::zeros((basis_size(self.max_degree), samples.ncols()));
        self.grouped(samples.ncols(), Uses::ADJOINT, |space, columns| {
            let count = columns.len();
            let samples = samples.slice(ndarray::s![.., columns.clone()]);
            space.samples.par_chunks_exact_mut(count).enumerate().for_each(|(place, sorted)| {
                for (sorted, value) in sorted.iter_mut().zip(samples.row(self.points.direction(place))) {
                    *sorted = *value;
                }
            });
            let layout = self.layout(count);
            space.grids[1].par_chunks_mut(1 << 14).for_each(|chunk| chunk.fill(0.0));
            spread(layout, &mut space.grids[1], &self.kernel, &self.points, &space.samples);
            self.coefficients_of(layout, space, coefficients.slice_mut(ndarray::s![.., columns]));
        });
        Ok(coefficients)
    }

    /// The normal operator, `A^T diag(w) A x`: returns (K, c) for the coefficients `coefficients`, (K, c). Without
    /// weights, w = 1.
    ///
    /// Faster than synthesis and adjoint synthesis one after the other: each direction's kernel is evaluated once.
    /// Weights come from [`sorted_weights`](Self::sorted_weights) of the same plan.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`]: `coefficients` doesn't have `K = (L + 1)^2` rows, or there aren't n weights.
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
        self.grouped(coefficients.ncols(), Uses::NORMAL, |space, columns| {
            let layout = self.grid_of(coefficients.slice(ndarray::s![.., columns.clone()]), space);
            let [from, to] = &mut space.grids;
            to.par_chunks_mut(1 << 14).for_each(|chunk| chunk.fill(0.0));
            interpolate_and_spread(layout, [from, to], &self.kernel, &self.points, weights.map(|w| &w.0[..]));
            self.coefficients_of(layout, space, result.slice_mut(ndarray::s![.., columns]));
        });
        Ok(result)
    }

    /// Sorts the weights of the directions, (n), into the order in which [`normal`](Self::normal) uses them.
    ///
    /// # Errors
    ///
    /// [`TransformError::Shape`]: there aren't n weights.
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

    /// Calls `work` for each group of channels with working memory of the right size: what it uses of it.
    fn grouped(&self, channels: usize, uses: Uses, mut work: impl FnMut(&mut Workspace, std::ops::Range<usize>)) {
        let mut space = self.spaces.lock().unwrap_or_else(std::sync::PoisonError::into_inner).pop().unwrap_or_default();
        let mut first = 0;
        while first < channels {
            let columns = first..(first + self.channels).min(channels);
            let count = columns.len();
            let sizes = Sizes {
                circles: self.fourier.order_pairs() * count * self.gridding.grid,
                spectra: self.layout(count).core_rows() * count * (self.max_degree + 1),
                grid: self.layout(count).len(),
                samples: self.points.len() * count,
                by_order: (self.max_degree + 1) * (self.max_degree + 2) * count,
            };
            space.resize(&sizes, uses);
            first = columns.end;
            work(&mut space, columns);
        }
        self.spaces.lock().unwrap_or_else(std::sync::PoisonError::into_inner).push(space);
    }

    /// Evaluates the coefficients on the first grid and fills its margins.
    fn grid_of(&self, coefficients: ArrayView2<'_, f64>, space: &mut Workspace) -> Layout {
        let channels = coefficients.ncols();
        let (columns, rings) = (2 * channels, self.legendre.rings());
        let layout = self.layout(channels);
        let coefficients = coefficients.as_standard_layout();
        let coefficients = coefficients.as_slice().unwrap_or_default();
        space.circles.par_chunks_mut(channels * self.gridding.grid).enumerate().with_max_len(1).for_each_init(
            || (ThreadWorkspace::new(columns, rings, self.max_degree), self.fourier.work()),
            |(scratch, fourier_work), (pair, circles)| {
                for parity in 0..2 {
                    let m = 2 * pair + parity;
                    let [even, odd] = &mut scratch.sums[parity];
                    if m > self.max_degree {
                        even.fill(0.0);
                        odd.fill(0.0);
                        continue;
                    }
                    let factor = self.order_factor[m] * if m == 0 { 1.0 } else { 0.5 };
                    let x = &mut scratch.x;
                    for ((x, scale), l) in x.chunks_exact_mut(columns).zip(self.legendre.scale(m)).zip(m..) {
                        let cosines = (first_column(l) + l + m) * channels;
                        let sines = (first_column(l) + l - m) * channels;
                        for channel in 0..channels {
                            x[2 * channel] = factor * scale * coefficients[cosines + channel];
                            x[2 * channel + 1] =
                                if m == 0 { 0.0 } else { factor * scale * coefficients[sines + channel] };
                        }
                    }
                    self.legendre.synthesis(m, x, columns, even, odd, &mut scratch.work);
                }
                let [[ee, eo], [oe, oo]] = &scratch.sums;
                for (channel, circle) in circles.chunks_exact_mut(self.gridding.grid).enumerate() {
                    let ring = |j: usize| {
                        let at = 2 * channel * rings + j;
                        let pair = |sums: &[f64]| Complex64::new(sums[at], sums[at + rings]);
                        RingPair { even_order: [pair(ee), pair(eo)], odd_order: [pair(oe), pair(oo)] }
                    };
                    self.fourier.rings_to_circle(ring, circle, fourier_work);
                }
            },
        );
        self.fourier.circles_to_grid(&space.circles, layout, &mut space.grids[0]);
        layout.extend(&mut space.grids[0]);
        layout
    }

    /// Computes coefficients from the second grid with its margins: the transpose of [`grid_of`](Self::grid_of).
    fn coefficients_of(&self, layout: Layout, space: &mut Workspace, mut out: ndarray::ArrayViewMut2<'_, f64>) {
        let channels = layout.channels;
        let (columns, rings) = (2 * channels, self.legendre.rings());
        layout.fold(&mut space.grids[1]);
        self.fourier.grid_to_circles(&mut space.grids[1], layout, &mut space.spectra, &mut space.circles);
        // Each pair of orders has its part of by_order.
        let mut rest = &mut space.by_order[..];
        let mut parts = Vec::with_capacity(self.fourier.order_pairs());
        for pair in 0..self.fourier.order_pairs() {
            let degrees = |m: usize| (self.max_degree + 1).saturating_sub(m);
            let (part, tail) = rest.split_at_mut((degrees(2 * pair) + degrees(2 * pair + 1)) * columns);
            parts.push(part);
            rest = tail;
        }
        parts
            .into_par_iter()
            .zip(space.circles.par_chunks_mut(channels * self.gridding.grid))
            .enumerate()
            .with_max_len(1)
            .for_each_init(
                || (ThreadWorkspace::new(columns, rings, self.max_degree), self.fourier.work()),
                |(scratch, fourier_work), (pair, (part, circles))| {
                    for (channel, circle) in circles.chunks_exact_mut(self.gridding.grid).enumerate() {
                        let [[ee, eo], [oe, oo]] = &mut scratch.sums;
                        let ring = |j: usize, pair: RingPair| {
                            let at = 2 * channel * rings + j;
                            for (sums, value) in [
                                (&mut *ee, pair.even_order[0]),
                                (eo, pair.even_order[1]),
                                (oe, pair.odd_order[0]),
                                (oo, pair.odd_order[1]),
                            ] {
                                (sums[at], sums[at + rings]) = (value.re, value.im);
                            }
                        };
                        self.fourier.circle_to_rings(circle, ring, fourier_work);
                    }
                    let degrees = self.max_degree + 1 - 2 * pair;
                    let (even_order, odd_order) = part.split_at_mut(degrees * columns);
                    for (parity, x) in [even_order, odd_order].into_iter().enumerate() {
                        let m = 2 * pair + parity;
                        if m > self.max_degree {
                            continue;
                        }
                        let [even, odd] = &mut scratch.sums[parity];
                        self.legendre.adjoint(m, even, odd, columns, x, &mut scratch.work);
                        for (x, scale) in x.chunks_exact_mut(columns).zip(self.legendre.scale(m)) {
                            for x in x {
                                *x *= self.order_factor[m] * scale;
                            }
                        }
                    }
                },
            );
        let by_order = &space.by_order;
        let start = |m: usize| m * (2 * self.max_degree + 3 - m) / 2;
        let gather = |column: usize, mut row: ndarray::ArrayViewMut1<'_, f64>| {
            let (l, order) = spharm_harmonics::index::degree_order(column);
            let m = order.unsigned_abs();
            let at = (start(m) + l - m) * columns + usize::from(order < 0);
            for (channel, value) in row.iter_mut().enumerate() {
                *value = by_order[at + 2 * channel];
            }
        };
        ndarray::Zip::indexed(out.rows_mut()).par_for_each(gather);
    }
}

/// Cosine and sine of the colatitude `(j + 1/2) pi / rings` of a northern ring. The angle is measured from the nearer
/// of pole and equator, since its rounding error is multiplied by the degree.
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
