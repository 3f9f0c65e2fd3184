//! Defines the Gauss-Legendre grid of a [`MomentOperator`](super::MomentOperator) or an
//! [`InverseDensity`](super::InverseDensity). These operators transform coefficients to values on the grid's rings,
//! multiply the values at the grid's points by a function, and transform the products back to coefficients.
//!
//! Rings come in pairs, a northern ring and its mirror image. [`Legendre`] computes the sums over even and over odd
//! `l - m`. The values on the northern ring are the sum of these two sums, and the values on the southern ring are
//! their difference. The values on both rings are real, so one complex Fourier transform serves a pair: the northern
//! ring is the real part, and the southern ring is the imaginary part.
//!
//! On a ring next to a pole, orders above some `m(theta)` are negligible. A product of three functions of orders up to
//! a, b and a needs `2 a + b + 1` points to be integrated exactly, so rings next to the poles have fewer points than
//! the equator. This saves a third of the points of the sphere. If the integration needn't be exact, fewer rings and
//! points suffice.

use std::sync::Arc;

use ndarray::ArrayViewMut2;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};
use spharm_harmonics::rings::MonicRecurrence;
use spharm_harmonics::{GaussLegendre, gauss_legendre};

use crate::TransformError;
use crate::gridding::smooth;
use crate::legendre::{Legendre, SomeColumns, Work};
use crate::pool::Pool;
use crate::ring_table::LANES;

/// A term whose `P_{l,m}` is below this value changes no digit of a sum.
const NEGLIGIBLE: f64 = 1e-18;
/// Number of channels that share Legendre functions and fit in the cache together.
pub(super) const CHANNELS: usize = 3;
/// The number of points of a ring is rounded up to a multiple of this step that has only small prime factors. Rings
/// then have few different sizes, so few plans of Fourier transforms are needed.
const STEP: usize = 4;

/// The grid, and the tables and Fourier plans for products on it.
pub(super) struct RingGrid {
    max_degree: usize,
    legendre: Legendre,
    pairs: Vec<RingPair>,
    gauss: GaussLegendre,
    /// Number of complex values of scratch space that the Fourier transform of a pair of rings needs in addition to the
    /// pair's points. It suffices for any pair.
    scratch: usize,
}

/// Resolution of a grid.
#[derive(Debug, Clone, Copy)]
pub(super) enum Size {
    /// Integrates products of two functions of degree L and one function of degree 2L exactly.
    Exact,
    /// Has 5/4 of the rings and points that are needed to resolve functions of degree L. Multiplying a function of
    /// degree L by a density on this grid costs about half as much as on the exact grid, and the result is nearly the
    /// same.
    Coarse,
}

impl Size {
    /// Returns the index of the pair of rings at the equator. Pairs are numbered from the poles.
    pub(super) const fn last_pair(self, max_degree: usize) -> usize {
        match self {
            Self::Exact => max_degree,
            Self::Coarse => (5 * max_degree).div_ceil(8),
        }
    }

    /// Returns the number of points that a ring needs. `orders` and `of_density` are the numbers of orders that aren't
    /// negligible on the ring, for functions of degree L and for the density of degree 2L.
    const fn points(self, orders: usize, of_density: usize) -> usize {
        match self {
            Self::Exact => 2 * (orders - 1) + of_density,
            Self::Coarse => (5 * orders).div_ceil(2),
        }
    }
}

/// A northern ring and its mirror image. The equator is its own mirror image.
struct RingPair {
    /// Number of points of each of the two rings.
    points: usize,
    /// Index of the first point of this pair of rings among the points of all pairs.
    first: usize,
    /// Number of orders, from 0 on, that aren't negligible on these rings.
    orders: usize,
    forward: Arc<dyn Fft<f64>>,
    inverse: Arc<dyn Fft<f64>>,
}

/// Working memory of a product.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    /// Legendre sums, the input of the Fourier transforms: for each order an array (pairs of rings, 2 c) of sums over
    /// even `l - m`, then one of sums over odd `l - m`.
    by_order: Vec<f64>,
    /// Output of the Fourier transforms, from which coefficients are computed: for each run of [`LANES`] pairs of rings
    /// and each order an array (pairs, 4 c), column-major, for c channels. The first 2 c columns are for even `l - m`,
    /// the others for odd `l - m`.
    by_ring: Vec<f64>,
    /// Coefficients sorted by order: for each m an array (L + 1 - m, 2 c), row-major.
    coefficients: Vec<f64>,
}

