//! Computes products of a block of harmonics, and of the block's transpose, with a few columns.
//!
//! Both products read every value of the block once. With few columns (c), the products take 2 c flops per value and
//! are bound by memory bandwidth. Four columns of the block are processed together, so that the columns of the
//! residual, which stay in the L1 cache, are read and written a quarter as often. For eight columns or more a BLAS
//! matrix product is faster.
//!
//! Matrices are column-major slices with a leading dimension, as in the BLAS.

use multiversion::{multiversion, target::target_cfg_f};

/// Number of lanes of an accumulator: one AVX-512 register or two AVX2 registers. Several accumulators are used at
/// once, which hides the latency of their additions.
const LANES: usize = 8;

/// A column-major matrix in a slice, with entry (i, j) at index `j * leading + i`.
#[derive(Debug, Clone, Copy)]
pub struct Matrix<'a> {
    values: &'a [f64],
    rows: usize,
    columns: usize,
    leading: usize,
}

impl<'a> Matrix<'a> {
    /// Views `values` as a matrix whose columns start `leading` values apart; the last column needs only `rows` values.
    ///
    /// # Panics
    ///
    /// If the slice is too short, or `leading < rows`.
    pub fn new(values: &'a [f64], rows: usize, columns: usize, leading: usize) -> Self {
        assert!(leading >= rows, "leading dimension {leading} is below the number of rows, {rows}");
        let needed = columns.saturating_sub(1) * leading + if columns > 0 { rows } else { 0 };
        assert!(
            values.len() >= needed,
            "a matrix of {rows} x {columns} with leading dimension {leading} needs {needed} values, found {}",
            values.len()
        );
        Self { values, rows, columns, leading }
    }

    /// Returns the number of rows.
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Returns the number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Returns the leading dimension: the number of values from the start of a column to the start of the next.
    pub fn leading(&self) -> usize {
        self.leading
    }

    /// Returns the values of column `j`.
    ///
    /// # Panics
    ///
    /// If there is no column `j`.
    pub fn column(&self, j: usize) -> &'a [f64] {
        &self.values[j * self.leading..][..self.rows]
    }

    /// Returns the underlying slice, from entry (0, 0) on.
    pub fn values(&self) -> &'a [f64] {
        self.values
    }
}

/// Computes `out += block^T r` for block (rows, k), r (rows, c) and row-major out (k, c).
///
/// # Panics
///
/// If the shapes don't match.
pub fn accumulate_adjoint(block: Matrix<'_>, r: Matrix<'_>, out: &mut [f64]) {
    assert_eq!(block.rows, r.rows, "the block and the residual must have the same number of rows");
    assert_eq!(out.len(), block.columns * r.columns, "`out` must have shape (columns of the block, columns of r)");
    let channels = r.columns;
    for first in (0..channels).step_by(3) {
        match channels - first {
            1 => adjoint_1(block, r, first, out),
            2 => adjoint_2(block, r, first, out),
            _ => adjoint_3(block, r, first, out),
        }
    }
}

/// Computes `out += sign block x` for block (rows, k), row-major x (k, c) and column-major out (rows, c) with the
/// leading dimension `leading`.
///
/// # Panics
///
/// If the shapes don't match.
pub fn accumulate_synthesis(block: Matrix<'_>, x: &[f64], sign: f64, out: &mut [f64], leading: usize) {
    assert!(block.columns > 0 && x.len().is_multiple_of(block.columns), "x must have a row for each block column");
    let channels = x.len() / block.columns;
    for first in (0..channels).step_by(3) {
        let columns = &mut out[first * leading..];
        match channels - first {
            1 => synthesis_1(block, x, sign, columns, leading, first),
            2 => synthesis_2(block, x, sign, columns, leading, first),
            _ => synthesis_3(block, x, sign, columns, leading, first),
        }
    }
}

macro_rules! adjoint_for {
    ($name:ident, $channels:literal) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $name(block: Matrix<'_>, r: Matrix<'_>, first: usize, out: &mut [f64]) {
            const C: usize = $channels;
            let residual: [&[f64]; C] = std::array::from_fn(|c| r.column(first + c));
            let total = r.columns;
            let mut j = 0;
            while j + 4 <= block.columns {
                let columns: [&[f64]; 4] = std::array::from_fn(|k| block.column(j + k));
                let sums = if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                    dots::<4, C, true>(columns, residual)
                } else {
                    dots::<4, C, false>(columns, residual)
                };
                for (k, sums) in sums.iter().enumerate() {
                    for (c, sum) in sums.iter().enumerate() {
                        out[(j + k) * total + first + c] += sum;
                    }
                }
                j += 4;
            }
            while j < block.columns {
                let sums = dots::<1, C, false>([block.column(j)], residual);
                for (c, sum) in sums[0].iter().enumerate() {
                    out[j * total + first + c] += sum;
                }
                j += 1;
            }
        }
    };
}
adjoint_for!(adjoint_1, 1);
adjoint_for!(adjoint_2, 2);
adjoint_for!(adjoint_3, 3);

