//! The sums over rings: small tiles of the Gram matrix, eight orders m wide.
//!
//! For a fixed order m' of the column, and s, s' in {cos, sin},
//!
//! ```text
//! G[(l, m, s), (l', m', s')] = sum_j P_{l,m}(j) W_{m,m'}^{s,s'}(j) P_{l',m'}(j).
//! ```
//!
//! A lane is an order m, which is the order of the matrix' own rows. Up to three degrees l of equal parity, two l' of
//! equal parity and the four (s, s') make a tile of 24 sums in registers: a step along the rings loads 9 vectors,
//! multiplies W with the two P_{l',m'}(j), 8 products, and adds 24 fused products, so three quarters of the processor's
//! multipliers do what a matrix product would (measured: 55 to 60 GFLOP/s a core with AVX-512). For eight orders W and the three P fill 45 KB at degree 100, an L1 cache.
//! Every sum runs over the rings in the same order whatever tile it is in: its bits don't depend on the tiling.

use std::ops::Range;

use multiversion::{multiversion, target::match_target};

/// Orders in a vector.
pub(super) const LANES: usize = 8;
/// Degrees l that a tile takes.
pub(super) const ROWS: usize = 3;
/// (s, s') in the order (cos, cos), (sin, cos), (cos, sin), (sin, sin).
pub(super) const KINDS: usize = 4;

/// Eight orders, aligned so that no load straddles cache lines.
#[derive(Debug, Clone, Copy, Default)]
#[repr(align(64))]
pub(super) struct Lanes(pub(super) [f64; LANES]);

/// `W_{m,m'}` of eight orders m at one ring.
pub(super) type Weights = [Lanes; KINDS];

/// One degree of the rows.
#[derive(Debug, Clone, Copy)]
pub(super) struct Row<'a> {
    pub(super) degree: usize,
    /// `P_{l,m}(j)`: (blocks of eight orders, rings).
    pub(super) legendre: &'a [Lanes],
}

/// Where [`products`] puts the sum of row degree `row`, column degree `column`, `kind` and block `block`, of `blocks`.
#[inline(always)]
pub(super) fn strip(row: usize, columns: usize, column: usize, kind: usize, blocks: usize) -> usize {
    ((row * columns + column) * KINDS + kind) * blocks
}