/// Working memory of a task, which processes an order or a run of rings.
#[derive(Debug)]
pub(super) struct Task {
    /// Coefficients (L + 1 - m, 2 c) of an order, row-major.
    x: Vec<f64>,
    /// Sums (pairs of rings, 2 c) of an order, column-major: first the sums over even `l - m`, then the sums over odd
    /// `l - m`.
    sums: Vec<f64>,
    /// Values at the points of a pair of rings, or the spectrum of these values.
    circle: Vec<Complex64>,
    fourier: Vec<Complex64>,
    legendre: Work,
}

impl std::fmt::Debug for RingGrid {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let points = self.points();
        f.debug_struct("RingGrid").field("max_degree", &self.max_degree).field("points", &points).finish()
    }
}

impl RingGrid {
    /// Plans a grid for degree L, and the Legendre sums of degree 2L on its rings for [`function`](Self::function).
    ///
    /// # Errors
    ///
    /// [`TransformError::Harmonics`] if 2L is too high.
    pub(super) fn new(max_degree: usize, size: Size) -> Result<(Self, Legendre), TransformError> {
        let last = size.last_pair(max_degree);
        let gauss = gauss_legendre(2 * last + 1);
        let angles: Vec<[f64; 2]> = (0..=last).map(|j| [gauss.cosines[j], gauss.sines[j]]).collect();
        let legendre = Legendre::new(&MonicRecurrence::new(max_degree)?, &angles, NEGLIGIBLE);
        let twice = Legendre::new(&MonicRecurrence::new(2 * max_degree)?, &angles, NEGLIGIBLE);
        let mut planner = FftPlanner::new();
        let mut pairs = Vec::with_capacity(last + 1);
        let (mut first, mut scratch) = (0, 0);
        for j in 0..=last {
            let orders = legendre.orders(j);
            let points = smooth(size.points(orders, twice.orders(j)), STEP);
            let (forward, inverse) = (planner.plan_fft_forward(points), planner.plan_fft_inverse(points));
            scratch = scratch.max(forward.get_inplace_scratch_len()).max(inverse.get_inplace_scratch_len());
            pairs.push(RingPair { points, first, orders, forward, inverse });
            first += points;
        }
        Ok((Self { max_degree, legendre, pairs, gauss, scratch }, twice))
    }

    pub(super) fn max_degree(&self) -> usize {
        self.max_degree
    }

    /// Returns the sum, over all pairs of rings, of the number of points on one ring of the pair.
    pub(super) fn points(&self) -> usize {
        self.pairs.iter().map(|pair| pair.points).sum()
    }

    /// Evaluates at the points the function whose coefficients are the moments to degree 2L, each multiplied by the
    /// factor of its degree. Real parts are values on northern rings, and imaginary parts values on southern rings.
    pub(super) fn function(&self, twice: &Legendre, moments: &[f64], factors: Option<&[f64]>) -> Vec<Complex64> {
        let mut values = vec![Complex64::default(); self.points()];
        let (degree, rings) = (2 * self.max_degree, twice.rings());
        let mut sums = vec![0.0; (degree + 1) * 4 * rings];
        let moments = SomeColumns { values: moments, all: 1, first: 0 };
        sums.par_chunks_mut(4 * rings).enumerate().with_max_len(1).for_each_init(
            || (vec![0.0; 2 * (degree + 1)], Work::new()),
            |(x, work), (m, sums)| {
                twice.scaled(m, 1.0, moments, 1, x);
                if let Some(factors) = factors {
                    x.iter_mut().zip(factors[m..].iter().flat_map(|factor| [factor; 2])).for_each(|(x, f)| *x *= f);
                }
                let (even, odd) = sums.split_at_mut(2 * rings);
                twice.synthesis(m, x, 2, even, odd, work);
            },
        );
        self.of_pairs(&mut values).into_par_iter().enumerate().for_each(|(j, points)| {
            let pair = &self.pairs[j];
            for m in 0..twice.orders(j) {
                let at = |column: usize| sums[(4 * m + column) * rings + j];
                // Orders that are aliases of each other have equal values at the points, so their terms are added.
                let [plus, minus] = pair.spectrum(m, [at(0), at(1), at(2), at(3)]);
                points[m % pair.points] += plus;
                if m > 0 {
                    points[(2 * pair.points - m) % pair.points] += minus;
                }
            }
            pair.inverse.process(points);
        });
        values
    }

