//! Tests factors in memory and out of core: C C^T equals the matrix, and singular matrices are reported.

use std::sync::atomic::{AtomicU64, Ordering};

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use ndarray::Array2;
use spharm_monitor::{Monitor, Silent};
use spharm_solver::cholesky::{build_factor, factorise};
use spharm_solver::gram::{Penalised, smoothness_penalty};
use spharm_solver::{CholeskyFactor, FactorParams, GramMatrix, SolverError};
use spharm_store::Scalar;

use crate::matrices::{Dense, filled, gram, in_memory, largest, lower, out_of_core, scattered, spec, stored, to_faer};

/// Covers tiles that are smaller and larger than K = 121, factors in memory and out of core, windows that are kept, and
/// windows that are dropped.
#[test]
fn factor_times_its_transpose_is_the_matrix_and_solves_are_those_of_a_dense_solver() {
    let source = gram(&scattered(400), 10);
    let size = source.size();
    for scalar in [Scalar::F64, Scalar::F32] {
        // The matrix has a condition number of about 10.
        let tolerance = if scalar == Scalar::F64 { 1e-13 } else { 3e-6 };
        for tile in [8, 16, 40, 120, 128] {
            let params = FactorParams { scalar, tile, threads: 2, ..FactorParams::default() };
            let memory = in_memory(&source, &params);
            let folder = tempfile::tempdir().unwrap();
            let (whole, piecewise) = (folder.path().join("whole"), folder.path().join("piecewise"));
            let spec = spec(10, 400);
            let first = build_factor(&whole, &spec, &source, &params, &Silent).unwrap().file;
            let second = out_of_core(&piecewise, &source, &spec, &params);
            for file in [&first, &second] {
                file.verify(&Silent).unwrap();
                let c = lower(file);
                assert!((0..size).all(|i| (i + 1..size).all(|j| c[[i, j]] == 0.0)), "a lower triangle");
                let difference = largest(&(c.dot(&c.t()) - &source.0)) / largest(&source.0);
                assert!(difference < tolerance, "{scalar:?} {tile}: {difference}");
            }
            let difference = largest(&(lower(&first) - lower(&second))) / largest(&source.0).sqrt();
            assert!(difference < if scalar == Scalar::F64 { 1e-14 } else { 1.2e-7 }, "{tile}: {difference}");
            for channels in [1, 2, 3, 4, 8, 16, 30] {
                let right = filled(size, channels);
                let expected = to_faer(&source.0).llt(Side::Lower).unwrap().solve(to_faer(&right));
                let expected = Array2::from_shape_fn(right.dim(), |(i, j)| expected[(i, j)]);
                let mut solutions = Vec::new();
                let factors: [&dyn CholeskyFactor; 4] =
                    [&memory, &stored(&first, 1 << 30, 2), &stored(&first, 0, 2), &stored(&second, 1 << 30, 3)];
                for factor in factors {
                    let mut x = right.clone();
                    factor.solve(&mut x).unwrap();
                    let difference = largest(&(&x - &expected)) / largest(&expected);
                    assert!(difference < 10.0 * tolerance, "{scalar:?} {tile} {channels}: {difference}");
                    solutions.push(x);
                }
                assert_eq!(solutions[0], solutions[1], "in memory and from a store");
                assert_eq!(solutions[0], solutions[2], "from windows that stay and that don't");
            }
        }
    }
}

#[test]
fn any_number_of_threads_gives_the_same_bits() {
    let source = gram(&scattered(400), 12);
    let folder = tempfile::tempdir().unwrap();
    let params = FactorParams { tile: 16, threads: 1, ..FactorParams::default() };
    let file = build_factor(folder.path(), &spec(12, 400), &source, &params, &Silent).unwrap().file;
    for channels in [3, 20] {
        let solve = |threads: usize| {
            let mut x = filled(source.size(), channels);
            stored(&file, 1 << 30, threads).solve(&mut x).unwrap();
            x
        };
        let one = solve(1);
        for threads in [2, 3, 7, 64] {
            assert_eq!(solve(threads), one, "{threads} threads, {channels} columns");
        }
    }
}

#[test]
fn the_inverse_s_diagonal_is_that_of_unit_solves() {
    let source = gram(&scattered(500), 12);
    for tile in [16, 64, 128] {
        let params = FactorParams { tile, threads: 2, ..FactorParams::default() };
        let factor = in_memory(&source, &params);
        let mut unit = Array2::eye(source.size());
        factor.solve(&mut unit).unwrap();
        let diagonal = factor.inverse_diagonal(&Silent).unwrap();
        assert_eq!(diagonal.len(), source.size());
        for (value, expected) in diagonal.iter().zip(unit.diag()) {
            assert!((value - expected).abs() < 1e-13 * expected.abs(), "{value} {expected}");
        }
    }
}

