//! Computes the sums over rings, in small tiles of the Gram matrix that are eight orders m wide.
//!
//! With the Legendre functions P and the sums W of Fourier coefficients on ring j (see [`gram`](super)), for a fixed
//! order m' of the column, and s, s' in {cos, sin},
//!
//! ```text
//! G[(l, m, s), (l', m', s')] = sum_j P_{l,m}(j) W_{m,m'}^{s,s'}(j) P_{l',m'}(j).
//! ```
//!
//! Each lane of a vector holds an order m, and the rows of the matrix are stored in the same sequence. Up to three
//! degrees l of equal parity, two l' of equal parity and the four (s, s') make a tile of 24 sums in registers. A step
//! along the rings loads 9 vectors and performs 4 additions for W, 8 products with P_{l',m'}(j) and 24 fused products.
//! The rate is two thirds of that of a matrix product's kernel, but no packing, scaled copies of the tables or
//! scattering of results are needed. Over all rings, a tile loads 45 kB at degree 100, about the size of an L1 cache.
//! Every sum runs over the rings in the same order in any tile, so its bits don't depend on the tiling.

use std::ops::Range;

use multiversion::{multiversion, target::match_target};

/// Number of orders in a vector.
pub(super) const LANES: usize = 8;
/// Largest number of degrees l in a tile.
pub(super) const ROWS: usize = 3;
/// Number of combinations (s, s') of cosine and sine, in the order (cos, cos), (sin, cos), (cos, sin), (sin, sin).
pub(super) const KINDS: usize = 4;

/// Values of eight orders, aligned so that no load straddles cache lines.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct Lanes(pub(super) [f64; LANES]);

/// The matrix rows of one degree l.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row<'a> {
    pub(super) degree: usize,
    /// Values `P_{l,m}(j)` (blocks of eight orders, rings).
    pub(super) legendre: &'a [Lanes],
}

/// The measure's Fourier coefficients c and d (see [`gram`](super)), for one order m' and one parity of l + l'.
#[derive(Debug, Clone, Copy)]
pub(super) struct Waves<'a> {
    /// For each k, ascending, and each ring, a window of the eight Fourier coefficients `c_k .. c_{k+7}`; array (k,
    /// rings). In the same layout, the field `sine` contains `d_k .. d_{k+7}`.
    pub(super) cosine: &'a [Lanes],
    pub(super) sine: &'a [Lanes],
    /// Index of the window at k = -m'. `plus` is the index of the window at k = m'.
    pub(super) minus: usize,
    pub(super) plus: usize,
}