    /// Calls `change` for each point, with the quadrature weights of the point and of its mirror image, and with the
    /// values at both. The equator's mirror image has weight zero, because it is the equator itself.
    pub(super) fn weigh(&self, values: &mut [Complex64], change: impl Fn([f64; 2], &mut Complex64) + Sync) {
        self.of_pairs(values).into_par_iter().enumerate().for_each(|(j, points)| {
            let weight = self.gauss.weights[j] * std::f64::consts::TAU / points.len() as f64;
            // The equator is its own mirror image, and is weighted once.
            let mirror = if j + 1 == self.pairs.len() { 0.0 } else { weight };
            points.iter_mut().for_each(|point| change([weight, mirror], point));
        });
    }

    /// Splits the values at all points into a slice for each pair of rings.
    fn of_pairs<'a>(&self, mut points: &'a mut [Complex64]) -> Vec<&'a mut [Complex64]> {
        let mut parts = Vec::with_capacity(self.pairs.len());
        for pair in &self.pairs {
            let (part, rest) = points.split_at_mut(pair.points);
            parts.push(part);
            points = rest;
        }
        parts
    }

    /// Computes `A_g^T diag(density) A_g x` and writes the result to `out` (K, c). The product uses the c columns of x
    /// from `x.first` on.
    pub(super) fn product(
        &self,
        density: &[Complex64],
        x: SomeColumns<'_>,
        out: ArrayViewMut2<'_, f64>,
        space: &mut Workspace,
        tasks: &Pool<Task>,
    ) {
        let (columns, rings) = (2 * out.ncols(), self.legendre.rings());
        let orders = self.max_degree + 1;
        space.by_order.resize(orders * 2 * columns * rings, 0.0);
        space.by_ring.resize(orders * 2 * columns * rings, 0.0);
        space.coefficients.resize(orders * (orders + 1) / 2 * columns, 0.0);
        let Workspace { by_order, by_ring, coefficients } = space;
        self.to_rings(x, out.ncols(), by_order, tasks);
        self.multiply(density, columns, by_order, by_ring, tasks);
        self.to_coefficients(columns, by_ring, coefficients, tasks);
        self.legendre.to_canonical(&space.coefficients, out);
    }

    /// Creates the working memory of a task.
    fn task(&self) -> Task {
        let columns = 2 * CHANNELS;
        let points = self.pairs.iter().map(|pair| pair.points).max().unwrap_or(0);
        Task {
            x: vec![0.0; (self.max_degree + 1) * columns],
            sums: vec![0.0; 2 * columns * self.legendre.rings()],
            circle: vec![Complex64::default(); points],
            fourier: vec![Complex64::default(); self.scratch],
            legendre: Work::new(),
        }
    }

    /// Computes the Legendre sums of all orders.
    fn to_rings(&self, x: SomeColumns<'_>, channels: usize, by_order: &mut [f64], tasks: &Pool<Task>) {
        let (columns, rings) = (2 * channels, self.legendre.rings());
        by_order.par_chunks_mut(2 * columns * rings).enumerate().with_max_len(1).for_each(|(m, sums)| {
            tasks.with(
                || self.task(),
                |Task { x: scaled, legendre, .. }| {
                    self.legendre.scaled(m, 1.0, x, channels, scaled);
                    let (even, odd) = sums.split_at_mut(columns * rings);
                    self.legendre.synthesis(m, scaled, columns, even, odd, legendre);
                },
            );
        });
    }

    /// Transforms to the points of the rings, multiplies by the density, and transforms back to sums for each order.
    fn multiply(
        &self,
        density: &[Complex64],
        columns: usize,
        by_order: &[f64],
        by_ring: &mut [f64],
        tasks: &Pool<Task>,
    ) {
        let (orders, rings) = (self.max_degree + 1, self.legendre.rings());
        let run = |(run, by_ring): (usize, &mut [f64]), Task { circle, fourier, .. }: &mut Task| {
            if (run + 1) * LANES > self.pairs.len() {
                // Lanes without a ring are multiplied by zero, but values left in these lanes by another call could
                // be NaN.
                by_ring.fill(0.0);
            }
            for lane in 0..LANES.min(self.pairs.len() - run * LANES) {
                let j = run * LANES + lane;
                let pair = &self.pairs[j];
                let circle = &mut circle[..pair.points];
                let density = &density[pair.first..][..pair.points];
                for cosine in (0..columns).step_by(2) {
                    // The columns of the cosine and the sine sum over even `l - m`, then over odd `l - m`.
                    let places = [cosine, cosine + 1, columns + cosine, columns + cosine + 1];
                    circle.fill(Complex64::default());
                    for m in 0..pair.orders {
                        let at = places.map(|column| by_order[(2 * m * columns + column) * rings + j]);
                        pair.put(m, at, circle);
                    }
                    pair.inverse.process_with_scratch(circle, fourier);
                    for (point, density) in circle.iter_mut().zip(density) {
                        *point = Complex64::new(point.re * density.re, point.im * density.im);
                    }
                    pair.forward.process_with_scratch(circle, fourier);
                    for m in 0..pair.orders {
                        for (column, value) in places.into_iter().zip(pair.take(m, circle)) {
                            by_ring[(2 * m * columns + column) * LANES + lane] = value;
                        }
                    }
                }
            }
        };
        let runs = by_ring.par_chunks_mut(orders * 2 * columns * LANES).enumerate().with_max_len(1);
        runs.for_each(|item| tasks.with(|| self.task(), |task| run(item, task)));
    }

    /// Applies the transpose of [`to_rings`](Self::to_rings).
    fn to_coefficients(&self, columns: usize, by_ring: &[f64], coefficients: &mut [f64], tasks: &Pool<Task>) {
        let (orders, rings) = (self.max_degree + 1, self.legendre.rings());
        let mut rest = coefficients;
        let mut parts = Vec::with_capacity(orders);
        for m in 0..orders {
            let (part, tail) = rest.split_at_mut((orders - m) * columns);
            parts.push(part);
            rest = tail;
        }
        let order = |(m, x): (usize, &mut [f64]), Task { sums, legendre, .. }: &mut Task| {
            let first = self.legendre.first_ring(m) / LANES;
            for (run, by_ring) in by_ring.chunks_exact(orders * 2 * columns * LANES).enumerate().skip(first) {
                let lanes = by_ring[2 * m * columns * LANES..][..2 * columns * LANES].chunks_exact(LANES);
                for (sums, lanes) in sums.chunks_exact_mut(rings).zip(lanes) {
                    sums[run * LANES..][..LANES].copy_from_slice(lanes);
                }
            }
            let (even, odd) = sums[..2 * columns * rings].split_at_mut(columns * rings);
            self.legendre.adjoint(m, even, odd, columns, x, legendre);
            for (x, scale) in x.chunks_exact_mut(columns).zip(self.legendre.scale(m)) {
                x.iter_mut().for_each(|x| *x *= scale);
            }
        };
        let parts = parts.into_par_iter().enumerate().with_max_len(1);
        parts.for_each(|item| tasks.with(|| self.task(), |task| order(item, task)));
    }
}

