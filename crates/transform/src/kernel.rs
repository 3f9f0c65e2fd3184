//! The interpolation kernel: Kaiser-Bessel, evaluated by piecewise polynomials.
//!
//! A function with frequencies `|k| <= L` on the circle is interpolated from a grid of `M > 2 L + 1` points as
//! `f(x) = sum_j g_j phi(j - x)`, with x in grid steps. The values `g` are samples of a function whose spectrum is the
//! spectrum of f divided by `p_k`, the transform of the kernel. With support of `w` grid points,
//!
//! ```text
//! phi(s) = I0(beta sqrt(1 - (2 s / w)^2)) / I0(beta)          |s| <= w / 2
//! p_k    = w sinh(r) / (r I0(beta)),   r = sqrt(beta^2 - (pi w k / M)^2)
//! beta   = pi w (1 - 1 / (2 sigma)),   sigma = M / (2 L + 1)
//! ```
//!
//! The relative error at frequency k comes from aliases: it is `sqrt(sum_{j != 0} p_{k+jM}^2) / p_k`, and is largest at
//! `k = L`. `beta` puts the first zero of the transform at the nearest alias; the error is two to ten times smaller
//! than with the exponential-of-semicircle kernel of the same width (measured over widths 4 to 16, sigma 1.2 to 2.5).
//! J. I. Jackson et al., "Selection of a convolution function for Fourier inversion using gridding", IEEE Trans. Med.
//! Imaging 10 (1991).
//!
//! `phi` is evaluated as one polynomial on each of the w grid steps. All w polynomials have the same argument, so a
//! single Horner scheme over lanes computes the w values of a point.

use multiversion::{multiversion, target::target_cfg_f};

/// Width of the widest kernel; a point's kernel values are padded to this number of lanes.
pub(crate) const MAX_WIDTH: usize = 16;
/// Number of Chebyshev nodes per piece, more than any accuracy needs.
const NODES: usize = 24;

/// A kernel of one width, for one grid.
#[derive(Debug, Clone)]
pub(crate) struct Kernel {
    /// Number of grid points under the kernel.
    pub(crate) width: usize,
    /// `width` rounded up to a multiple of four: 4, 8, 12 or 16.
    pub(crate) padded: usize,
    beta: f64,
    /// Polynomial coefficients, from the highest power to the lowest; lane k contains the piece over the k-th grid
    /// point under the kernel.
    coefficients: Vec<[f64; MAX_WIDTH]>,
}

impl Kernel {
    /// Creates the kernel of `width` points for frequencies up to `max_degree` on a grid of `grid` points.
    pub(crate) fn new(width: usize, max_degree: usize, grid: usize, accuracy: f64) -> Self {
        let beta = shape_parameter(width, max_degree, grid);
        let half = width as f64 / 2.0;
        // The pieces are analytic, so their Chebyshev coefficients decrease fast.
        let cosines: Vec<[f64; NODES]> = (0..NODES)
            .map(|n| std::array::from_fn(|i| (std::f64::consts::PI * n as f64 * (i as f64 + 0.5) / NODES as f64).cos()))
            .collect();
        let pieces: Vec<[f64; NODES]> = (0..width)
            .map(|piece| {
                // For an argument t in [-1, 1] the grid point is `piece + (t + 1) / 2` steps from the kernel's left
                // end.
                let values: [f64; NODES] = std::array::from_fn(|i| {
                    let s = (piece as f64 + (cosines[1][i] + 1.0) / 2.0) - half;
                    bessel_ratio(beta, 1.0 - (s / half) * (s / half))
                });
                std::array::from_fn(|n| {
                    let sum: f64 = values.iter().zip(&cosines[n]).map(|(v, c)| v * c).sum();
                    sum * if n == 0 { 1.0 } else { 2.0 } / NODES as f64
                })
            })
            .collect();
        let rest =
            |degree: usize| pieces.iter().map(|c| c[degree + 1..].iter().map(|c| c.abs()).sum()).fold(0.0, f64::max);
        // Division by the kernel's transform magnifies the polynomials' approximation errors by the same factor as
        // rounding errors.
        let enough = 0.1 * accuracy / magnification(width, max_degree, grid).max(1.0);
        let degree = (2..NODES - 1).find(|&degree| rest(degree) < enough).unwrap_or(NODES - 1);
        let mut coefficients = vec![[0.0; MAX_WIDTH]; degree + 1];
        for (piece, chebyshev) in pieces.iter().enumerate() {
            for (power, value) in monomials(&chebyshev[..=degree]).into_iter().enumerate() {
                coefficients[degree - power][piece] = value;
            }
        }
        Self { width, padded: width.next_multiple_of(4), beta, coefficients }
    }

