//! Fourier transforms from rings to the oversampled grid and back: along colatitude, then along azimuth.
//!
//! Let `F_m^cos` and `F_m^sin` be the Legendre sums of order m for cosine and sine, see [`legendre`](crate::legendre).
//! The function `Z_m = F_m^cos + i F_m^sin`, continued over the poles by `Z_m(-theta) = (-1)^m Z_m(theta)`, is a
//! trigonometric polynomial of degree L in theta. Its samples on N rings, `theta_j = (j + 1/2) pi / N`, determine its
//! spectrum. The spectrum is divided by the spectrum of the kernel, and summed on the finer grid of M points around the
//! sphere. Even orders have an even spectrum, and odd orders have an odd spectrum. Therefore an even and an odd order
//! are added before a complex transform, and separated by symmetry afterwards. Two orders of a channel take one
//! transform of length 2 N and one transform of length M.
//!
//! Along azimuth, the function `f = Re sum_m (F_m^cos - i F_m^sin) e^{i m phi}` is computed by a Fourier transform from
//! complex to real numbers. The coefficients of order m have already been divided by the transform `p_m` of the
//! [kernel](crate::kernel).
//!
//! Cost per channel: `5 (L + 1) N log2(2 N) + 2.5 (L + 1) M log2 M + 1.25 M^2 log2 M` flops.

use std::sync::Arc;

use rayon::prelude::*;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use rustfft::num_complex::Complex64;
use rustfft::{Fft, FftPlanner};

use crate::grid::Layout;
use crate::gridding::Gridding;
use crate::kernel::Kernel;

/// Number of grid rows that are gathered together. For a single order, the values of neighbouring rows are close in
/// memory, whereas the values of different orders of one row are far apart.
const ROWS: usize = 8;
/// Number of pairs, of an even order and the odd order after it, that [`Fourier::grid_to_circles`] processes together.
const PAIRS: usize = 4;

/// The Fourier transforms of one gridding.
pub(crate) struct Fourier {
    max_degree: usize,
    gridding: Gridding,
    rings_forward: Arc<dyn Fft<f64>>,
    rings_inverse: Arc<dyn Fft<f64>>,
    grid_forward: Arc<dyn Fft<f64>>,
    grid_inverse: Arc<dyn Fft<f64>>,
    to_reals: Arc<dyn ComplexToReal<f64>>,
    from_reals: Arc<dyn RealToComplex<f64>>,
    /// Factors `e^{-i k pi / 2N} / (2 N p_k)` that correct the frequencies `k >= 0` in theta, with the transform p_k of
    /// the [kernel](crate::kernel). The factors for -k are their conjugates.
    correction: Vec<Complex64>,
}

impl std::fmt::Debug for Fourier {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Fourier").field("max_degree", &self.max_degree).field("gridding", &self.gridding).finish()
    }
}

/// Working memory of one thread.
pub(crate) struct FourierWork {
    circle: Vec<Complex64>,
    scratch: Vec<Complex64>,
    spectra: Vec<Complex64>,
}

/// Legendre sums of an even order and of the odd order after it, at a pair of rings. Cosine sums are real parts and
/// sine sums imaginary parts. For each order, the first element is the sum over even `l - m`, and the second the sum
/// over odd `l - m`.
#[derive(Clone, Copy, Default)]
pub(crate) struct RingPair {
    pub(crate) even_order: [Complex64; 2],
    pub(crate) odd_order: [Complex64; 2],
}

impl Fourier {
    pub(crate) fn new(max_degree: usize, gridding: Gridding, kernel: &Kernel) -> Self {
        let (mut complex, mut real) = (FftPlanner::new(), RealFftPlanner::new());
        let around = 2 * gridding.rings;
        let correction = (0..=max_degree)
            .map(|k| {
                let size = 1.0 / (around as f64 * kernel.transform(k, gridding.grid));
                Complex64::from_polar(size, -(k as f64) * std::f64::consts::PI / around as f64)
            })
            .collect();
        Self {
            max_degree,
            gridding,
            rings_forward: complex.plan_fft_forward(around),
            rings_inverse: complex.plan_fft_inverse(around),
            grid_forward: complex.plan_fft_forward(gridding.grid),
            grid_inverse: complex.plan_fft_inverse(gridding.grid),
            to_reals: real.plan_fft_inverse(gridding.grid),
            from_reals: real.plan_fft_forward(gridding.grid),
            correction,
        }
    }

