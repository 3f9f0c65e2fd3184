//! Compares the Gram matrix with `A^T diag(w) A` computed from the basis.

use std::ops::Range;

use proptest::prelude::*;
use spharm_harmonics::index::{first_column, order_count};
use spharm_harmonics::product::{Matrix, accumulate_adjoint};
use spharm_harmonics::{Recurrence, Sweep, basis_size, gauss_legendre};

use super::MomentGram;
use crate::TransformError;

/// Returns the basis to `max_degree`, (n, K) column-major.
fn basis(max_degree: usize, directions: &[[f64; 3]]) -> Vec<f64> {
    let recurrence = Recurrence::new(max_degree).unwrap();
    let mut sweep = Sweep::new(&recurrence, directions);
    let mut basis = vec![0.0; directions.len() * basis_size(max_degree)];
    for l in 0..=max_degree {
        let block = first_column(l) * directions.len()..first_column(l + 1) * directions.len();
        sweep.next_degree(&mut basis[block]);
    }
    basis
}

fn moments(max_degree: usize, directions: &[[f64; 3]], weights: &[f64]) -> Vec<f64> {
    let (n, degree) = (directions.len(), 2 * max_degree);
    let recurrence = Recurrence::new(degree).unwrap();
    let mut sweep = Sweep::new(&recurrence, directions);
    let mut moments = vec![0.0; basis_size(degree)];
    for l in 0..=degree {
        let mut block = vec![0.0; n * order_count(l)];
        sweep.next_degree(&mut block);
        let of_degree = &mut moments[first_column(l)..first_column(l + 1)];
        accumulate_adjoint(Matrix::new(&block, n, order_count(l), n), Matrix::new(weights, n, 1, n), of_degree);
    }
    moments
}

/// Returns `A^T diag(w) A`, (K, K).
fn direct(max_degree: usize, directions: &[[f64; 3]], weights: &[f64]) -> Vec<f64> {
    let (n, size) = (directions.len(), basis_size(max_degree));
    let basis = basis(max_degree, directions);
    let weighted: Vec<f64> = basis.chunks_exact(n).flat_map(|a| a.iter().zip(weights).map(|(a, w)| a * w)).collect();
    // The product is stored row-major. This makes no difference, because the matrix is symmetric.
    let mut gram = vec![0.0; size * size];
    accumulate_adjoint(Matrix::new(&basis, n, size, n), Matrix::new(&weighted, n, size, n), &mut gram);
    gram
}

/// Returns pseudorandom numbers in -1..1 that are the same on every machine.
fn noise(seed: u64, count: usize) -> Vec<f64> {
    let mut state = seed;
    let mut next = || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    };
    (0..count).map(|_| next()).collect()
}

fn scattered(seed: u64, n: usize) -> Vec<[f64; 3]> {
    let numbers = noise(seed, 2 * n);
    let direction = |pair: &[f64]| {
        let (z, phi) = (pair[0], std::f64::consts::PI * pair[1]);
        let u = (1.0 - z * z).sqrt();
        [u * phi.cos(), u * phi.sin(), z]
    };
    numbers.chunks_exact(2).map(direction).collect()
}

fn whole(gram: &MomentGram) -> Vec<f64> {
    let size = gram.size();
    let mut out = vec![f64::NAN; size * size];
    gram.tile(0..size, 0..size, &mut out, size);
    out
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |largest, value| largest.max(value.abs()))
}

fn assert_direct(max_degree: usize, directions: &[[f64; 3]], weights: &[f64]) {
    let gram = MomentGram::new(max_degree, &moments(max_degree, directions, weights)).unwrap();
    let (found, expected) = (whole(&gram), direct(max_degree, directions, weights));
    let scale = largest(&expected);
    for (at, (found, expected)) in found.iter().zip(&expected).enumerate() {
        let error = (found - expected).abs() / scale;
        assert!(error <= 1e-13, "degree {max_degree}, entry {at}: {found} {expected}, {error:e}");
    }
}

const DEGREES: [usize; 6] = [0, 1, 2, 7, 12, 40];

#[test]
fn scattered_directions_with_positive_weights() {
    for degree in DEGREES {
        let weights: Vec<_> = noise(2, 700).iter().map(|w| w.abs()).collect();
        assert_direct(degree, &scattered(1, 700), &weights);
    }
}

#[test]
fn one_hemisphere_with_weights_of_both_signs() {
    for degree in DEGREES {
        for axis in [0, 2] {
            let mut directions = scattered(3, 500);
            directions.iter_mut().for_each(|direction| direction[axis] = -direction[axis].abs());
            assert_direct(degree, &directions, &noise(4, 500));
        }
    }
}

#[test]
fn one_direction_anywhere() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for direction in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -half, half], [0.48, -0.6, -0.64]] {
        for degree in DEGREES {
            assert_direct(degree, &[direction], &[-2.5]);
        }
    }
}

#[test]
fn quadrature_gives_the_identity() {
    let degree = 12;
    let rings = gauss_legendre(2 * degree + 1);
    let azimuths = 4 * degree + 1;
    let (mut directions, mut weights) = (Vec::new(), Vec::new());
    for j in 0..rings.len() {
        for k in 0..azimuths {
            let phi = std::f64::consts::TAU * k as f64 / azimuths as f64;
            directions.push([rings.sines[j] * phi.cos(), rings.sines[j] * phi.sin(), rings.cosines[j]]);
            weights.push(rings.weights[j] * std::f64::consts::TAU / azimuths as f64);
        }
    }
    let gram = MomentGram::new(degree, &moments(degree, &directions, &weights)).unwrap();
    for (at, value) in whole(&gram).iter().enumerate() {
        let identity = if at % (gram.size() + 1) == 0 { 1.0 } else { 0.0 };
        assert!((value - identity).abs() < 1e-13, "{at}: {value}");
    }
}