/// What a tile of R degrees l and C degrees l' is made from, along the rings.
#[derive(Debug, Clone, Copy)]
struct Factors<'a, const R: usize, const C: usize> {
    /// `P_{l,m}` of eight orders, (rings).
    legendre: [&'a [Lanes]; R],
    /// `P_{l',m'}`, (rings).
    columns: [&'a [f64]; C],
    weights: &'a [Weights],
}

/// The sums of eight lanes: (l, l', kind).
type Tile<const R: usize, const C: usize> = [[[[f64; LANES]; KINDS]; C]; R];

/// Sums for the blocks of eight orders `blocks`: rows of at most [`ROWS`] degrees, ascending; `columns` hold P_{l',m'} at
/// the `rings` rings; `weights` (blocks from `origin` on, rings). `sums` (row, column, kind, block), see [`strip`].
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
pub(super) fn products(
    rows: &[Row<'_>],
    columns: &[&[f64]],
    weights: &[Weights],
    rings: usize,
    origin: usize,
    blocks: Range<usize>,
    sums: &mut [[f64; LANES]],
) {
    // 24 sums of eight lanes fit the 32 registers of AVX-512, 12 of four lanes the 16 of AVX2.
    let together = match_target! { "x86_64+avx512f" => 2, _ => 1 };
    for block in blocks.clone() {
        let weights = &weights[(block - origin) * rings..][..rings];
        // Degrees below the block's first order have no functions in it; they are the first ones.
        let none = rows.iter().filter(|row| row.degree < block * LANES).count();
        let legendre = |i: usize| &rows[none + i].legendre[block * rings..][..rings];
        for first in (0..columns.len()).step_by(together) {
            macro_rules! tile {
                ($rows:literal, $columns:literal) => {{
                    let legendre: [_; $rows] = std::array::from_fn(legendre);
                    let columns_of: [_; $columns] = std::array::from_fn(|i| &columns[first + i][..rings]);
                    let factors = Factors { legendre, columns: columns_of, weights };
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

/// A tile as one would write it down, for processors without a kernel of their own.
fn plain<const R: usize, const C: usize>(factors: Factors<'_, R, C>) -> Tile<R, C> {
    let mut sums = [[[[0.0; LANES]; KINDS]; C]; R];
    for (j, weights) in factors.weights.iter().enumerate() {
        for c in 0..C {
            for (kind, w) in weights.iter().enumerate() {
                let v = w.0.map(|w| w * factors.columns[c][j]);
                for r in 0..R {
                    let sums = sums[r][c][kind].iter_mut().zip(factors.legendre[r][j].0);
                    sums.zip(v).for_each(|((sum, p), v)| *sum += p * v);
                }
            }
        }
    }
    sums
}

/// Tiles with the processor's own vectors: left to itself, the compiler shuffles the 24 sums about and is 15 times slower.
#[cfg(target_arch = "x86_64")]
mod x86 {
    use std::arch::x86_64::{
        __m256d, __m512d, _mm256_fmadd_pd, _mm256_mul_pd, _mm256_set1_pd, _mm512_fmadd_pd, _mm512_mul_pd,
        _mm512_set1_pd,
    };

    use bytemuck::must_cast;

    use super::{Factors, KINDS, LANES, Tile};

    macro_rules! tile_for {
        ($name:ident, $features:literal, $vector:ty, $all:ident, $times:ident, $fused:ident) => {
            #[target_feature(enable = $features)]
            pub(super) fn $name<const R: usize, const C: usize>(factors: Factors<'_, R, C>) -> Tile<R, C> {
                /// Vectors in eight lanes.
                const PARTS: usize = 8 * LANES / size_of::<$vector>();
                let rings = factors.weights.len();
                // Told once, so that no bounds are checked along the rings. Loops in place of closures, which the compiler
                // does not inline here.
                let Factors { mut legendre, mut columns, weights } = factors;
                for legendre in &mut legendre {
                    *legendre = &legendre[..rings];
                }
                for column in &mut columns {
                    *column = &column[..rings];
                }
                let mut tile = [[[[0.0; LANES]; KINDS]; C]; R];
                for part in 0..PARTS {
                    let mut sums = [[[$all(0.0); KINDS]; C]; R];
                    for (j, weights) in weights.iter().enumerate() {
                        let mut p = [$all(0.0); R];
                        for (p, legendre) in p.iter_mut().zip(legendre) {
                            *p = must_cast::<_, [$vector; PARTS]>(legendre[j].0)[part];
                        }
                        for c in 0..C {
                            let x = $all(columns[c][j]);
                            for kind in 0..KINDS {
                                let v = $times(must_cast::<_, [$vector; PARTS]>(weights[kind].0)[part], x);
                                for r in 0..R {
                                    sums[r][c][kind] = $fused(p[r], v, sums[r][c][kind]);
                                }
                            }
                        }
                    }
                    for r in 0..R {
                        for c in 0..C {
                            for kind in 0..KINDS {
                                let lanes: [f64; LANES / PARTS] = must_cast(sums[r][c][kind]);
                                tile[r][c][kind][part * (LANES / PARTS)..][..LANES / PARTS].copy_from_slice(&lanes);
                            }
                        }
                    }
                }
                tile
            }
        };
    }
    tile_for!(avx512, "avx512f", __m512d, _mm512_set1_pd, _mm512_mul_pd, _mm512_fmadd_pd);
    tile_for!(avx2, "avx2,fma", __m256d, _mm256_set1_pd, _mm256_mul_pd, _mm256_fmadd_pd);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the processor's own vectors give is what the plain tile gives, for every shape of a tile.
    #[test]
    fn every_shape_agrees_with_the_plain_tile() {
        let rings = 5;
        let value = |i: usize| ((i * i) as f64).sin();
        let lanes = |i: usize| Lanes(std::array::from_fn(|lane| value(i * LANES + lane)));
        let legendre: Vec<Lanes> = (0..ROWS * 2 * rings).map(lanes).collect();
        let columns: Vec<f64> = (0..3 * rings).map(|i| value(i + 9)).collect();
        let weights: Vec<Weights> =
            (0..2 * rings).map(|i| std::array::from_fn(|k| lanes(77 + i * KINDS + k))).collect();
        for count in 1..=ROWS {
            // The first row ends before the second block.
            let row = |r: usize| Row { degree: 6 + 2 * r, legendre: &legendre[r * 2 * rings..][..2 * rings] };
            let rows: Vec<_> = (0..count).map(row).collect();
            for width in 1..=3 {
                let columns: Vec<_> = columns.chunks_exact(rings).take(width).collect();
                let mut sums = vec![[7.0; LANES]; count * width * KINDS * 2];
                products(&rows, &columns, &weights, rings, 0, 0..2, &mut sums);
                for (at, &found) in sums.iter().enumerate() {
                    let (block, kind, column, row) =
                        (at % 2, at / 2 % KINDS, at / 2 / KINDS % width, at / 2 / KINDS / width);
                    let expected = plain(Factors {
                        legendre: [&rows[row].legendre[block * rings..][..rings]],
                        columns: [columns[column]],
                        weights: &weights[block * rings..][..rings],
                    });
                    let empty = rows[row].degree < block * LANES;
                    for (found, expected) in found.iter().zip(expected[0][0][kind]) {
                        assert!((found - if empty { 7.0 } else { expected }).abs() < 1e-15 * rings as f64);
                    }
                }
            }
        }
    }

    /// The tile of four lanes at a time where the processor has it, whatever wider ones it has too.
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
        let lanes = |i: usize| Lanes(std::array::from_fn(|lane| ((i * LANES + lane) as f64).cos()));
        let legendre: Vec<Lanes> = (0..3 * rings).map(lanes).collect();
        let columns: Vec<f64> = (0..rings).map(|i| (i as f64).sin()).collect();
        let weights: Vec<Weights> = (0..rings).map(|i| std::array::from_fn(|k| lanes(i * KINDS + k + 3))).collect();
        let legendre = std::array::from_fn(|r| &legendre[r * rings..][..rings]);
        let factors = Factors { legendre, columns: [&columns], weights: &weights };
        let (found, expected) = (narrow(factors), plain(factors));
        for (found, expected) in found.as_flattened().as_flattened().iter().zip(expected.as_flattened().as_flattened())
        {
            for (found, expected) in found.iter().zip(expected) {
                assert!((found - expected).abs() < 1e-15 * rings as f64, "{found} {expected}");
            }
        }
    }
}