/// The factors of a tile of R degrees l and C degrees l', on all rings.
#[derive(Debug, Clone, Copy)]
struct Factors<'a, const R: usize, const C: usize> {
    /// For each degree l, the values `P_{l,m}` of eight orders on each ring.
    legendre: [&'a [Lanes]; R],
    /// For each degree l', the values `P_{l',m'}` on each ring.
    columns: [&'a [f64]; C],
    /// Halves of the Fourier coefficients, `c_{m-m'}`, `c_{m+m'}`, `d_{m-m'}` and `d_{m+m'}`, for eight orders on each
    /// ring; see [`gram`](super).
    waves: [&'a [Lanes]; 4],
}

/// The sums of a tile: eight lanes for each row degree l, column degree l', and combination (s, s') of cosine and sine.
type Tile<const R: usize, const C: usize> = [[[[f64; LANES]; KINDS]; C]; R];

/// Returns the index at which [`products`] writes the sums for the row degree with index `row`, the column degree with
/// index `column`, and the combination `kind` of cosine and sine. The sums for the `blocks` blocks of orders follow
/// each other from this index on.
#[inline(always)]
pub(super) fn strip(row: usize, columns: usize, column: usize, kind: usize, blocks: usize) -> usize {
    ((row * columns + column) * KINDS + kind) * blocks
}

/// Computes the sums over rings (see the [module](self)) for `blocks`, a range of blocks of eight orders m. There are
/// at most [`ROWS`] rows, of ascending degree. `columns` contains the values P_{l',m'} at the `rings` rings. The
/// results go to `sums` (row, column, kind, block); see [`strip`].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn products(
    rows: &[Row<'_>],
    columns: &[&[f64]],
    waves: Waves<'_>,
    rings: usize,
    blocks: Range<usize>,
    sums: &mut [[f64; LANES]],
) {
    // 24 sums of eight lanes fit in the 32 registers of AVX-512, and 12 sums of four lanes in the 16 registers of AVX2.
    let together = match_target! { "x86_64+avx512f" => 2, _ => 1 };
    for block in blocks.clone() {
        let (minus, plus) = ((waves.minus + block * LANES) * rings, (waves.plus + block * LANES) * rings);
        let waves = [
            &waves.cosine[minus..][..rings],
            &waves.cosine[plus..][..rings],
            &waves.sine[minus..][..rings],
            &waves.sine[plus..][..rings],
        ];
        // Rows of degrees below the block's first order have no functions in the block. These rows come first.
        let none = rows.iter().filter(|row| row.degree < block * LANES).count();
        let legendre = |i: usize| &rows[none + i].legendre[block * rings..][..rings];
        for first in (0..columns.len()).step_by(together) {
            macro_rules! tile {
                ($rows:literal, $columns:literal) => {{
                    let legendre: [_; $rows] = std::array::from_fn(legendre);
                    let columns_of: [_; $columns] = std::array::from_fn(|i| columns[first + i]);
                    let factors = Factors { legendre, columns: columns_of, waves };
                    let tile = match_target! {
                        "x86_64+avx512f" => x86::avx512(factors),
                        "x86_64+avx2+fma" => x86::avx2(factors),
                        _ => plain(factors),
                    };
                    for (r, tile) in tile.iter().enumerate() {
                        for (c, tile) in tile.iter().enumerate() {
                            for (kind, &lanes) in tile.iter().enumerate() {
                                let at = strip(none + r, columns.len(), first + c, kind, blocks.len());
                                sums[at + block - blocks.start] = lanes;
                            }
                        }
                    }
                }};
            }
            match (rows.len() - none, together == 2 && first + 1 < columns.len()) {
                (1, false) => tile!(1, 1),
                (2, false) => tile!(2, 1),
                (3, false) => tile!(3, 1),
                (1, true) => tile!(1, 2),
                (2, true) => tile!(2, 2),
                (3, true) => tile!(3, 2),
                _ => {}
            }
        }
    }
}

/// Computes a tile without vector instructions, for processors without a special kernel and as the reference in
/// tests.
fn plain<const R: usize, const C: usize>(factors: Factors<'_, R, C>) -> Tile<R, C> {
    let Factors { legendre, columns, waves } = factors;
    let mut tile = [[[[0.0; LANES]; KINDS]; C]; R];
    for j in 0..waves[0].len() {
        for lane in 0..LANES {
            let [c_minus, c_plus, d_minus, d_plus] = waves.map(|wave| wave[j].0[lane]);
            let weights = [c_minus + c_plus, d_plus + d_minus, d_plus - d_minus, c_minus - c_plus];
            for (tile, p) in tile.iter_mut().zip(legendre) {
                for (tile, x) in tile.iter_mut().zip(columns) {
                    for (sums, w) in tile.iter_mut().zip(weights) {
                        sums[lane] += p[j].0[lane] * (w * x[j]);
                    }
                }
            }
        }
    }
    tile
}

/// Computes tiles with the processor's vector instructions. The code that the compiler generates from the plain form
/// moves the 24 sums between registers, and is 15 times slower.
#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256d, __m512d, _mm256_add_pd, _mm256_fmadd_pd, _mm256_mul_pd, _mm256_set1_pd, _mm256_sub_pd, _mm512_add_pd,
        _mm512_fmadd_pd, _mm512_mul_pd, _mm512_set1_pd, _mm512_sub_pd,
    };

    use bytemuck::must_cast;

    use super::{Factors, KINDS, LANES, Tile};

    macro_rules! tile_for {
        ($name:ident, $features:literal, $vector:ty, [$all:ident, $plus:ident, $minus:ident, $times:ident, $fused:ident]) => {
            #[target_feature(enable = $features)]
            pub(super) fn $name<const R: usize, const C: usize>(factors: Factors<'_, R, C>) -> Tile<R, C> {
                /// Number of SIMD vectors that hold the [`LANES`] orders m. `WIDTH` is the number of orders per vector.
                const PARTS: usize = 8 * LANES / size_of::<$vector>();
                const WIDTH: usize = LANES / PARTS;
                let Factors { mut legendre, mut columns, mut waves } = factors;
                let rings = waves[0].len();
                // The arrays are sliced once, so that no bounds are checked along the rings. Loops are used instead
                // of closures, which the compiler doesn't inline here.
                for legendre in &mut legendre {
                    *legendre = &legendre[..rings];
                }
                for column in &mut columns {
                    *column = &column[..rings];
                }
                for wave in &mut waves {
                    *wave = &wave[..rings];
                }
                let mut tile = [[[[0.0; LANES]; KINDS]; C]; R];
                for part in 0..PARTS {
                    let mut sums = [[[$all(0.0); KINDS]; C]; R];
                    for j in 0..rings {
                        let mut p = [$all(0.0); R];
                        for (p, legendre) in p.iter_mut().zip(legendre) {
                            *p = must_cast::<_, [$vector; PARTS]>(legendre[j].0)[part];
                        }
                        let mut w = [$all(0.0); 4];
                        for (w, wave) in w.iter_mut().zip(waves) {
                            *w = must_cast::<_, [$vector; PARTS]>(wave[j].0)[part];
                        }
                        let [c_minus, c_plus, d_minus, d_plus] = w;
                        let weights = [
                            $plus(c_minus, c_plus),
                            $plus(d_plus, d_minus),
                            $minus(d_plus, d_minus),
                            $minus(c_minus, c_plus),
                        ];
                        for c in 0..C {
                            let x = $all(columns[c][j]);
                            for kind in 0..KINDS {
                                let v = $times(weights[kind], x);
                                for r in 0..R {
                                    sums[r][c][kind] = $fused(p[r], v, sums[r][c][kind]);
                                }
                            }
                        }
                    }
                    for r in 0..R {
                        for c in 0..C {
                            for kind in 0..KINDS {
                                let lanes: [f64; WIDTH] = must_cast(sums[r][c][kind]);
                                tile[r][c][kind][part * WIDTH..][..WIDTH].copy_from_slice(&lanes);
                            }
                        }
                    }
                }
                tile
            }
        };
    }
    tile_for!(
        avx512,
        "avx512f",
        __m512d,
        [_mm512_set1_pd, _mm512_add_pd, _mm512_sub_pd, _mm512_mul_pd, _mm512_fmadd_pd]
    );
    tile_for!(
        avx2,
        "avx2,fma",
        __m256d,
        [_mm256_set1_pd, _mm256_add_pd, _mm256_sub_pd, _mm256_mul_pd, _mm256_fmadd_pd]
    );
}

