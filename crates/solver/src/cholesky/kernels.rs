//! Kernels for triangular solves with few right-hand sides: they multiply a tile of the factor, or its transpose, by a
//! few columns, and solve with the triangular tiles on the diagonal.
//!
//! With few columns, a solve is bound by memory bandwidth. Therefore every kernel reads its tile once, in storage
//! order, and prefetches the next tile at the same time. Without prefetching, the processor waits for one page after
//! another: a pass over 208 MB on one thread then takes 28 ms instead of 10 ms. Values of f32 are widened in registers;
//! sums and right-hand sides are always f64. With `MANY` columns or more (`triangular.rs`), matrix products are faster.
//!
//! Tiles are column-major without gaps; right-hand sides (rows, c) are column-major.

use multiversion::{multiversion, target::target_cfg_f};
use spharm_store::prefetch;

/// Number of partial sums that are accumulated in parallel, as lanes of vector registers.
const LANES: usize = 8;

/// Scalar type of a tile's values.
pub(crate) trait Real: Copy + Send + Sync + 'static {
    fn widen(self) -> f64;
}

impl Real for f64 {
    #[inline(always)]
    fn widen(self) -> f64 {
        self
    }
}

impl Real for f32 {
    #[inline(always)]
    fn widen(self) -> f64 {
        f64::from(self)
    }
}

/// Kernels for tiles of one scalar type.
pub(crate) trait Kernels: Real {
    /// Computes `out -= tile y`: tile (rows, k), y (k, c), out (rows, c). The next tile to read starts `ahead` bytes
    /// after the start of this tile.
    fn subtract(tile: &[Self], rows: usize, y: &[f64], out: &mut [f64], channels: usize, ahead: isize);
    /// Computes `out -= tile^T x`: tile (rows, k), x (rows, c), out (k, c).
    fn subtract_transposed(tile: &[Self], rows: usize, x: &[f64], out: &mut [f64], channels: usize, ahead: isize);
    /// Computes `x = tile^-1 x`: tile (k, k) lower triangular, x (k, c).
    fn solve(tile: &[Self], x: &mut [f64], channels: usize);
    /// Computes `x = tile^-T x`: tile (k, k) lower triangular, x (k, c).
    fn solve_transposed(tile: &[Self], x: &mut [f64], channels: usize);
}

/// Calls a kernel for three columns at a time, and for the one or two columns that remain.
macro_rules! by_channels {
    ($channels:expr, $first:ident, $one:expr, $two:expr, $three:expr) => {{
        let mut $first = 0;
        while $first < $channels {
            match $channels - $first {
                1 => $one,
                2 => $two,
                _ => $three,
            }
            $first += 3;
        }
    }};
}

macro_rules! kernels {
    ($scalar:ty, $module:ident) => {
        mod $module {
            use super::*;
            kernels!(@ $scalar, 1, subtract_1, solve_1, solve_transposed_1);
            kernels!(@ $scalar, 2, subtract_2, solve_2, solve_transposed_2);
            kernels!(@ $scalar, 3, subtract_3, solve_3, solve_transposed_3);
            kernels!(@ $scalar, 1, transposed_1);
            kernels!(@ $scalar, 3, transposed_3);
        }

        impl Kernels for $scalar {
            fn subtract(tile: &[Self], rows: usize, y: &[f64], out: &mut [f64], channels: usize, ahead: isize) {
                let k = tile.len() / rows;
                by_channels!(
                    channels, at,
                    $module::subtract_1(tile, rows, &y[at * k..], &mut out[at * rows..], ahead),
                    $module::subtract_2(tile, rows, &y[at * k..], &mut out[at * rows..], ahead),
                    $module::subtract_3(tile, rows, &y[at * k..], &mut out[at * rows..], ahead)
                );
            }

            fn subtract_transposed(tile: &[Self], rows: usize, x: &[f64], out: &mut [f64], channels: usize, ahead: isize) {
                let k = tile.len() / rows;
                by_channels!(
                    channels, at,
                    $module::transposed_1(tile, rows, &x[at * rows..], &mut out[at * k..], ahead),
                    // Process two columns one after the other, because the compiler's code for two columns at once is
                    // slower.
                    for c in at..at + 2 {
                        $module::transposed_1(tile, rows, &x[c * rows..], &mut out[c * k..], ahead);
                    },
                    $module::transposed_3(tile, rows, &x[at * rows..], &mut out[at * k..], ahead)
                );
            }

            fn solve(tile: &[Self], x: &mut [f64], channels: usize) {
                let k = x.len() / channels;
                by_channels!(
                    channels, at,
                    $module::solve_1(tile, k, &mut x[at * k..]),
                    $module::solve_2(tile, k, &mut x[at * k..]),
                    $module::solve_3(tile, k, &mut x[at * k..])
                );
            }

            fn solve_transposed(tile: &[Self], x: &mut [f64], channels: usize) {
                let k = x.len() / channels;
                by_channels!(
                    channels, at,
                    $module::solve_transposed_1(tile, k, &mut x[at * k..]),
                    $module::solve_transposed_2(tile, k, &mut x[at * k..]),
                    $module::solve_transposed_3(tile, k, &mut x[at * k..])
                );
            }
        }
    };
    (@ $scalar:ty, $c:literal, $subtract:ident, $solve:ident, $solve_transposed:ident) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        pub(super) fn $subtract(tile: &[$scalar], rows: usize, y: &[f64], out: &mut [f64], ahead: isize) {
            if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                subtract::<$scalar, $c, true>(tile, rows, y, out, ahead);
            } else {
                subtract::<$scalar, $c, false>(tile, rows, y, out, ahead);
            }
        }

        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        pub(super) fn $solve(tile: &[$scalar], k: usize, x: &mut [f64]) {
            if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                solve::<$scalar, $c, true>(tile, k, x);
            } else {
                solve::<$scalar, $c, false>(tile, k, x);
            }
        }

        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        pub(super) fn $solve_transposed(tile: &[$scalar], k: usize, x: &mut [f64]) {
            if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                solve_transposed::<$scalar, $c, true>(tile, k, x);
            } else {
                solve_transposed::<$scalar, $c, false>(tile, k, x);
            }
        }
    };
    (@ $scalar:ty, $c:literal, $transposed:ident) => {
        #[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
        pub(super) fn $transposed(tile: &[$scalar], rows: usize, x: &[f64], out: &mut [f64], ahead: isize) {
            if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
                transposed::<$scalar, $c, true>(tile, rows, x, out, ahead);
            } else {
                transposed::<$scalar, $c, false>(tile, rows, x, out, ahead);
            }
        }
    };
}
kernels!(f64, double);
kernels!(f32, single);

