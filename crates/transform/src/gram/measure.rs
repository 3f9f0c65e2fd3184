//! What the Gram matrix is made from: the Legendre table at the rings, and the measure's Fourier coefficients on them.
//!
//! On ring j, with its Gauss weight g_j, for |k| <= 2L and a parity q of the moments' degree,
//!
//! ```text
//! c_k^q(j) = 1/2 g_j integral of S^q(theta_j, phi) cos(k phi) d phi,   d_k^q(j) the same with sin(k phi),
//! ```
//!
//! where `S^q = sum of s_{l,m} S_{l,m}` over the l of that parity: `c_k = pi/2 g_j sum_l s_{l,k} P_{l,k}(theta_j)` and
//! `d_k` with `s_{l,-k}` for k > 0, `c_0 = pi g_j sum_l s_{l,0} P_{l,0}`, `d_0 = 0`, `c_{-k} = c_k`, `d_{-k} = -d_k`. No
//! grid of azimuths and no FFT is needed. The rings south of the equator give what their mirrors give (see
//! [`gram`](super)), so the northern ones count twice.

use rayon::prelude::*;
use spharm_harmonics::{Recurrence, Sweep, column, gauss_legendre};

use super::kernel::{LANES, Lanes, Weights};
use crate::TransformError;

/// Rings that a thread takes at a time: the harmonics of degree 2L at them stay in its cache.
const RUN: usize = 16;

#[derive(Debug)]
pub(super) struct Measure {
    max_degree: usize,
    /// `P_{l,m}(theta_j)` of the northern rings: for each l (blocks of eight m, rings), zero where m > l.
    legendre: Vec<Lanes>,
    /// c and d for each parity q, (rings, k from -L to 2L + 7).
    cosine: [Vec<f64>; 2],
    sine: [Vec<f64>; 2],
}

/// Blocks of eight orders that degree l has.
pub(super) const fn blocks(l: usize) -> usize {
    l / LANES + 1
}

/// Blocks of all degrees below l: 8 b degrees have up to b blocks.
const fn blocks_before(l: usize) -> usize {
    let (whole, rest) = (l / LANES, l % LANES);
    LANES * whole * (whole + 1) / 2 + rest * (whole + 1)
}

/// Values of k that a ring has; the last seven are zero, for the lanes past order L.
const fn frequencies(max_degree: usize) -> usize {
    3 * max_degree + LANES
}

impl Measure {
    pub(super) const fn bytes(max_degree: usize) -> usize {
        let rings = max_degree + 1;
        8 * rings * (LANES * blocks_before(max_degree + 1) + 4 * frequencies(max_degree))
    }

    /// Northern rings, with the equator.
    pub(super) fn rings(&self) -> usize {
        self.max_degree + 1
    }

    pub(super) fn max_degree(&self) -> usize {
        self.max_degree
    }

    /// `P_{l,m}` for a degree, (blocks, rings).
    pub(super) fn degree(&self, l: usize) -> &[Lanes] {
        &self.legendre[blocks_before(l) * self.rings()..][..blocks(l) * self.rings()]
    }

    /// `P_{l,m}` at the rings.
    pub(super) fn order(&self, l: usize, m: usize) -> impl Iterator<Item = f64> {
        self.degree(l)[m / LANES * self.rings()..][..self.rings()].iter().map(move |lanes| lanes.0[m % LANES])
    }