    /// Returns the transform `p_k` of the kernel at frequency k, for a grid of `grid` points around the circle.
    pub(crate) fn transform(&self, k: usize, grid: usize) -> f64 {
        transform(self.width, self.beta, k as f64 / grid as f64)
    }

    /// Returns the first of the grid points under a point's kernel, and the argument of the kernel's polynomials. The
    /// point is at position `fraction` in cell `cell`. The index of the grid point may be negative, by up to half of
    /// the width.
    #[inline(always)]
    pub(crate) fn place(&self, cell: u32, fraction: f64) -> (isize, f64) {
        let cell = cell as isize - (self.width / 2) as isize;
        if self.width.is_multiple_of(2) {
            (cell + 1, 1.0 - 2.0 * fraction)
        } else if fraction < 0.5 {
            (cell, -2.0 * fraction)
        } else {
            (cell + 1, 2.0 - 2.0 * fraction)
        }
    }

    /// Evaluates the kernel at the grid points under it, for each argument. Lanes from `width` on are zero.
    pub(crate) fn values(&self, arguments: &[f64], values: &mut [[f64; MAX_WIDTH]]) {
        if self.padded <= 8 {
            horner_8(&self.coefficients, arguments, values);
        } else {
            horner_16(&self.coefficients, arguments, values);
        }
    }
}

macro_rules! horner_for {
    ($name:ident, $lanes:literal) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $name(coefficients: &[[f64; MAX_WIDTH]], arguments: &[f64], values: &mut [[f64; MAX_WIDTH]]) {
            // Two points are processed together, because each step of Horner's scheme has to wait for the previous
            // step.
            for (t, values) in arguments.chunks(2).zip(values.chunks_mut(2)) {
                let (t0, t1) = (t[0], t[t.len() - 1]);
                let (mut a, mut b) = ([0.0; $lanes], [0.0; $lanes]);
                for c in coefficients {
                    for lane in 0..$lanes {
                        if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                            a[lane] = t0.mul_add(a[lane], c[lane]);
                            b[lane] = t1.mul_add(b[lane], c[lane]);
                        } else {
                            a[lane] = t0 * a[lane] + c[lane];
                            b[lane] = t1 * b[lane] + c[lane];
                        }
                    }
                }
                let last = t.len() - 1;
                values[0][..$lanes].copy_from_slice(&a);
                values[last][..$lanes].copy_from_slice(&b);
            }
        }
    };
}
horner_for!(horner_8, 8);
horner_for!(horner_16, 16);

/// Returns the kernel's shape parameter beta.
fn shape_parameter(width: usize, max_degree: usize, grid: usize) -> f64 {
    let inverse_sigma = (2 * max_degree + 1) as f64 / grid as f64;
    std::f64::consts::PI * width as f64 * (1.0 - inverse_sigma / 2.0)
}

/// Returns the kernel's Fourier transform p at `xi = k / M`, without the factor `e^beta / I0(beta)`, which
/// `bessel_ratio` omits as well.
fn transform(width: usize, beta: f64, xi: f64) -> f64 {
    let w = width as f64;
    let square = beta * beta - (std::f64::consts::PI * w * xi).powi(2);
    let r = square.abs().sqrt();
    if r < 1e-9 {
        w * (-beta).exp()
    } else if square > 0.0 {
        w * ((r - beta).exp() - (-r - beta).exp()) / (2.0 * r)
    } else {
        w * r.sin() / r * (-beta).exp()
    }
}

