//! The Cholesky factor: what it must satisfy in memory, out of core and from a store.

use std::ops::Range;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

use faer::linalg::solvers::{DenseSolveCore, Solve};
use faer::{Mat, Side};
use ndarray::Array2;
use spharm_harmonics::{Directions, Recurrence, Sweep, basis_size};
use spharm_monitor::{Level, Monitor, Silent};
use spharm_solver::SolverError;
use spharm_solver::cholesky::{
    CholeskyFactor, FactorParams, MemoryFactor, StoredFactor, build_factor, factorise, plan_factor,
};
use spharm_solver::gram::{GramMatrix, Penalised, smoothness_penalty};
use spharm_store::factor::{FactorFile, factors, open_factor};
use spharm_store::{FactorSpec, Scalar, SchemeKey, StoreError, StoreWarning, WeightsHash};

/// A matrix that is there.
struct Dense(Array2<f64>);

impl GramMatrix for Dense {
    fn size(&self) -> usize {
        self.0.nrows()
    }

    fn bytes(&self) -> usize {
        8 * self.0.len()
    }

    fn tile(
        &self,
        rows: Range<usize>,
        columns: Range<usize>,
        out: &mut [f64],
        leading: usize,
    ) -> Result<(), SolverError> {
        for (column, out) in columns.zip(out.chunks_mut(leading)) {
            rows.clone().zip(out).for_each(|(row, out)| *out = self.0[[row, column]]);
        }
        Ok(())
    }
}

/// A^T A of the harmonics at scattered directions, by direct sums.
fn gram(directions: &Directions, max_degree: usize) -> Dense {
    let (n, k) = (directions.len(), basis_size(max_degree));
    let recurrence = Recurrence::new(max_degree).unwrap();
    let mut sweep = Sweep::new(&recurrence, directions.as_slice());
    let mut basis = Vec::new();
    for l in 0..=max_degree {
        let mut block = vec![0.0; n * (2 * l + 1)];
        sweep.next_degree(&mut block);
        basis.extend(block);
    }
    let basis = Array2::from_shape_vec((k, n), basis).unwrap();
    Dense(basis.dot(&basis.t()))
}

fn scattered(n: usize) -> Directions {
    let golden = std::f64::consts::PI * (3.0 - 5f64.sqrt());
    let angles: Vec<[f64; 2]> = (0..n)
        .map(|i| [(1.0 - (2 * i + 1) as f64 / n as f64).acos(), (golden * i as f64) % std::f64::consts::TAU])
        .collect();
    Directions::from_angles(&angles).unwrap()
}

fn filled(rows: usize, columns: usize) -> Array2<f64> {
    Array2::from_shape_fn((rows, columns), |(i, j)| ((i * 7 + j * 13) as f64 * 0.37).sin())
}

fn spec(max_degree: usize, rows: usize) -> FactorSpec {
    FactorSpec { key: SchemeKey([3; 32]), rows, max_degree, weights: WeightsHash::ONES, smoothness: 0.0 }
}

fn in_memory(source: &dyn GramMatrix, params: &FactorParams) -> MemoryFactor {
    factorise(source, params, &Silent).unwrap()
}

/// Builds in no more memory than it takes out of core, with panels of one tile column.
fn out_of_core(store: &Path, source: &dyn GramMatrix, spec: &FactorSpec, params: &FactorParams) -> FactorFile {
    let least = match plan_factor(source.size(), &FactorParams { memory: 0, ..params.clone() }, true) {
        Err(SolverError::Store(StoreError::Budget { needed, .. })) => needed,
        other => panic!("{other:?}"),
    };
    let params = FactorParams { memory: least, ..params.clone() };
    let (plan, _) = plan_factor(source.size(), &params, true).unwrap();
    assert_eq!((plan.memory, plan.panel), (least, params.tile.min(source.size())));
    let report = build_factor(store, spec, source, &params, &Silent).unwrap();
    assert!(!report.present);
    report.file
}

fn stored(file: &FactorFile, memory: usize, threads: usize) -> StoredFactor {
    StoredFactor::new(file.clone(), memory, threads)
}

/// C of a file, (K, K).
fn lower(file: &FactorFile) -> Array2<f64> {
    use spharm_store::factor::TileValues;
    let grid = file.header().grid;
    let mut c = Array2::zeros((grid.size(), grid.size()));
    for column in 0..grid.columns() {
        let window = file.window(column).unwrap();
        for row in column..grid.columns() {
            let values: Vec<f64> = match window.values(row).unwrap() {
                TileValues::F64(values) => values.to_vec(),
                TileValues::F32(values) => values.iter().map(|&value| f64::from(value)).collect(),
            };
            let height = grid.range(row).len();
            for (at, value) in values.into_iter().enumerate() {
                c[[grid.range(row).start + at % height, grid.range(column).start + at / height]] = value;
            }
        }
        window.check().unwrap();
    }
    c
}

