//! Models the costs of the steps of a least-squares fit: a product with the normal matrix, computed from the samples or
//! from their moments; computing the moments; and computing a Cholesky factor of the normal matrix and solving with it.
//!
//! Costs are times in nanoseconds on one thread, computed from the rates in `limits`; only their ratios matter. At
//! 40,962 samples and L = 100, a product of the normal matrix with three channels (columns) of coefficients takes 8.4
//! ms if computed from the samples, and 2.0 ms if computed from their moments. Computing the moments takes 20 ms. At
//! 10^6 samples and L = 1,000 a product with one channel takes 0.33 s by either method.

use spharm_harmonics::basis_size;
use spharm_transform::FINEST;

use super::limits::{
    COARSEST_MOMENT_ACCURACY, DENSE_FLOPS_PER_NS, FACTOR_BYTES_PER_NS, GRID_NS, MAKING_GRID_NS, MAKING_ORDER_NS,
    MAKING_SAMPLE_NS, MOMENT_ACCURACY_PER_TOLERANCE, MOMENT_GRID_NS, MOMENT_ORDER_NS, ORDER_NS,
    PAYING_PER_EXPECTED_ITERATIONS, PRODUCTS_PER_DENSITY_ITERATION, SAMPLE_CHANNEL_NS, SAMPLE_NS,
    SAMPLES_PER_DEGREE_SQUARED_FOR_SHARED_GRID,
};

/// Sizes that determine the costs of a fit.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cost {
    pub(super) rows: usize,
    /// Number of rows with nonzero weight, which determines the number of iterations.
    pub(super) rows_with_weight: usize,
    pub(super) max_degree: usize,
    pub(super) channels: usize,
}

impl Cost {
    /// Returns the cost of a product with the normal matrix by samples. For each sample, the values of the
    /// interpolation kernel are computed once for all channels, and each channel is summed with these values as
    /// weights. In addition, a grid is transformed for each channel.
    fn by_samples(&self) -> f64 {
        let (n, l, c) = self.sizes();
        n * (SAMPLE_NS + SAMPLE_CHANNEL_NS * c) + c * (GRID_NS * l * l * l.log2() + ORDER_NS * l.powi(3))
    }

    /// Returns the cost of a product with the normal matrix by moments: Legendre sums and Fourier transforms.
    pub(super) fn by_moments(&self) -> f64 {
        let (_, l, c) = self.sizes();
        c * (MOMENT_ORDER_NS * l.powi(3) + MOMENT_GRID_NS * l * l * l.log2())
    }

    /// Returns the cost of a product with the normal matrix by moments, plus the cost of a product with the inverse of
    /// the density.
    pub(super) fn preconditioned(&self) -> f64 {
        PRODUCTS_PER_DENSITY_ITERATION * self.by_moments()
    }

    /// Returns the cost of computing the moments and the normal operator from them.
    pub(super) fn making(&self) -> f64 {
        let (n, l, _) = self.sizes();
        MAKING_SAMPLE_NS * n + MAKING_GRID_NS * l * l * (2.0 * l).log2() + MAKING_ORDER_NS * l.powi(3)
    }

    /// Returns the cost of computing a factor of the normal matrix.
    pub(super) fn factor(&self) -> f64 {
        (basis_size(self.max_degree) as f64).powi(3) / 3.0 / DENSE_FLOPS_PER_NS
    }

    /// Returns the cost of a solve with a factor, plus the cost of computing the gradient and the residual. The solve
    /// reads the factor's `4 K^2` bytes twice.
    pub(super) fn with_factor(&self) -> f64 {
        let entries = (basis_size(self.max_degree) as f64).powi(2);
        let (flops, bytes) = (2.0 * entries * self.channels as f64, 8.0 * entries);
        flops / DENSE_FLOPS_PER_NS + bytes / FACTOR_BYTES_PER_NS + 0.5 * self.by_samples()
    }

    /// Returns the number of iterations after which the time saved by moments exceeds the time for computing them;
    /// infinite if moments never save time.
    pub(super) fn paid_after(&self) -> f64 {
        let saved = self.by_samples() - self.by_moments();
        if saved > 0.0 { self.making() / saved } else { f64::INFINITY }
    }