    /// Returns the number of pairs of orders. A pair is an even order m and the odd order m + 1. If L is even, the last
    /// pair has only the order L.
    pub(crate) fn order_pairs(&self) -> usize {
        self.max_degree / 2 + 1
    }

    pub(crate) fn work(&self) -> FourierWork {
        let scratch = [
            self.rings_forward.get_inplace_scratch_len(),
            self.rings_inverse.get_inplace_scratch_len(),
            self.grid_forward.get_inplace_scratch_len(),
            self.grid_inverse.get_inplace_scratch_len(),
            self.to_reals.get_scratch_len(),
            self.from_reals.get_scratch_len(),
        ];
        FourierWork {
            circle: vec![Complex64::default(); 2 * self.gridding.rings],
            scratch: vec![Complex64::default(); scratch.into_iter().max().unwrap_or(0)],
            spectra: vec![Complex64::default(); ROWS * (self.gridding.grid / 2 + 1)],
        }
    }

    /// Transforms an even order and the odd order after it, of one channel, from rings to the M points of a great
    /// circle, `out`. `ring` returns the Legendre sums at a pair of rings; the pairs are numbered from the pole to the
    /// equator.
    pub(crate) fn rings_to_circle(
        &self,
        ring: impl Fn(usize) -> RingPair,
        out: &mut [Complex64],
        work: &mut FourierWork,
    ) {
        let (n, l, m) = (self.gridding.rings, self.max_degree, self.gridding.grid);
        let circle = &mut work.circle[..];
        for j in 0..n.div_ceil(2) {
            let RingPair { even_order: [ee, eo], odd_order: [oe, oo] } = ring(j);
            // The southern ring is written first, so that the equator, which is both rings of its pair, keeps the
            // northern value.
            let (even, odd) = (ee - eo, oe - oo);
            (circle[n - 1 - j], circle[n + j]) = (even + odd, even - odd);
            let (even, odd) = (ee + eo, oe + oo);
            (circle[j], circle[2 * n - 1 - j]) = (even + odd, even - odd);
        }
        self.rings_forward.process_with_scratch(circle, &mut work.scratch);
        out[0] = circle[0] * self.correction[0];
        for k in 1..=l {
            out[k] = circle[k] * self.correction[k];
            out[m - k] = circle[2 * n - k] * self.correction[k].conj();
        }
        out[l + 1..m - l].fill(Complex64::default());
        self.grid_inverse.process_with_scratch(out, &mut work.scratch);
    }

    /// Applies the transpose of [`rings_to_circle`](Self::rings_to_circle); overwrites `circle_of_grid`.
    pub(crate) fn circle_to_rings(
        &self,
        circle_of_grid: &mut [Complex64],
        mut ring: impl FnMut(usize, RingPair),
        work: &mut FourierWork,
    ) {
        let (n, l, m) = (self.gridding.rings, self.max_degree, self.gridding.grid);
        self.grid_forward.process_with_scratch(circle_of_grid, &mut work.scratch);
        let circle = &mut work.circle[..];
        circle.fill(Complex64::default());
        circle[0] = circle_of_grid[0] * self.correction[0];
        for k in 1..=l {
            circle[k] = circle_of_grid[k] * self.correction[k].conj();
            circle[2 * n - k] = circle_of_grid[m - k] * self.correction[k];
        }
        self.rings_inverse.process_with_scratch(circle, &mut work.scratch);
        for j in 0..n.div_ceil(2) {
            let (here, mirrored) = (circle[j], circle[2 * n - 1 - j]);
            let (even, odd) = (here + mirrored, here - mirrored);
            let mut pair = RingPair { even_order: [even, even], odd_order: [odd, odd] };
            if j != n - 1 - j {
                let (here, mirrored) = (circle[n - 1 - j], circle[n + j]);
                let (even, odd) = (here + mirrored, here - mirrored);
                pair.even_order = [pair.even_order[0] + even, pair.even_order[1] - even];
                pair.odd_order = [pair.odd_order[0] + odd, pair.odd_order[1] - odd];
            }
            ring(j, pair);
        }
    }