fn to_faer(a: &Array2<f64>) -> Mat<f64> {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[[i, j]])
}

fn largest(values: &Array2<f64>) -> f64 {
    values.iter().fold(0.0, |m, v| m.max(v.abs()))
}

/// For tiles that divide K = 121 and that don't, in memory and out of core, from windows kept and dropped.
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
        let diagonal = factor.inverse_diagonal().unwrap();
        assert_eq!(diagonal.len(), source.size());
        for (value, expected) in diagonal.iter().zip(unit.diag()) {
            assert!((value - expected).abs() < 1e-13 * expected.abs(), "{value} {expected}");
        }
    }
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

/// More functions than directions: it says where, in memory and out of core, whatever the tiles.
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
    // Nothing but the lock is left.
    let names: Vec<_> = std::fs::read_dir(folder.path().join(spec(10, 90).key.to_string()))
        .unwrap()
        .map(|item| item.unwrap().file_name())
        .collect();
    assert_eq!(names, [".lock"]);
    // Exact zeros, at the very column.
    let mut matrix = Array2::eye(100);
    matrix[[40, 40]] = 0.0;
    let error = factorise(&Dense(matrix), &FactorParams { tile: 16, ..FactorParams::default() }, &Silent);
    assert!(matches!(error, Err(SolverError::NotPositiveDefinite { column: 40, degree: 6 })));
    let mut matrix = Array2::eye(100);
    matrix[[40, 40]] = f64::NAN;
    assert!(factorise(&Dense(matrix), &FactorParams { tile: 16, ..FactorParams::default() }, &Silent).is_err());
}

#[test]
fn a_factor_of_something_else_is_refused_by_name() {
    let source = gram(&scattered(200), 5);
    let folder = tempfile::tempdir().unwrap();
    let spec = spec(5, 200);
    let params = FactorParams { tile: 8, ..FactorParams::default() };
    let built = build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap();
    assert!(!built.present);
    assert!(build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap().present);
    let others = [
        ("scheme", FactorSpec { key: SchemeKey([4; 32]), ..spec }),
        ("number of directions", FactorSpec { rows: 201, ..spec }),
        ("degree", FactorSpec { max_degree: 4, ..spec }),
        ("weights", FactorSpec { weights: WeightsHash::of(Some(&[2.0; 200])), ..spec }),
        ("smoothness", FactorSpec { smoothness: 1e-6, ..spec }),
    ];
    for (what, other) in others {
        let error = built.file.expect(&other).unwrap_err();
        assert!(matches!(error, StoreError::FactorDiffers { .. }), "{error}");
        let line = error.to_string();
        assert!(line.contains(what) && line.contains(&built.file.path().display().to_string()), "{line}");
        if what == "number of directions" {
            continue;
        }
        let error = open_factor(folder.path(), &other, None).unwrap_err();
        assert!(matches!(error, StoreError::FactorMissing { .. }), "{error}");
        // One of something else in its place.
        let place = folder.path().join(other.key.to_string());
        std::fs::create_dir_all(&place).unwrap();
        let place = place.join(other.file_name(Scalar::F64));
        std::fs::copy(built.file.path(), &place).unwrap();
        let error = open_factor(folder.path(), &other, None).unwrap_err();
        assert!(matches!(error, StoreError::FactorDiffers { .. }) && error.to_string().contains(what), "{error}");
        std::fs::remove_file(&place).unwrap();
    }
    assert!(open_factor(folder.path(), &spec, Some(Scalar::F32)).is_err());
    assert_eq!(factors(folder.path(), spec.key).unwrap().len(), 1);
}

/// Asks to stop once it was given so many steps or statuses.
struct StopAfter {
    left: AtomicU64,
}

impl StopAfter {
    fn new(events: u64) -> Self {
        Self { left: AtomicU64::new(events) }
    }

    fn count(&self) {
        let _ = self.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1));
    }
}

impl Monitor for StopAfter {
    fn step(&self, _: u64) {
        self.count();
    }

    fn note(&self, level: Level, _: std::fmt::Arguments<'_>) {
        if level == Level::Status {
            self.count();
        }
    }

    fn cancelled(&self) -> bool {
        self.left.load(Ordering::Relaxed) == 0
    }
}