    /// Returns the expected number of iterations until a tolerance is met on a random sampling. By the law of Marchenko
    /// and Pastur, the eigenvalues of its normal matrix lie between (1 - (K / n)^(1/2))^2 and (1 + (K / n)^(1/2))^2,
    /// and each iteration reduces the error by a factor of (n / K)^(1/2). Here n is the number of rows with nonzero
    /// weight. Even samplings take half as many iterations.
    pub(super) fn expected_iterations(&self, tolerance: f64) -> f64 {
        let ratio = basis_size(self.max_degree) as f64 / self.rows_with_weight.max(1) as f64;
        if ratio < 1.0 { 2.0 * tolerance.ln() / ratio.ln() } else { f64::INFINITY }
    }

    /// Returns whether moments should be computed before the first iteration, because they pay off early enough within
    /// the expected number of iterations.
    pub(super) fn at_once(&self, tolerance: f64) -> bool {
        self.paid_after() <= PAYING_PER_EXPECTED_ITERATIONS * self.expected_iterations(tolerance)
    }

    fn sizes(&self) -> (f64, f64, f64) {
        (self.rows as f64, (self.max_degree + 1) as f64, self.channels as f64)
    }
}

/// Returns whether [`MatrixFreeOperator::with_moments`](crate::MatrixFreeOperator::with_moments) saves time, according
/// to the cost model. The operator and the moments then share a grid, which is larger than the operator's own grid. For
/// one channel, the shared grid saves 10 to 25 % of the time under two conditions. Iterations on n = `rows` samples to
/// `tolerance` must use moments from the start, and n must be so large that sorting the samples twice costs more than
/// the larger grid. With fewer samples the larger grid's memory costs more time than it saves. For 6 to 48 channels the
/// shared grid took 10 to 40 % longer at degrees from 50 to 400.
pub fn moments_pay(rows: usize, max_degree: usize, channels: usize, tolerance: f64) -> bool {
    let many = rows >= SAMPLES_PER_DEGREE_SQUARED_FOR_SHARED_GRID * max_degree * max_degree;
    channels == 1 && many && Cost { rows, rows_with_weight: rows, max_degree, channels }.at_once(tolerance)
}

/// Returns the relative accuracy of moments that a fit to a tolerance needs.
pub fn moment_accuracy(tolerance: f64) -> f64 {
    (MOMENT_ACCURACY_PER_TOLERANCE * tolerance).clamp(FINEST, COARSEST_MOMENT_ACCURACY)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cost(rows: usize, max_degree: usize, channels: usize) -> Cost {
        Cost { rows, rows_with_weight: rows, max_degree, channels }
    }

    #[test]
    fn many_samples_ask_for_moments_and_few_dont() {
        for (rows, max_degree) in [(1_000_000, 100), (10_000_000, 500), (10_000_000, 1_000)] {
            let cost = cost(rows, max_degree, 1);
            assert!(cost.paid_after() < cost.expected_iterations(1e-10), "{cost:?}");
        }
        assert!(cost(100_000, 1_000, 1).paid_after() > 60.0);
    }

    /// Each iteration reduces the error by a factor of (n / K)^(1/2): with n / K = 100, ten iterations give ten digits.
    #[test]
    fn iterations_are_those_of_the_law() {
        assert!((cost(100 * 121, 10, 1).expected_iterations(1e-10) - 10.0).abs() < 1e-12);
        assert!((cost(10_000 * 121, 10, 1).expected_iterations(1e-12) - 6.0).abs() < 1e-12);
        assert!(cost(121, 10, 1).expected_iterations(1e-10).is_infinite());
        assert!(cost(0, 10, 1).expected_iterations(1e-10).is_infinite());
    }

    #[test]
    fn rows_of_weight_0_do_not_shorten_the_iterations() {
        let masked = Cost { rows_with_weight: 100, ..cost(12_100, 10, 1) };
        assert!(masked.expected_iterations(1e-10).is_infinite());
        assert_eq!(masked.paid_after(), cost(12_100, 10, 1).paid_after());
    }

    #[test]
    fn more_samples_than_coefficients_take_fewer_iterations() {
        let of = |rows: usize| cost(rows, 100, 1).expected_iterations(1e-10);
        assert!(of(10_000).is_infinite() && of(20_000) > of(1_000_000) && of(1_000_000) > 5.0);
    }
}
