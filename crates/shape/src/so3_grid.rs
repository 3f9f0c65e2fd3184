//! Computes the correlations of two surfaces at all rotations of a grid.
//!
//! The correlation of two surfaces f and g, whose coordinates are f_j and g_i, is a 3 x 3 matrix
//! `M_ij(R) = <g_i, R f_j>` for each rotation `R = Rz(al) Ry(be) Rz(ga)`. It is computed from the degrees 1 to B - 1,
//! where B is the bandwidth of the grid, by the method of P. Kostelec and D. Rockmore, "FFTs on the rotation group", J.
//! Fourier Anal. Appl. 14 (2008). For each value of `be`
//!
//! ```text
//! T_mm' = sum over l of conj(g_{lm,i}) f_{lm',j} d^l_mm'(be),  M_ij = sum over m, m' of T_mm' e^{-i m al} e^{-i m' ga}
//! d^l_mm'(be) = sum over k of cos((m - m') pi/2 - k be) Delta_km Delta_km'
//! ```
//!
//! with complex coefficients in the Condon-Shortley phase. The grid has 2B equally spaced values of `al` and of `ga`,
//! starting at 0, and the B values `(k + 1/2) pi/B` of `be`. Cost: `O(B^4)` for the nine sums and `O(B^3 log B)` for
//! their Fourier transforms. Memory: `32/3 B^4` bytes for the table of d, and `400 B^2` bytes in each thread.

use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};
use std::sync::Arc;

use rayon::prelude::*;
use spharm_transform::fft::{Complex64, Fft, plan_forward};

use crate::matrix3::Matrix3;
use crate::quarter::{Centre, dense};
use crate::refine::Space;
use crate::rotation::Rotation;
use spharm_surface::kabsch::best_trace;

/// Returns the maximum of `tr Q^T M` over the allowed matrices Q.
fn score(m: &Matrix3, space: Space) -> f64 {
    match space {
        Space::Fixed => m[0][0] + m[1][1] + m[2][2],
        _ => best_trace(m, space == Space::Mirrored),
    }
}

/// A grid of rotations with precomputed tables.
pub(crate) struct So3Grid {
    bandwidth: usize,
    /// Wigner's d matrices for each value of the second Euler angle, `be`, and each degree l. Each matrix is stored as
    /// (2l + 1, 2l + 1), row by row.
    wigner: Vec<Vec<Vec<f64>>>,
    fft: Arc<dyn Fft<f64>>,
}

/// A rotation of the grid at which the score has a local maximum.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Peak {
    pub(crate) rotation: Rotation,
    /// Maximum of `tr Q^T M` over the allowed matrices Q.
    pub(crate) score: f64,
}

impl So3Grid {
    /// Creates a grid of bandwidth B, at least 2.
    pub(crate) fn new(bandwidth: usize) -> Self {
        let centre = Centre::new(bandwidth - 1);
        let quarters: Vec<Vec<f64>> = (0..bandwidth).map(|degree| dense(degree, &centre)).collect();
        let wigner = (0..bandwidth).into_par_iter().map(|at| {
            let beta = (at as f64 + 0.5) * PI / bandwidth as f64;
            quarters.iter().enumerate().map(|(degree, quarter)| wigner(degree, quarter, beta)).collect()
        });
        Self { bandwidth, wigner: wigner.collect(), fft: plan_forward(2 * bandwidth) }
    }

    /// Returns the best rotations R of the grid: the local maxima of `tr Q^T M(R)`, with M the correlation of `f` and
    /// `g` and Q the best allowed matrix for R. At most `most` maxima are returned, best first. Of maxima closer to
    /// each other than the grid's step, only the best is kept.
    pub(crate) fn peaks(&self, f: &[[f64; 3]], g: &[[f64; 3]], space: Space, most: usize) -> Vec<Peak> {
        let degrees = self.bandwidth.min(f.len().isqrt()).min(g.len().isqrt());
        let (f, g) = (complex(f, degrees), complex(g, degrees));
        let scores: Vec<Vec<f64>> = (0..self.bandwidth)
            .into_par_iter()
            .map(|at| self.matrices(at, &f, &g).iter().map(|m| score(m, space)).collect())
            .collect();
        let n = 2 * self.bandwidth;
        let mut found = Vec::new();
        for (b, layer) in scores.iter().enumerate() {
            for (cell, &score) in layer.iter().enumerate() {
                let (a, c) = (cell % n, cell / n);
                let around =
                    [(a + 1) % n + c * n, (a + n - 1) % n + c * n, a + (c + 1) % n * n, a + (c + n - 1) % n * n];
                let beside = [b.wrapping_sub(1), b + 1];
                let higher = around.iter().any(|&other| layer[other] > score)
                    || beside.iter().any(|&other| scores.get(other).is_some_and(|layer| layer[cell] > score));
                if !higher {
                    found.push((score, [a, b, c]));
                }
            }
        }
        // Ties are broken by the order of the grid points.
        found.sort_by(|x, y| y.0.total_cmp(&x.0).then(x.1.cmp(&y.1)));
        let near = PI / self.bandwidth as f64;
        let mut peaks: Vec<Peak> = Vec::new();
        for (score, at) in found {
            let rotation = self.rotation(at);
            // Near `be = 0` and `be = pi`, many points of the grid are nearly the same rotation.
            if peaks.iter().all(|peak| (peak.rotation.inverse() * rotation).angle() > near) {
                peaks.push(Peak { rotation, score });
            }
            if peaks.len() == most {
                break;
            }
        }
        peaks
    }