/// Returns the inner products of J columns with C other columns. Each inner product is summed in lanes and then across
/// the lanes, in the same order on any processor.
#[inline(always)]
fn dots<const J: usize, const C: usize, const FMA: bool>(columns: [&[f64]; J], residual: [&[f64]; C]) -> [[f64; C]; J] {
    let rows = residual[0].len();
    let mut lanes = [[[0.0f64; LANES]; C]; J];
    let whole = rows - rows % LANES;
    let mut i = 0;
    while i < whole {
        let r: [[f64; LANES]; C] = std::array::from_fn(|c| load(residual[c], i));
        for j in 0..J {
            let a = load(columns[j], i);
            for c in 0..C {
                for lane in 0..LANES {
                    lanes[j][c][lane] = fused::<FMA>(a[lane], r[c][lane], lanes[j][c][lane]);
                }
            }
        }
        i += LANES;
    }
    let mut sums = [[0.0; C]; J];
    for j in 0..J {
        for c in 0..C {
            let tail: f64 = (whole..rows).map(|i| columns[j][i] * residual[c][i]).sum();
            sums[j][c] = lanes[j][c].iter().sum::<f64>() + tail;
        }
    }
    sums
}

macro_rules! synthesis_for {
    ($name:ident, $channels:literal) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        fn $name(block: Matrix<'_>, x: &[f64], sign: f64, out: &mut [f64], leading: usize, first: usize) {
            const C: usize = $channels;
            let total = x.len() / block.columns;
            let mut rest = out;
            let out: [&mut [f64]; C] = std::array::from_fn(|c| {
                let step = leading.min(rest.len());
                let (column, tail) = std::mem::take(&mut rest).split_at_mut(if c + 1 < C { step } else { block.rows });
                rest = tail;
                &mut column[..block.rows]
            });
            let mut out = out;
            let mut j = 0;
            while j + 4 <= block.columns {
                let columns: [&[f64]; 4] = std::array::from_fn(|k| block.column(j + k));
                let factors = std::array::from_fn(|k| std::array::from_fn(|c| sign * x[(j + k) * total + first + c]));
                if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                    axpys::<4, C, true>(columns, factors, &mut out);
                } else {
                    axpys::<4, C, false>(columns, factors, &mut out);
                }
                j += 4;
            }
            while j < block.columns {
                let factors = [std::array::from_fn(|c| sign * x[j * total + first + c])];
                axpys::<1, C, false>([block.column(j)], factors, &mut out);
                j += 1;
            }
        }
    };
}
synthesis_for!(synthesis_1, 1);
synthesis_for!(synthesis_2, 2);
synthesis_for!(synthesis_3, 3);

/// Computes `out_c += sum_j columns_j factors_jc`.
#[inline(always)]
fn axpys<const J: usize, const C: usize, const FMA: bool>(
    columns: [&[f64]; J],
    factors: [[f64; C]; J],
    out: &mut [&mut [f64]; C],
) {
    let rows = columns[0].len();
    let whole = rows - rows % LANES;
    let mut i = 0;
    while i < whole {
        let a: [[f64; LANES]; J] = std::array::from_fn(|j| load(columns[j], i));
        for c in 0..C {
            let mut sum: [f64; LANES] = load(out[c], i);
            for j in 0..J {
                for lane in 0..LANES {
                    sum[lane] = fused::<FMA>(a[j][lane], factors[j][c], sum[lane]);
                }
            }
            out[c][i..i + LANES].copy_from_slice(&sum);
        }
        i += LANES;
    }
    for i in whole..rows {
        for c in 0..C {
            for j in 0..J {
                out[c][i] += columns[j][i] * factors[j][c];
            }
        }
    }
}

#[inline(always)]
fn load(values: &[f64], start: usize) -> [f64; LANES] {
    let mut lanes = [0.0; LANES];
    lanes.copy_from_slice(&values[start..start + LANES]);
    lanes
}

/// Computes `a b + sum`. With `FMA` the result is rounded once, by one instruction if the processor has it.
#[inline(always)]
fn fused<const FMA: bool>(a: f64, b: f64, sum: f64) -> f64 {
    if FMA { a.mul_add(b, sum) } else { a * b + sum }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn filled(count: usize, seed: f64) -> Vec<f64> {
        (0..count).map(|i| ((i as f64 + 1.0) * seed).sin()).collect()
    }

    /// Compares the products with explicit sums, for every remainder of rows, columns and channels modulo the kernels'
    /// steps.
    #[test]
    fn products_are_the_sums_written_out() {
        for rows in [1, 7, 8, 9, 23, 40] {
            for columns in [1, 3, 4, 5, 11] {
                for channels in 1..=7 {
                    let leading = rows + 3;
                    let a = filled(columns * leading, 0.7);
                    let r = filled(channels * leading, 1.3);
                    let block = Matrix::new(&a, rows, columns, leading);
                    let mut adjoint = vec![0.5; columns * channels];
                    accumulate_adjoint(block, Matrix::new(&r, rows, channels, leading), &mut adjoint);
                    let x = filled(columns * channels, 0.3);
                    let mut out = r.clone();
                    accumulate_synthesis(block, &x, -1.0, &mut out, leading);
                    for c in 0..channels {
                        for j in 0..columns {
                            let sum: f64 = (0..rows).map(|i| a[j * leading + i] * r[c * leading + i]).sum();
                            assert!((adjoint[j * channels + c] - 0.5 - sum).abs() < 1e-13);
                        }
                        for i in 0..leading {
                            let mut expected = r[c * leading + i];
                            if i < rows {
                                expected -= (0..columns).map(|j| a[j * leading + i] * x[j * channels + c]).sum::<f64>();
                            }
                            assert!((out[c * leading + i] - expected).abs() < 1e-13, "{rows} {columns} {channels}");
                        }
                    }
                }
            }
        }
    }
}