/// Interrupted at any moment: nothing is left, and the next run does it.
#[test]
fn an_interrupted_build_leaves_nothing() {
    let source = gram(&scattered(400), 12);
    let spec = spec(12, 400);
    let folder = tempfile::tempdir().unwrap();
    for scalar in [Scalar::F64, Scalar::F32] {
        let params = FactorParams { scalar, tile: 16, ..FactorParams::default() };
        for stop_after in [1, 2, 5, 9] {
            let least = plan_factor(source.size(), &FactorParams { memory: 0, ..params.clone() }, true);
            let Err(SolverError::Store(StoreError::Budget { needed, .. })) = least else { panic!("{least:?}") };
            let params = FactorParams { memory: needed, ..params.clone() };
            let error = build_factor(folder.path(), &spec, &source, &params, &StopAfter::new(stop_after)).unwrap_err();
            assert!(matches!(error, SolverError::Interrupted(_)), "{error}");
            let names: Vec<_> = std::fs::read_dir(folder.path().join(spec.key.to_string()))
                .unwrap()
                .map(|item| item.unwrap().file_name().into_string().unwrap())
                .filter(|name| name.starts_with('.') && name != ".lock")
                .collect();
            assert_eq!(names, [""; 0]);
        }
        assert!(!build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap().present);
    }
}

/// A damaged tile is an error of the solve that names the file, in whichever thread it is met; a damaged header makes
/// the next build replace the file.
#[test]
fn damage_is_an_error_and_no_wrong_number() {
    let source = gram(&scattered(400), 12);
    let spec = spec(12, 400);
    let folder = tempfile::tempdir().unwrap();
    let params = FactorParams { tile: 16, ..FactorParams::default() };
    let path = build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap().file.path().to_owned();
    let sound = std::fs::read(&path).unwrap();
    let end = sound.len() - 128 - 64 * 66;
    for at in (4096..end).step_by(9973) {
        let mut damaged = sound.clone();
        damaged[at] ^= 1;
        std::fs::write(&path, damaged).unwrap();
        let file = open_factor(folder.path(), &spec, None).unwrap();
        for threads in [1, 3] {
            let mut x = filled(source.size(), 3);
            let error = stored(&file, 1 << 30, threads).solve(&mut x).unwrap_err();
            assert!(matches!(error, SolverError::Store(StoreError::TileDamaged { .. })), "{error}");
            assert!(error.to_string().contains(&path.display().to_string()), "{error}");
            assert_eq!(x, filled(source.size(), 3), "right-hand sides as they were");
        }
        assert!(file.verify(&Silent).is_err());
    }
    std::fs::write(&path, &sound).unwrap();
    let file = open_factor(folder.path(), &spec, None).unwrap();
    let factor = stored(&file, 1 << 30, 2);
    factor.solve(&mut filled(source.size(), 3)).unwrap();
    std::fs::OpenOptions::new().write(true).open(&path).unwrap().set_len(5000).unwrap();
    for _ in 0..2 {
        let error = factor.solve(&mut filled(source.size(), 3)).unwrap_err();
        assert!(matches!(error, SolverError::Store(StoreError::ChangedWhileRead { .. })), "{error}");
    }
    let report = build_factor(folder.path(), &spec, &source, &params, &Silent).unwrap();
    assert!(!report.present);
    assert!(matches!(report.warnings[..], [StoreWarning::Replaced(_)]));
    assert!(std::fs::read(&path).unwrap() == sound, "the same bytes");
}

#[test]
fn too_little_memory_or_disk_is_said_before_any_work() {
    struct Unasked;
    impl GramMatrix for Unasked {
        fn size(&self) -> usize {
            basis_size(600)
        }
        fn bytes(&self) -> usize {
            0
        }
        fn tile(&self, _: Range<usize>, _: Range<usize>, _: &mut [f64], _: usize) -> Result<(), SolverError> {
            panic!("work has started")
        }
    }
    let folder = tempfile::tempdir().unwrap();
    let store = folder.path().join("store");
    let build = |params: &FactorParams| {
        build_factor(&store, &spec(600, 10), &Unasked, params, &Silent).unwrap_err().to_string()
    };
    let params = FactorParams { memory: 64 << 20, ..FactorParams::default() };
    assert!(build(&params).contains("the smallest that works is"));
    // 522 GB.
    let line = build(&FactorParams { memory: 4 << 30, ..params });
    assert!(line.contains("the factor needs") && line.contains(&store.display().to_string()), "{line}");
    assert!(!store.exists());
}