/// The uniform measure's Gram matrix is the identity at any degree. At the degree tested here, the orders don't fit in
/// one panel.
#[test]
fn high_degrees_keep_the_identity() {
    let degree = 400;
    let mut moments = vec![0.0; basis_size(2 * degree)];
    moments[0] = (4.0 * std::f64::consts::PI).sqrt();
    let gram = MomentGram::new(degree, &moments).unwrap();
    let (size, count) = (gram.size(), 500);
    let mut tile = vec![f64::NAN; count * count];
    gram.tile(size - count..size, size - count..size, &mut tile, count);
    for (at, value) in tile.iter().enumerate() {
        let identity = if at % (count + 1) == 0 { 1.0 } else { 0.0 };
        assert!((value - identity).abs() < 1e-12, "{at}: {value}");
    }
}

fn some_gram(max_degree: usize) -> MomentGram {
    MomentGram::new(max_degree, &noise(5, basis_size(2 * max_degree))).unwrap()
}

#[test]
fn the_lower_triangle_and_blocks_are_the_tile_and_nothing_else_is_touched() {
    for degree in [0, 1, 8, 33] {
        let gram = some_gram(degree);
        let (size, all) = (gram.size(), whole(&gram));
        let leading = size + 3;
        let mut lower = vec![7.0; leading * size];
        gram.write_lower(&mut lower, leading);
        for column in 0..size {
            for row in 0..leading {
                let expected = if row >= column && row < size { all[column * size + row] } else { 7.0 };
                assert_eq!(lower[column * leading + row], expected, "{row} {column}");
            }
        }
        for degrees in [0..=degree, degree / 2..=degree, degree..=degree, 0..=degree / 3] {
            let first = first_column(*degrees.start());
            let count = first_column(degrees.end() + 1) - first;
            let mut block = vec![f64::NAN; count * count];
            gram.block(degrees, &mut block);
            for column in 0..count {
                for row in 0..count {
                    let (low, high) = (row.min(column), row.max(column));
                    assert_eq!(block[column * count + row], all[(first + low) * size + first + high]);
                }
            }
        }
    }
}

#[test]
fn the_number_of_threads_changes_no_bit() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| whole(&some_gram(35)))
    };
    let one = with(1);
    for threads in [2, 5] {
        assert!(one.iter().zip(with(threads)).all(|(a, b)| a.to_bits() == b.to_bits()), "{threads}");
    }
}

#[test]
fn what_are_no_moments_is_refused() {
    let found = MomentGram::new(2, &[0.0; 16]).map(|gram| gram.size());
    assert_eq!(found, Err(TransformError::MomentCount { degree: 4, expected: 25, found: 16 }));
    let mut moments = [0.0; 25];
    moments[7] = f64::INFINITY;
    let found = MomentGram::new(2, &moments).map(|gram| gram.size());
    assert_eq!(found, Err(TransformError::MomentNotFinite { column: 7, found: f64::INFINITY }));
    let high = MomentGram::new(1_001, &vec![0.0; basis_size(2_002)]).map(|gram| gram.size());
    assert!(matches!(high, Err(TransformError::Harmonics(_))));
}

/// Asserts that the tile `rows` x `columns` has the same bits as the known part `from` x `from` of the matrix, and that
/// nothing is written outside the tile.
fn assert_cut(gram: &MomentGram, known: &[f64], from: &Range<usize>, [rows, columns]: [Range<usize>; 2], gap: usize) {
    let leading = rows.len() + gap;
    let mut tile = vec![7.0; leading * columns.len()];
    gram.tile(rows.clone(), columns.clone(), &mut tile, leading);
    for (j, column) in columns.enumerate() {
        for i in 0..leading {
            let at = (column - from.start) * from.len() + rows.start + i - from.start;
            let expected = if i < rows.len() { known[at] } else { 7.0 };
            assert_eq!(tile[j * leading + i].to_bits(), expected.to_bits(), "row {i} of {rows:?}, column {column}");
        }
    }
}

/// Converts four numbers to two ranges within `from`.
fn ranges(from: &Range<usize>, cut: &[usize]) -> [Range<usize>; 2] {
    let place = |i: usize| from.start + cut[i] % (from.len() + 1);
    [[0, 1], [2, 3]].map(|[a, b]| place(a).min(place(b))..place(a).max(place(b)))
}

/// Tests tiles at a degree whose orders don't fit in one panel.
#[test]
fn tiles_of_several_panels_are_cut_from_a_larger_one() {
    let gram = some_gram(150);
    let from = gram.size() - 1_000..gram.size();
    let mut known = vec![f64::NAN; from.len() * from.len()];
    gram.tile(from.clone(), from.clone(), &mut known, from.len());
    for cut in noise(6, 64).chunks_exact(4) {
        let cut: Vec<_> = cut.iter().map(|x| (x.abs() * 1e6) as usize).collect();
        assert_cut(&gram, &known, &from, ranges(&from, &cut), 1);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn tiles_are_cut_from_the_whole(degree in 0usize..24, cut in prop::array::uniform4(0usize..1_000), gap in 0usize..3) {
        let gram = some_gram(degree);
        let from = 0..gram.size();
        assert_cut(&gram, &whole(&gram), &from, ranges(&from, &cut), gap);
    }
}
