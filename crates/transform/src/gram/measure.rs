//! Computes the tables of a Gram matrix: the Legendre functions and the measure's Fourier coefficients on the rings.
//!
//! The measure is `S = sum s_{l,m} S_{l,m}`, with the moments `s_{l,m}` (see [`gram`](super)). `S^q` is the part of
//! this sum over the degrees l of parity q. With the Gauss weight g_j of ring j, and for |k| <= 2L, the Fourier
//! coefficients are
//!
//! ```text
//! c_k^q(j) = 1/2 g_j integral of S^q(theta_j, phi) cos(k phi) d phi
//! d_k^q(j) = 1/2 g_j integral of S^q(theta_j, phi) sin(k phi) d phi
//! ```
//!
//! With `P_{l,k}(theta) = S_{l,k}(theta, 0)` and sums over the degrees l of parity q, the integrals are
//!
//! ```text
//! c_k^q(j) = pi/2 g_j sum_l s_{l,k} P_{l,k}(theta_j)
//! d_k^q(j) = pi/2 g_j sum_l s_{l,-k} P_{l,k}(theta_j)    (k > 0)
//! c_0^q(j) = pi g_j sum_l s_{l,0} P_{l,0}(theta_j)       d_0^q(j) = 0
//! c_{-k}^q(j) = c_k^q(j)                                 d_{-k}^q(j) = -d_k^q(j)
//! ```
//!
//! Therefore no grid of azimuths and no FFT is needed. A ring south of the equator contributes as much as its mirror
//! image (see [`gram`](super)), so the rings north of the equator have twice the weight.

use rayon::prelude::*;
use spharm_harmonics::{Recurrence, Sweep, column, gauss_legendre};

use super::kernel::{LANES, Lanes, Waves};
use crate::TransformError;

/// Number of rings per run. This number is small enough for the harmonics of degree 2L on these rings to stay in a
/// thread's cache.
const RUN: usize = 16;

/// The tables for one degree and one list of moments.
#[derive(Debug)]
pub(super) struct Measure {
    max_degree: usize,
    /// Values `P_{l,m}(theta_j)` on the northern rings: for each l an array (blocks of eight m, rings), 0 if m > l.
    legendre: Vec<Lanes>,
    /// For each parity q, an array (k from -L to 2L, rings) of windows: the eight Fourier coefficients `c_k .. c_{k+7}`
    /// defined at the top of this file. Each value is thus stored eight times, so that the kernel's reads along the
    /// rings are aligned for any m - m'. `sine` has the coefficients `d_k .. d_{k+7}` in the same layout.
    cosine: [Vec<Lanes>; 2],
    sine: [Vec<Lanes>; 2],
}

/// Returns the number of blocks of eight orders of degree l.
const fn blocks(l: usize) -> usize {
    l / LANES + 1
}

/// Returns the number of blocks of all degrees below l; degrees 8 (b - 1) to 8 b - 1 have b blocks each.
const fn blocks_before(l: usize) -> usize {
    let (whole, rest) = (l / LANES, l % LANES);
    LANES * whole * (whole + 1) / 2 + rest * (whole + 1)
}

/// Returns the number of windows of eight successive frequencies k. The first starts at k = -L, the last at k = 2L.
const fn window_count(max_degree: usize) -> usize {
    3 * max_degree + 1
}

impl Measure {
    pub(super) const fn bytes(max_degree: usize) -> usize {
        size_of::<Lanes>() * (max_degree + 1) * (blocks_before(max_degree + 1) + 4 * window_count(max_degree))
    }

    /// Returns the number of northern rings, including the equator.
    pub(super) fn rings(&self) -> usize {
        self.max_degree + 1
    }

    pub(super) fn max_degree(&self) -> usize {
        self.max_degree
    }

    /// Returns the values `P_{l,m}` (blocks, rings) of degree l.
    pub(super) fn degree(&self, l: usize) -> &[Lanes] {
        &self.legendre[blocks_before(l) * self.rings()..][..blocks(l) * self.rings()]
    }

    /// Returns `P_{l,m}` of degree l and order m on each ring.
    pub(super) fn order(&self, l: usize, m: usize) -> impl Iterator<Item = f64> {
        self.degree(l)[m / LANES * self.rings()..][..self.rings()].iter().map(move |lanes| lanes.0[m % LANES])
    }

    /// Returns the measure's Fourier coefficients for an order m' and degrees with l + l' of parity `parity`.
    pub(super) fn waves(&self, parity: usize, order: usize) -> Waves<'_> {
        let (minus, plus) = (self.max_degree - order, self.max_degree + order);
        Waves { cosine: &self.cosine[parity], sine: &self.sine[parity], minus, plus }
    }

    pub(super) fn new(max_degree: usize, moments: &[f64]) -> Result<Self, TransformError> {
        let recurrence = Recurrence::new(2 * max_degree)?;
        let all = gauss_legendre(2 * max_degree + 1);
        let rings = max_degree + 1;
        let directions: Vec<_> = (0..rings).map(|j| all.direction(j)).collect();
        // Every ring except the equator also represents its mirror image.
        let factors: Vec<_> = (0..rings).map(|j| all.weights[j] * if j < max_degree { 2.0 } else { 1.0 }).collect();
        let mut legendre = vec![Lanes::default(); blocks_before(rings) * rings];
        let zeros = || vec![0.0; rings * (2 * max_degree + 1)];
        let (mut cosine, mut sine) = ([zeros(), zeros()], [zeros(), zeros()]);
        // Rings are processed in batches, because all runs together would take as much memory as the table to which
        // they are copied.
        let together = RUN * rayon::current_num_threads();
        for start in (0..rings).step_by(together) {
            let batch = &directions[start..rings.min(start + together)];
            let runs: Vec<_> =
                batch.par_chunks(RUN).map(|run| Run::new(&recurrence, max_degree, moments, run)).collect();
            put_legendre(max_degree, &mut legendre, start, &runs);
            for (index, run) in runs.iter().enumerate() {
                for parity in 0..2 {
                    put_sums(&mut cosine[parity], &run.cosine[parity], start + index * RUN, run.rows, &factors);
                    put_sums(&mut sine[parity], &run.sine[parity], start + index * RUN, run.rows, &factors);
                }
            }
        }
        let cosine = cosine.map(|sums| windows(max_degree, &sums, 1.0));
        let sine = sine.map(|sums| windows(max_degree, &sums, -1.0));
        Ok(Self { max_degree, legendre, cosine, sine })
    }
}