    /// Transforms all circles to the rows of the grid. The circles have the shape (pairs, channels, M), with a pair for
    /// each even order and the odd order after it.
    pub(crate) fn circles_to_grid(&self, circles: &[Complex64], layout: Layout, grid: &mut [f64]) {
        let (m, channels) = (self.gridding.grid, layout.channels);
        let length = m / 2 + 1;
        layout.core_mut(grid, ROWS).enumerate().for_each_init(
            || self.work(),
            |work, (group, rows)| {
                let first = group * ROWS;
                let count = ROWS.min(layout.core_rows() - first);
                for channel in 0..channels {
                    work.spectra.fill(Complex64::default());
                    for pair in 0..self.order_pairs() {
                        let circle = &circles[(pair * channels + channel) * m..][..m];
                        for i in 0..count {
                            let (here, mirrored) = (circle[first + i], circle[(m - first - i) % m]);
                            let spectrum = &mut work.spectra[i * length..][..length];
                            spectrum[2 * pair] = (here + mirrored).conj();
                            if 2 * pair < self.max_degree {
                                spectrum[2 * pair + 1] = (here - mirrored).conj();
                            }
                        }
                    }
                    for (i, spectrum) in work.spectra.chunks_exact_mut(length).take(count).enumerate() {
                        spectrum[0].im = 0.0;
                        let line = &mut rows[layout.line(i, channel)];
                        let done = self.to_reals.process_with_scratch(spectrum, line, &mut work.scratch);
                        debug_assert!(done.is_ok(), "expected matching sizes, and real first and last coefficients");
                    }
                }
            },
        );
    }

    /// Applies the transpose of [`circles_to_grid`](Self::circles_to_grid); overwrites the grid and `spectra`.
    pub(crate) fn grid_to_circles(
        &self,
        grid: &mut [f64],
        layout: Layout,
        spectra: &mut [Complex64],
        circles: &mut [Complex64],
    ) {
        let (m, channels, count) = (self.gridding.grid, layout.channels, self.max_degree + 1);
        // First compute the spectra (rows, channels, orders) of the grid's rows. From these spectra, compute the
        // circles: the values of each pair of orders on a great circle.
        layout.core_mut(grid, ROWS).zip(spectra.par_chunks_mut(ROWS * channels * count)).for_each_init(
            || self.work(),
            |work, (rows, spectra)| {
                for (i, spectra) in spectra.chunks_exact_mut(channels * count).enumerate() {
                    for (channel, spectrum) in spectra.chunks_exact_mut(count).enumerate() {
                        let line = &mut rows[layout.line(i, channel)];
                        let full = &mut work.spectra[..m / 2 + 1];
                        let done = self.from_reals.process_with_scratch(line, full, &mut work.scratch);
                        debug_assert!(done.is_ok(), "expected the sizes of the transform");
                        for (out, value) in spectrum.iter_mut().zip(full) {
                            *out = value.conj();
                        }
                    }
                }
            },
        );
        let spectra = &*spectra;
        // A few pairs are processed together, because they share the cache lines of a spectrum.
        circles.par_chunks_mut(PAIRS * channels * m).enumerate().for_each(|(group, circles)| {
            for channel in 0..channels {
                for i in 0..layout.core_rows() {
                    let spectrum = &spectra[(i * channels + channel) * count..][..count];
                    for (p, circles) in circles.chunks_exact_mut(channels * m).enumerate() {
                        let order = 2 * (group * PAIRS + p);
                        let circle = &mut circles[channel * m..(channel + 1) * m];
                        let mut even = spectrum[order];
                        if order == 0 {
                            // Order 0 has no sine coefficients.
                            even.im = 0.0;
                        }
                        let odd = spectrum.get(order + 1).copied().unwrap_or_default();
                        if i == 0 || 2 * i == m {
                            // The point is its own mirror image, so the sum over both images is twice the even order's
                            // value, and the odd order cancels.
                            circle[i] = even + even;
                        } else {
                            (circle[i], circle[m - i]) = (even + odd, even - odd);
                        }
                    }
                }
            }
        });
    }
}