/// Returns the relative aliasing error of a kernel at frequency L, where the error is largest.
pub(crate) fn aliasing(width: usize, max_degree: usize, grid: usize) -> f64 {
    let beta = shape_parameter(width, max_degree, grid);
    let xi = max_degree as f64 / grid as f64;
    let aliases: f64 = (1..=20)
        .flat_map(|j| [xi + f64::from(j), xi - f64::from(j)])
        .map(|xi| transform(width, beta, xi).powi(2))
        .sum();
    aliases.sqrt() / transform(width, beta, xi)
}

/// Returns the factor by which the grid's rounding errors are magnified when the spectrum is divided by the kernel's
/// Fourier transform. The magnification is largest at frequency L, where the transform is smallest.
pub(crate) fn magnification(width: usize, max_degree: usize, grid: usize) -> f64 {
    let beta = shape_parameter(width, max_degree, grid);
    transform(width, beta, 0.0) / transform(width, beta, max_degree as f64 / grid as f64)
}

/// Returns `I0(beta sqrt(square)) e^-beta`, an entire function of `square`. Rounding may make `square` slightly
/// negative.
fn bessel_ratio(beta: f64, square: f64) -> f64 {
    // I0(z) = sum (z^2 / 4)^k / k!^2 with z^2 = beta^2 `square`. No term is negative, unless rounding makes z^2
    // negative. About 60 terms suffice for beta <= 45.
    let quarter = beta * beta * square / 4.0;
    let (mut term, mut sum) = (1.0, 1.0);
    for k in 1..200 {
        term *= quarter / f64::from(k * k);
        sum += term;
        if term.abs() < 1e-17 * sum.abs() {
            break;
        }
    }
    sum * (-beta).exp()
}

/// Converts Chebyshev coefficients to monomial coefficients, from the lowest power to the highest.
fn monomials(chebyshev: &[f64]) -> Vec<f64> {
    let count = chebyshev.len();
    let mut result = vec![0.0; count];
    let (mut older, mut newest) = (vec![0.0; count], vec![0.0; count]);
    newest[0] = 1.0;
    for (n, c) in chebyshev.iter().enumerate() {
        for (r, t) in result.iter_mut().zip(&newest) {
            *r += c * t;
        }
        // T_{n+1} = 2 t T_n - T_{n-1}, T_1 = t T_0.
        let factor = if n == 0 { 1.0 } else { 2.0 };
        let mut next = vec![0.0; count];
        for power in 0..count {
            let shifted = if power > 0 { factor * newest[power - 1] } else { 0.0 };
            next[power] = shifted - older[power];
        }
        older = std::mem::replace(&mut newest, next);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that interpolation of single frequencies has the error estimated by `aliasing`, plus rounding errors.
    #[test]
    fn interpolates_to_its_aliasing_error() {
        for (width, grid) in [(4, 64), (7, 64), (8, 56), (13, 80), (16, 64), (16, 96)] {
            let max_degree = 20;
            let kernel = Kernel::new(width, max_degree, grid, 1e-15);
            let bound = aliasing(width, max_degree, grid);
            for k in [0, 1, 7, 20] {
                for fraction in [0.0, 0.1, 0.499, 0.5, 0.77, 0.999] {
                    let (first, t) = kernel.place(31, fraction);
                    let mut values = [[0.0; MAX_WIDTH]];
                    kernel.values(&[t], &mut values);
                    let angle = |x: f64| 2.0 * std::f64::consts::PI * k as f64 * x / grid as f64;
                    let sum: f64 = (0..width)
                        .map(|j| values[0][j] * angle((first + j as isize) as f64 - 31.0 - fraction).cos())
                        .sum();
                    let error = (sum / kernel.transform(k, grid) - 1.0).abs();
                    // `bound` is the root mean square of the error over all positions in a cell. The error at the worst
                    // position is sqrt 2 times as large, plus further terms.
                    assert!(
                        error < 3.0 * bound + 4e-15 * magnification(width, max_degree, grid),
                        "{width} {grid} {k}: {error:e} {bound:e}"
                    );
                }
            }
        }
    }
}