    pub(super) fn new(max_degree: usize, moments: &[f64]) -> Result<Self, TransformError> {
        let recurrence = Recurrence::new(2 * max_degree)?;
        let all = gauss_legendre(2 * max_degree + 1);
        let rings = max_degree + 1;
        let directions: Vec<_> = (0..rings).map(|j| all.direction(j)).collect();
        // All but the equator stand for their mirror too.
        let factors: Vec<_> = (0..rings).map(|j| all.weights[j] * if j < max_degree { 2.0 } else { 1.0 }).collect();
        let zeros = || vec![0.0; rings * frequencies(max_degree)];
        let mut measure = Self {
            max_degree,
            legendre: vec![Lanes::default(); blocks_before(rings) * rings],
            cosine: [zeros(), zeros()],
            sine: [zeros(), zeros()],
        };
        // In batches, so that the parts that wait to be put in place don't double the memory.
        for start in (0..rings).step_by(RUN * rayon::current_num_threads()) {
            let batch = &directions[start..rings.min(start + RUN * rayon::current_num_threads())];
            let runs: Vec<_> =
                batch.par_chunks(RUN).map(|run| Run::new(&recurrence, max_degree, moments, run)).collect();
            for (index, run) in runs.iter().enumerate() {
                measure.put_frequencies(start + index * RUN, run, &factors);
            }
            measure.put_legendre(start, &runs);
        }
        Ok(measure)
    }

    fn put_frequencies(&mut self, first: usize, run: &Run, factors: &[f64]) {
        let (l, count) = (self.max_degree, frequencies(self.max_degree));
        for i in 0..run.rows {
            let j = first + i;
            for parity in 0..2 {
                let (cosine, sine) = (&mut self.cosine[parity][j * count..], &mut self.sine[parity][j * count..]);
                for k in 0..=2 * l {
                    let half = factors[j] * std::f64::consts::PI * if k == 0 { 1.0 } else { 0.5 };
                    cosine[l + k] = half * run.cosine[parity][k * run.rows + i];
                    sine[l + k] = half * run.sine[parity][k * run.rows + i];
                }
                for k in 1..=l {
                    cosine[l - k] = cosine[l + k];
                    sine[l - k] = -sine[l + k];
                }
            }
        }
    }

    fn put_legendre(&mut self, start: usize, runs: &[Run]) {
        let rings = self.rings();
        let mut degrees = Vec::with_capacity(rings);
        let mut rest = self.legendre.as_mut_slice();
        for l in 0..rings {
            let (degree, after) = rest.split_at_mut(blocks(l) * rings);
            degrees.push(degree);
            rest = after;
        }
        degrees.into_par_iter().enumerate().for_each(|(l, degree)| {
            for (index, run) in runs.iter().enumerate() {
                let values = &run.legendre[l];
                for (m, values) in values.chunks_exact(run.rows).enumerate() {
                    let at = m / LANES * rings + start + index * RUN;
                    for (out, value) in degree[at..].iter_mut().zip(values) {
                        out.0[m % LANES] = *value;
                    }
                }
            }
        });
    }

    /// `W_{m,m'}` for the blocks of orders m from `origin` on, for degrees with l + l' of parity `parity`; `out` (blocks,
    /// rings). From `2 cos a cos b = cos(a - b) + cos(a + b)` and its three sisters.
    pub(super) fn weights(&self, parity: usize, order: usize, origin: usize, out: &mut [Weights]) {
        let (rings, count) = (self.rings(), frequencies(self.max_degree));
        for (block, out) in out.chunks_exact_mut(rings).enumerate() {
            let m = (origin + block) * LANES + self.max_degree;
            for (j, [cc, sc, cs, ss]) in out.iter_mut().enumerate() {
                let (cosine, sine) = (&self.cosine[parity][j * count..], &self.sine[parity][j * count..]);
                let (c_minus, c_plus) = (&cosine[m - order..][..LANES], &cosine[m + order..][..LANES]);
                let (d_minus, d_plus) = (&sine[m - order..][..LANES], &sine[m + order..][..LANES]);
                for lane in 0..LANES {
                    cc.0[lane] = c_minus[lane] + c_plus[lane];
                    sc.0[lane] = d_plus[lane] + d_minus[lane];
                    cs.0[lane] = d_plus[lane] - d_minus[lane];
                    ss.0[lane] = c_minus[lane] - c_plus[lane];
                }
            }
        }
    }
}

/// What one run of rings gives.
#[derive(Debug)]
struct Run {
    rows: usize,
    /// For each l, (rings, m) column-major.
    legendre: Vec<Vec<f64>>,
    /// `sum_l s_{l,k} P_{l,k}` for each parity of l, (rings, k) column-major.
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