/// Copies the Legendre functions of some runs, whose first ring is `start`, to their places in the table.
fn put_legendre(max_degree: usize, legendre: &mut [Lanes], start: usize, runs: &[Run]) {
    let rings = max_degree + 1;
    let mut degrees = Vec::with_capacity(rings);
    let mut rest = legendre;
    for l in 0..rings {
        let (degree, after) = rest.split_at_mut(blocks(l) * rings);
        degrees.push(degree);
        rest = after;
    }
    degrees.into_par_iter().enumerate().for_each(|(l, degree)| {
        for (index, run) in runs.iter().enumerate() {
            for (m, values) in run.legendre[l].chunks_exact(run.rows).enumerate() {
                let at = m / LANES * rings + start + index * RUN;
                degree[at..].iter_mut().zip(values).for_each(|(out, value)| out.0[m % LANES] = *value);
            }
        }
    });
}

/// Copies the sums (rings of the run, k) of one run to their places among the sums (rings, k) of all rings, and
/// multiplies them by the factors that turn them into the Fourier coefficients c_k or d_k (see the [module](self)).
fn put_sums(out: &mut [f64], sums: &[f64], first: usize, rows: usize, factors: &[f64]) {
    let rings = factors.len();
    for (k, (out, sums)) in out.chunks_exact_mut(rings).zip(sums.chunks_exact(rows)).enumerate() {
        let pi = if k == 0 { std::f64::consts::PI } else { std::f64::consts::FRAC_PI_2 };
        for ((out, sum), factor) in out[first..].iter_mut().zip(sums).zip(&factors[first..]) {
            *out = pi * factor * sum;
        }
    }
}

/// Returns the window of eight values that starts at each k. `sums` are the values (rings, k) at k >= 0. The value at
/// -k is `sign` times the value at k, and values beyond 2L are zero.
fn windows(max_degree: usize, sums: &[f64], sign: f64) -> Vec<Lanes> {
    let rings = max_degree + 1;
    let mut windows = vec![Lanes::default(); window_count(max_degree) * rings];
    windows.par_chunks_exact_mut(rings).enumerate().for_each(|(start, window)| {
        for lane in 0..LANES {
            let k = (start + lane).abs_diff(max_degree);
            if k <= 2 * max_degree {
                let sign = if start + lane < max_degree { sign } else { 1.0 };
                let values = &sums[k * rings..][..rings];
                window.iter_mut().zip(values).for_each(|(window, value)| window.0[lane] = sign * value);
            }
        }
    });
    windows
}

/// Legendre functions and sums of one run of rings.
#[derive(Debug)]
struct Run {
    rows: usize,
    /// Legendre functions (rings, m) of each l, column-major.
    legendre: Vec<Vec<f64>>,
    /// Sums `sum_l s_{l,k} P_{l,k}` (rings, k) over the moments s, for each parity of l, column-major. `sine` contains
    /// the sums with `s_{l,-k}`.
    cosine: [Vec<f64>; 2],
    sine: [Vec<f64>; 2],
}

impl Run {
    fn new(recurrence: &Recurrence, max_degree: usize, moments: &[f64], directions: &[[f64; 3]]) -> Self {
        let rows = directions.len();
        let zeros = || vec![0.0; rows * (2 * max_degree + 1)];
        let mut run = Self { rows, legendre: Vec::new(), cosine: [zeros(), zeros()], sine: [zeros(), zeros()] };
        // At azimuth 0 the harmonics of orders 0..=l are the Legendre functions.
        let mut sweep = Sweep::new(recurrence, directions);
        let mut block = vec![0.0; rows * (4 * max_degree + 1)];
        for l in 0..=2 * max_degree {
            let block = &mut block[..rows * (2 * l + 1)];
            sweep.next_degree(block);
            let legendre = &block[l * rows..];
            let centre = column(l, 0);
            let sums = run.cosine[l % 2].chunks_exact_mut(rows).zip(run.sine[l % 2].chunks_exact_mut(rows));
            for ((k, p), (cosine, sine)) in legendre.chunks_exact(rows).enumerate().zip(sums) {
                let (c, d) = (moments[centre + k], if k > 0 { moments[centre - k] } else { 0.0 });
                for ((cosine, sine), p) in cosine.iter_mut().zip(sine).zip(p) {
                    *cosine += c * p;
                    *sine += d * p;
                }
            }
            if l <= max_degree {
                run.legendre.push(legendre.to_vec());
            }
        }
        run
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_add_up() {
        let mut sum = 0;
        for l in 0..100 {
            assert_eq!(blocks_before(l), sum);
            sum += blocks(l);
        }
    }
}