impl RingPair {
    /// Returns the Fourier coefficients m and -m of `north + i south`, where `north` and `south` are the values on the
    /// two rings. The arguments are the Legendre sums of order m over even and over odd `l - m`, for the harmonics with
    /// cos(m phi) and those with sin(m phi): `[even cosine, even sine, odd cosine, odd sine]`.
    #[inline(always)]
    fn spectrum(&self, m: usize, [even_cosine, even_sine, odd_cosine, odd_sine]: [f64; 4]) -> [Complex64; 2] {
        let north = Complex64::new(even_cosine + odd_cosine, -even_sine - odd_sine);
        let south = Complex64::new(even_cosine - odd_cosine, odd_sine - even_sine);
        if m == 0 {
            return [Complex64::new(north.re, south.re); 2];
        }
        // The spectrum of north + i south. The values on each ring are real, so half of the ring's coefficient of order
        // m is at m, and the conjugate of this half is at -m.
        [
            Complex64::new(0.5 * (north.re - south.im), 0.5 * (north.im + south.re)),
            Complex64::new(0.5 * (north.re + south.im), 0.5 * (south.re - north.im)),
        ]
    }

    /// Writes order m to the common spectrum of the pair's two rings.
    #[inline(always)]
    fn put(&self, m: usize, sums: [f64; 4], spectrum: &mut [Complex64]) {
        let [plus, minus] = self.spectrum(m, sums);
        spectrum[m] = plus;
        if m > 0 {
            spectrum[self.points - m] = minus;
        }
    }

    /// Reads order m from the common spectrum of the pair's two rings: the transpose of [`put`](Self::put).
    #[inline(always)]
    fn take(&self, m: usize, spectrum: &[Complex64]) -> [f64; 4] {
        if m == 0 {
            let Complex64 { re: north, im: south } = spectrum[0];
            return [north + south, 0.0, north - south, 0.0];
        }
        let (plus, minus) = (spectrum[m], spectrum[self.points - m]);
        let north = [0.5 * (plus.re + minus.re), 0.5 * (minus.im - plus.im)];
        let south = [0.5 * (plus.im + minus.im), 0.5 * (plus.re - minus.re)];
        [north[0] + south[0], north[1] + south[1], north[0] - south[0], north[1] - south[1]]
    }
}