/// Converts values from f32 to f64.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
pub(crate) fn widen(values: &[f32], wide: &mut [f64]) {
    for (wide, value) in wide.iter_mut().zip(values) {
        *wide = f64::from(*value);
    }
}

#[inline(always)]
fn subtract<S: Real, const C: usize, const FMA: bool>(
    tile: &[S],
    rows: usize,
    y: &[f64],
    out: &mut [f64],
    ahead: isize,
) {
    let k = tile.len() / rows;
    let mut columns = out.chunks_exact_mut(rows);
    let mut out: [&mut [f64]; C] = std::array::from_fn(|_| columns.next().unwrap_or_default());
    let mut quads = tile.chunks_exact(4 * rows);
    let mut j = 0;
    for quad in &mut quads {
        prefetch(quad, ahead);
        let a: [&[S]; 4] = std::array::from_fn(|i| &quad[i * rows..(i + 1) * rows]);
        let factors = std::array::from_fn(|i| std::array::from_fn(|c| -y[c * k + j + i]));
        axpys::<S, 4, C, FMA>(a, factors, &mut out);
        j += 4;
    }
    for column in quads.remainder().chunks_exact(rows) {
        axpys::<S, 1, C, FMA>([column], [std::array::from_fn(|c| -y[c * k + j])], &mut out);
        j += 1;
    }
}

#[inline(always)]
fn transposed<S: Real, const C: usize, const FMA: bool>(
    tile: &[S],
    rows: usize,
    x: &[f64],
    out: &mut [f64],
    ahead: isize,
) {
    let k = tile.len() / rows;
    let x: [&[f64]; C] = std::array::from_fn(|c| &x[c * rows..(c + 1) * rows]);
    let mut quads = tile.chunks_exact(4 * rows);
    let mut j = 0;
    for quad in &mut quads {
        prefetch(quad, ahead);
        let sums = dots::<S, 4, C, FMA>(std::array::from_fn(|i| &quad[i * rows..(i + 1) * rows]), x);
        for (i, sums) in sums.iter().enumerate() {
            for (c, sum) in sums.iter().enumerate() {
                out[c * k + j + i] -= sum;
            }
        }
        j += 4;
    }
    for column in quads.remainder().chunks_exact(rows) {
        let sums = dots::<S, 1, C, FMA>([column], x);
        for (c, sum) in sums[0].iter().enumerate() {
            out[c * k + j] -= sum;
        }
        j += 1;
    }
}

#[inline(always)]
fn solve<S: Real, const C: usize, const FMA: bool>(tile: &[S], k: usize, x: &mut [f64]) {
    let mut columns = x.chunks_exact_mut(k);
    let x: [&mut [f64]; C] = std::array::from_fn(|_| columns.next().unwrap_or_default());
    for (j, column) in tile.chunks_exact(k).enumerate() {
        let factors: [f64; C] = std::array::from_fn(|c| x[c][j] / column[j].widen());
        for c in 0..C {
            x[c][j] = factors[c];
            for (x, a) in x[c][j + 1..].iter_mut().zip(&column[j + 1..]) {
                *x = fused::<FMA>(a.widen(), -factors[c], *x);
            }
        }
    }
}