#[cfg(test)]
mod tests {
    use super::*;

    fn value(i: usize) -> f64 {
        ((i * i) as f64).sin()
    }

    fn lanes(from: usize, count: usize) -> Vec<Lanes> {
        (0..count).map(|i| Lanes(std::array::from_fn(|lane| value(from + i * LANES + lane)))).collect()
    }

    /// Compares the vector kernels with the plain form, for every shape of a tile.
    #[test]
    fn every_shape_agrees_with_the_plain_tile() {
        let rings = 5;
        let legendre = lanes(0, ROWS * 2 * rings);
        let columns: Vec<f64> = (0..3 * rings).map(|i| value(i + 9)).collect();
        let (cosine, sine) = (lanes(77, 20 * rings), lanes(777, 20 * rings));
        let waves = Waves { cosine: &cosine, sine: &sine, minus: 2, plus: 11 };
        for count in 1..=ROWS {
            // The first row, of degree 6, has no orders in the second block, which begins with order 8.
            let row = |r: usize| Row { degree: 6 + 2 * r, legendre: &legendre[r * 2 * rings..][..2 * rings] };
            let rows: Vec<_> = (0..count).map(row).collect();
            for width in 1..=3 {
                let columns: Vec<_> = columns.chunks_exact(rings).take(width).collect();
                let mut sums = vec![[7.0; LANES]; count * width * KINDS * 2];
                products(&rows, &columns, waves, rings, 0..2, &mut sums);
                for (at, found) in sums.iter().enumerate() {
                    let (block, kind) = (at % 2, at / 2 % KINDS);
                    let (column, row) = (at / 2 / KINDS % width, at / 2 / KINDS / width);
                    let wave = |(wave, k): (&'static str, usize)| {
                        let wave = if wave == "cosine" { &cosine } else { &sine };
                        &wave[(k + block * LANES) * rings..][..rings]
                    };
                    let expected = plain(Factors {
                        legendre: [&rows[row].legendre[block * rings..][..rings]],
                        columns: [columns[column]],
                        waves: [("cosine", 2), ("cosine", 11), ("sine", 2), ("sine", 11)].map(wave),
                    });
                    let empty = rows[row].degree < block * LANES;
                    for (found, expected) in found.iter().zip(expected[0][0][kind]) {
                        assert!((found - if empty { 7.0 } else { expected }).abs() < 1e-15 * rings as f64);
                    }
                }
            }
        }
    }

    /// Runs the AVX2 kernel if the processor has AVX2, even if it also has wider vectors.
    #[multiversion(targets("x86_64+avx2+fma"))]
    fn narrow(factors: Factors<'_, 3, 1>) -> Tile<3, 1> {
        match_target! {
            "x86_64+avx2+fma" => x86::avx2(factors),
            _ => plain(factors),
        }
    }

    #[test]
    fn four_lanes_agree_with_eight() {
        let rings = 9;
        let (legendre, waves) = (lanes(0, 3 * rings), lanes(300, 4 * rings));
        let columns: Vec<f64> = (0..rings).map(value).collect();
        let factors = Factors {
            legendre: std::array::from_fn(|r| &legendre[r * rings..][..rings]),
            columns: [&columns],
            waves: std::array::from_fn(|k| &waves[k * rings..][..rings]),
        };
        let (found, expected) = (narrow(factors), plain(factors));
        let flat = |tile: Tile<3, 1>| tile.as_flattened().as_flattened().as_flattened().to_vec();
        for (found, expected) in flat(found).iter().zip(flat(expected)) {
            assert!((found - expected).abs() < 1e-15 * rings as f64, "{found} {expected}");
        }
    }
}