#[test]
fn penalised_diagonals_are_those_of_unit_solves() {
    let source = gram(&scattered(700), 17);
    let penalty = smoothness_penalty(17, 0.01);
    let scale = Array2::from_shape_fn((source.size(), 1), |(row, _)| penalty[row]);
    // The 324 vectors need two passes of at most 256.
    for (tile, threads) in [(8, 1), (16, 3), (128, 2), (256, 2)] {
        let factor = in_memory(&source, &FactorParams { tile, threads, ..FactorParams::default() });
        let mut unit = Array2::eye(source.size());
        factor.solve(&mut unit).unwrap();
        let expected = unit.t().dot(&(&unit * &scale));
        let (inverse, penalised) = factor.penalised_diagonals(&penalty, &Silent).unwrap();
        for (found, expected) in [(inverse, unit.diag()), (penalised, expected.diag())] {
            assert_eq!(found.len(), source.size());
            let most = expected.iter().copied().fold(0.0, f64::max);
            for (value, expected) in found.iter().zip(expected) {
                assert!((value - expected).abs() < 1e-12 * most, "{tile}: {value} {expected}");
            }
        }
    }
}

#[test]
fn the_inverse_s_diagonal_stops_between_tiles() {
    /// A monitor that cancels at the third check.
    struct Third(AtomicU64);
    impl Monitor for Third {
        fn cancelled(&self) -> bool {
            self.0.fetch_add(1, Ordering::Relaxed) >= 2
        }
    }
    let factor =
        in_memory(&gram(&scattered(500), 12), &FactorParams { tile: 16, threads: 2, ..FactorParams::default() });
    let monitor = Third(AtomicU64::new(0));
    assert!(matches!(factor.inverse_diagonal(&monitor), Err(SolverError::Interrupted(_))));
    assert!(monitor.0.into_inner() <= 4, "each thread asks once more at most");
}

#[test]
fn the_condition_estimate_is_within_a_few_of_the_truth() {
    for (n, lambda) in [(400, 0.0), (180, 0.0), (400, 1e-2)] {
        let source = gram(&scattered(n), 10);
        let penalised = Penalised::new(&source, smoothness_penalty(10, lambda));
        let mut matrix = Array2::zeros((121, 121));
        penalised.tile(0..121, 0..121, matrix.as_slice_mut().unwrap(), 121).unwrap();
        let one_norm =
            |a: &Mat<f64>| a.col_iter().map(|column| column.iter().map(|value| value.abs()).sum()).fold(0.0, f64::max);
        let norm = one_norm(&to_faer(&matrix));
        let truth = 1.0 / (norm * one_norm(&to_faer(&matrix).partial_piv_lu().inverse()));
        let factor = in_memory(&penalised, &FactorParams { tile: 32, ..FactorParams::default() });
        let condition = factor.condition();
        assert!((condition.norm - norm).abs() < 1e-12 * condition.norm);
        assert!(condition.reciprocal > 0.99 * truth && condition.reciprocal < 4.0 * truth, "{condition:?} {truth}");
    }
}

/// If there are more functions than directions, the error states the column at which the factorisation breaks down, in
/// memory and out of core, for any tiles.
#[test]
fn a_singular_matrix_is_said_to_break_and_where() {
    let source = gram(&scattered(90), 10);
    let folder = tempfile::tempdir().unwrap();
    for tile in [8, 24, 128] {
        let params = FactorParams { tile, ..FactorParams::default() };
        let error = factorise(&source, &params, &Silent).unwrap_err();
        let SolverError::NotPositiveDefinite { column, degree } = error else { panic!("{error}") };
        assert!((80..=100).contains(&column) && degree == column.isqrt(), "{column} {degree}");
        let error = build_factor(folder.path(), &spec(10, 90), &source, &params, &Silent).unwrap_err();
        assert!(matches!(error, SolverError::NotPositiveDefinite { .. }), "{error}");
        assert!(error.to_string().contains("smoothness"), "{error}");
        let penalised = Penalised::new(&source, smoothness_penalty(10, 1e-3));
        assert!(factorise(&penalised, &params, &Silent).is_ok(), "a penalty mends it");
    }
    // The folder contains only the lock file.
    let names: Vec<_> = std::fs::read_dir(folder.path().join(spec(10, 90).key.to_string()))
        .unwrap()
        .map(|item| item.unwrap().file_name())
        .collect();
    assert_eq!(names, [".lock"]);
    // If column 40 is exactly zero, exactly that column is reported.
    let mut matrix = Array2::eye(100);
    matrix[[40, 40]] = 0.0;
    let error = factorise(&Dense(matrix), &FactorParams { tile: 16, ..FactorParams::default() }, &Silent);
    assert!(matches!(error, Err(SolverError::NotPositiveDefinite { column: 40, degree: 6 })));
    let mut matrix = Array2::eye(100);
    matrix[[40, 40]] = f64::NAN;
    assert!(factorise(&Dense(matrix), &FactorParams { tile: 16, ..FactorParams::default() }, &Silent).is_err());
}