    /// Returns the rotation of a grid point, given the indices of its Euler angles `al`, `be` and `ga`.
    fn rotation(&self, [a, b, c]: [usize; 3]) -> Rotation {
        let step = PI / self.bandwidth as f64;
        Rotation::from_euler(a as f64 * step, (b as f64 + 0.5) * step, c as f64 * step).unwrap_or_default()
    }

    /// Returns the correlations M at the grid points whose Euler angle `be` has the index `at`, as a row-major array
    /// over the Euler angles (`ga`, `al`).
    fn matrices(&self, at: usize, f: &[Vec<[Complex64; 3]>], g: &[Vec<[Complex64; 3]>]) -> Vec<Matrix3> {
        let n = 2 * self.bandwidth;
        let mut planes = vec![Complex64::ZERO; 9 * n * n];
        for (l, (f, g)) in f.iter().zip(g).enumerate().skip(1) {
            let side = 2 * l + 1;
            for (row, g) in g.iter().enumerate() {
                let m = (row + n - l) % n;
                for (column, f) in f.iter().enumerate() {
                    let cell = m * n + (column + n - l) % n;
                    let d = self.wigner[at][l][row * side + column];
                    for i in 0..3 {
                        let weighted = g[i].conj() * d;
                        for j in 0..3 {
                            planes[(3 * i + j) * n * n + cell] += weighted * f[j];
                        }
                    }
                }
            }
        }
        let mut matrices = vec![[[0.0; 3]; 3]; n * n];
        let mut turned = vec![Complex64::ZERO; n * n];
        let mut scratch = vec![Complex64::ZERO; self.fft.get_inplace_scratch_len()];
        for (element, plane) in planes.chunks_exact_mut(n * n).enumerate() {
            self.fft.process_with_scratch(plane, &mut scratch);
            for (row, values) in plane.chunks_exact(n).enumerate() {
                for (column, &value) in values.iter().enumerate() {
                    turned[column * n + row] = value;
                }
            }
            self.fft.process_with_scratch(&mut turned, &mut scratch);
            for (matrix, value) in matrices.iter_mut().zip(&turned) {
                matrix[element / 3][element % 3] = value.re;
            }
        }
        matrices
    }
}

/// Returns the complex coefficients of three real functions: a list for each degree l, with the orders m from -l to l.
fn complex(values: &[[f64; 3]], degrees: usize) -> Vec<Vec<[Complex64; 3]>> {
    let of_degree = |l: usize| {
        let mut out = vec![[Complex64::ZERO; 3]; 2 * l + 1];
        for c in 0..3 {
            out[l][c] = Complex64::new(values[l * l + l][c], 0.0);
            for m in 1..=l {
                let sign = if m % 2 == 0 { 1.0 } else { -1.0 };
                let value =
                    Complex64::new(values[l * l + l + m][c], -values[l * l + l - m][c]) * (sign * FRAC_1_SQRT_2);
                (out[l + m][c], out[l - m][c]) = (value, value.conj() * sign);
            }
        }
        out
    };
    (0..degrees).map(of_degree).collect()
}

/// Returns Wigner's matrix d^l(be), with rows m and columns m', row by row.
fn wigner(degree: usize, quarter: &[f64], beta: f64) -> Vec<f64> {
    let (l, side) = (degree as isize, 2 * degree + 1);
    let delta = |k: isize, m: isize| {
        let value = quarter[k.unsigned_abs() * (degree + 1) + m.unsigned_abs()];
        let odd = (m < 0 && (l + k) % 2 != 0) != (k < 0 && (l - m) % 2 != 0);
        if odd { -value } else { value }
    };
    let element = |m: isize, n: isize| -> f64 {
        (-l..=l).map(|k| (FRAC_PI_2 * (m - n) as f64 - beta * k as f64).cos() * delta(k, m) * delta(k, n)).sum()
    };
    (0..side * side).map(|at| element((at / side) as isize - l, (at % side) as isize - l)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::half_turn::Workspace;
    use crate::rotate::Rotator;

    fn surface(seed: f64) -> Vec<[f64; 3]> {
        (0..36).map(|k| [0, 1, 2].map(|c| ((k * 7 + c * 3) as f64 * seed).sin() / (1.0 + k as f64))).collect()
    }

    #[test]
    fn matrices_are_those_of_direct_rotations() {
        let (f, g, grid) = (surface(0.37), surface(0.91), So3Grid::new(6));
        let (rotator, mut workspace) = (Rotator::new(5), Workspace::default());
        for b in [0, 2, 5] {
            let matrices = grid.matrices(b, &complex(&f, 6), &complex(&g, 6));
            for (a, c) in [(0, 0), (3, 7), (11, 1)] {
                let mut turned = vec![[0.0; 3]; 36];
                rotator.rotate(&f, &grid.rotation([a, b, c]), &mut turned, &mut workspace);
                for i in 0..3 {
                    for j in 0..3 {
                        let direct: f64 = (1..36).map(|k| g[k][i] * turned[k][j]).sum();
                        assert!((matrices[c * 12 + a][i][j] - direct).abs() < 1e-14, "{a} {b} {c} {i} {j}");
                    }
                }
            }
        }
    }
}