#[inline(always)]
fn solve_transposed<S: Real, const C: usize, const FMA: bool>(tile: &[S], k: usize, x: &mut [f64]) {
    for (j, column) in tile.chunks_exact(k).enumerate().rev() {
        let below: [&[f64]; C] = std::array::from_fn(|c| &x[c * k + j + 1..(c + 1) * k]);
        let sums = dots::<S, 1, C, FMA>([&column[j + 1..]], below);
        for c in 0..C {
            x[c * k + j] = (x[c * k + j] - sums[0][c]) / column[j].widen();
        }
    }
}

/// Computes `out_c += sum_j columns_j factors_jc`.
#[inline(always)]
fn axpys<S: Real, const J: usize, const C: usize, const FMA: bool>(
    columns: [&[S]; J],
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
                out[c][i] = fused::<FMA>(columns[j][i].widen(), factors[j][c], out[c][i]);
            }
        }
    }
}

/// Returns the inner products of J columns with C other columns. Each product is accumulated as `LANES` partial sums,
/// which are then added up.
#[inline(always)]
fn dots<S: Real, const J: usize, const C: usize, const FMA: bool>(columns: [&[S]; J], x: [&[f64]; C]) -> [[f64; C]; J] {
    let rows = x[0].len();
    let mut lanes = [[[0.0f64; LANES]; C]; J];
    let whole = rows - rows % LANES;
    let mut i = 0;
    while i < whole {
        let r: [[f64; LANES]; C] = std::array::from_fn(|c| load(x[c], i));
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
            let mut tail = 0.0;
            for i in whole..rows {
                tail += columns[j][i].widen() * x[c][i];
            }
            let l = &lanes[j][c];
            sums[j][c] = ((l[0] + l[4]) + (l[2] + l[6])) + ((l[1] + l[5]) + (l[3] + l[7])) + tail;
        }
    }
    sums
}

#[inline(always)]
fn load<S: Real>(values: &[S], start: usize) -> [f64; LANES] {
    let values = &values[start..start + LANES];
    std::array::from_fn(|lane| values[lane].widen())
}

/// Computes `a b + sum`, by a fused multiply-add if the processor has such an instruction.
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

    /// Compares the kernels with explicit sums. The numbers of rows, columns and channels cover all remainders modulo
    /// the kernels' step sizes.
    fn kernels_are_the_sums_written_out<S: Kernels>(narrow: fn(f64) -> S) {
        for rows in [1, 7, 8, 9, 23, 40] {
            for k in [1, 3, 4, 5, 11] {
                for channels in 1..=7 {
                    let tile: Vec<S> = filled(rows * k, 0.7).into_iter().map(narrow).collect();
                    let (y, x) = (filled(k * channels, 0.3), filled(rows * channels, 1.3));
                    let mut out = filled(rows * channels, 0.9);
                    S::subtract(&tile, rows, &y, &mut out, channels, 64);
                    let mut back = filled(k * channels, 0.4);
                    S::subtract_transposed(&tile, rows, &x, &mut back, channels, -4096);
                    for c in 0..channels {
                        for i in 0..rows {
                            let sum: f64 = (0..k).map(|j| tile[j * rows + i].widen() * y[c * k + j]).sum();
                            let start = ((c * rows + i) as f64 + 1.0) * 0.9;
                            assert!((out[c * rows + i] - start.sin() + sum).abs() < 1e-13);
                        }
                        for j in 0..k {
                            let sum: f64 = (0..rows).map(|i| tile[j * rows + i].widen() * x[c * rows + i]).sum();
                            let start = ((c * k + j) as f64 + 1.0) * 0.4;
                            assert!((back[c * k + j] - start.sin() + sum).abs() < 1e-13);
                        }
                    }
                }
            }
        }
        for k in [1, 2, 8, 9, 24, 31] {
            for channels in 1..=7 {
                let entry = |i: usize, j: usize| if i == j { 3.0 + i as f64 / 7.0 } else { ((i * 5 + j) as f64).sin() };
                let tile: Vec<S> =
                    (0..k * k).map(|at| narrow(if at % k < at / k { 0.0 } else { entry(at % k, at / k) })).collect();
                let start = filled(k * channels, 0.3);
                let (mut x, mut back) = (start.clone(), start.clone());
                S::solve(&tile, &mut x, channels);
                S::solve_transposed(&tile, &mut back, channels);
                let scale = x.iter().chain(&back).fold(1.0f64, |m, v| m.max(v.abs()));
                for c in 0..channels {
                    for i in 0..k {
                        let row: f64 = (0..=i).map(|j| tile[j * k + i].widen() * x[c * k + j]).sum();
                        let column: f64 = (i..k).map(|j| tile[i * k + j].widen() * back[c * k + j]).sum();
                        assert!((row - start[c * k + i]).abs() < 1e-13 * scale);
                        assert!((column - start[c * k + i]).abs() < 1e-13 * scale);
                    }
                }
            }
        }
    }

    #[test]
    fn double_and_single() {
        kernels_are_the_sums_written_out::<f64>(|value| value);
        kernels_are_the_sums_written_out::<f32>(|value| value as f32);
    }
}
