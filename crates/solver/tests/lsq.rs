//! Exact least squares: every way gives the solution of the dense problem, and what isn't determined stays small.

use std::f64::consts::{PI, TAU};
use std::sync::atomic::{AtomicBool, Ordering};

use ndarray::{Array1, Array2, Axis, concatenate, s};
use ndarray_linalg::{InverseC, JobSvd, SVDDC};
use spharm_harmonics::{Directions, basis_size};
use spharm_solver::cholesky::{FactorParams, GramSource, Penalised, StoredFactor, build_factor, smoothness_penalty};
use spharm_solver::lsq::cg::Stop;
use spharm_solver::lsq::{LsqEvent, LsqFit, LsqParams, LsqSolver, Way, choose_smoothness, moment_gram};
use spharm_solver::{FitParams, MatrixFreeOperator, MemoryOperator, Method, Operator, SolverError, fit};
use spharm_store::factor::open_factor;
use spharm_store::{FactorSpec, Scalar, SchemeKey, WeightsHash};
use spharm_transform::TransformParams;

/// A sampling and each direction's share of the sphere, nearly.
struct Sampling {
    name: &'static str,
    directions: Directions,
    areas: Vec<f64>,
}

/// n directions on a spiral whose height falls by `depth` of the i-th of n.
fn spiral(name: &'static str, n: usize, depth: impl Fn(f64) -> f64) -> Sampling {
    let golden = PI * (3.0 - 5f64.sqrt());
    let at = |i: usize| 1.0 - 2.0 * depth(i as f64 / n as f64);
    let angles: Vec<[f64; 2]> =
        (0..n).map(|i| [(0.5 * (at(i) + at(i + 1))).acos(), (golden * i as f64) % TAU]).collect();
    let areas = (0..n).map(|i| TAU * (at(i) - at(i + 1))).collect();
    Sampling { name, directions: Directions::from_angles(&angles).unwrap(), areas }
}

fn even(n: usize) -> Sampling {
    spiral("even", n, |u| u)
}

/// A hundred times denser at the one pole than at the other.
fn clustered(n: usize) -> Sampling {
    spiral("clustered", n, |u| 0.02 * u + 0.98 * u * u)
}

/// Without any order.
fn irregular(n: usize, seed: u64) -> Sampling {
    let mut random = Random(seed);
    let angles: Vec<[f64; 2]> = (0..n).map(|_| [(1.0 - 2.0 * random.unit()).acos(), TAU * random.unit()]).collect();
    let areas = vec![4.0 * PI / n as f64; n];
    Sampling { name: "irregular", directions: Directions::from_angles(&angles).unwrap(), areas }
}

/// All in a cap of the sphere.
fn cap(n: usize, angle: f64) -> Sampling {
    spiral("cap", n, |u| 0.5 * (1.0 - angle.cos()) * u)
}

/// Numbers without order from a counter.
struct Random(u64);

impl Random {
    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (((z ^ (z >> 31)) >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    fn normal(&mut self) -> f64 {
        (-2.0 * self.unit().ln()).sqrt() * (TAU * self.unit()).cos()
    }

    fn normals(&mut self, rows: usize, columns: usize) -> Array2<f64> {
        Array2::from_shape_simple_fn((rows, columns), || self.normal())
    }
}

fn uneven_weights(n: usize) -> Vec<f64> {
    (0..n).map(|i| 0.25 + ((i * 31) % 7) as f64).collect()
}

/// A, (n, K), by direct sums.
fn matrix(directions: &Directions, max_degree: usize) -> Array2<f64> {
    let operator = MemoryOperator::new(directions, max_degree, 64).unwrap();
    operator.apply(Array2::eye(basis_size(max_degree)).view()).unwrap()
}

/// The minimum-norm solution of the dense problem, by its singular value decomposition.
struct Dense {
    x: Array2<f64>,
    /// Of `[W^(1/2) A; P^(1/2)]`, in falling order.
    singular: Array1<f64>,
    /// Norms of the columns of `A^T W f`.
    scale: Vec<f64>,
    /// Norms of the columns of `W^(1/2) f`.
    size: Vec<f64>,
}

fn dense(a: &Array2<f64>, targets: &Array2<f64>, weights: Option<&[f64]>, smoothness: f64) -> Dense {
    let max_degree = a.ncols().isqrt() - 1;
    let roots = Array2::from_shape_fn((a.nrows(), 1), |(i, _)| weights.map_or(1.0, |w| w[i].sqrt()));
    let mut stacked = a * &roots;
    let mut right = targets * &roots;
    let adjoint = stacked.t().dot(&right);
    if smoothness > 0.0 {
        let penalty = Array1::from(smoothness_penalty(max_degree, smoothness)).mapv(f64::sqrt);
        stacked = concatenate![Axis(0), stacked, Array2::from_diag(&penalty)];
        right = concatenate![Axis(0), right, Array2::zeros((a.ncols(), targets.ncols()))];
    }
    let (u, singular, vt) = stacked.svddc(JobSvd::Some).unwrap();
    let (u, vt) = (u.unwrap(), vt.unwrap());
    let least = 1e-13 * singular[0];
    let mut inner = u.t().dot(&right);
    for (mut row, value) in inner.rows_mut().into_iter().zip(&singular) {
        row.mapv_inplace(|v| if *value > least { v / value } else { 0.0 });
    }
    Dense { x: vt.t().dot(&inner), singular, scale: norms(&adjoint), size: norms(&right) }
}

fn diagonal(values: Vec<f64>) -> Array2<f64> {
    Array2::from_diag(&Array1::from(values))
}

fn norms(a: &Array2<f64>) -> Vec<f64> {
    a.columns().into_iter().map(|c| c.dot(&c).sqrt()).collect()
}

fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, f64::max)
}

impl Dense {
    fn condition(&self) -> f64 {
        self.singular[0] / self.singular[self.singular.len() - 1]
    }

    /// What a gradient of relative norm `optimality` allows the coefficients to be off, and what one does that is formed
    /// with the accuracy of the transforms.
    fn meets(&self, fit: &LsqFit, optimality: f64, what: &str) {
        let (most, least) = (self.singular[0], self.singular[self.singular.len() - 1]);
        let off = norms(&(fit.coefficients.values() - &self.x));
        for (c, off) in off.into_iter().enumerate() {
            let gradient = 1.01 * optimality * self.scale[c] + ACCURACY * most * self.size[c];
            let allowed = gradient / (least * least);
            assert!(off <= allowed, "{what}, column {c}: off by {off:.2e}, allowed {allowed:.2e}");
        }
    }
}

fn never() -> AtomicBool {
    AtomicBool::new(false)
}

fn transforms(directions: &Directions, max_degree: usize) -> MatrixFreeOperator {
    let params = TransformParams { max_degree, accuracy: ACCURACY, channels: 3 };
    MatrixFreeOperator::new(directions, &params).unwrap()
}

/// Solves for targets that are one group.
fn solve(sampling: &Sampling, max_degree: usize, targets: &Array2<f64>, params: LsqParams) -> LsqFit {
    try_solve(sampling, max_degree, targets, params, &never()).unwrap()
}

fn try_solve(
    sampling: &Sampling,
    max_degree: usize,
    targets: &Array2<f64>,
    params: LsqParams,
    cancel: &AtomicBool,
) -> Result<LsqFit, SolverError> {
    let operator = transforms(&sampling.directions, max_degree);
    let weights = params.weights.clone();
    let gram = || {
        let gram = moment_gram(&sampling.directions, weights.as_deref(), max_degree)?;
        Ok(Box::new(gram) as Box<dyn GramSource>)
    };
    let mut solver = LsqSolver::new(&operator, Some(&gram), params)?;
    solver.fit(targets, std::slice::from_ref(&(0..targets.ncols())), cancel, &|_| {})
}

/// Of the transforms.
const ACCURACY: f64 = 1e-12;
const WAYS: [Way; 5] = [Way::Auto, Way::Plain, Way::Density, Way::LowDegrees(4), Way::Factor];

fn params(sampling: &Sampling, way: Way) -> LsqParams {
    LsqParams { way, areas: Some(sampling.areas.clone()), threads: 2, ..LsqParams::default() }
}

#[test]
fn every_way_gives_the_dense_least_squares_weighted_and_penalised_or_not() {
    for (sampling, max_degree) in [(even(642), 12), (irregular(700, 1), 9), (clustered(600), 8), (even(40), 0)] {
        let n = sampling.directions.len();
        let a = matrix(&sampling.directions, max_degree);
        let targets = Random(7).normals(n, 3);
        let mut gaps = uneven_weights(n);
        gaps.iter_mut().step_by(9).for_each(|weight| *weight = 0.0);
        for (weights, smoothness) in
            [(None, 0.0), (Some(uneven_weights(n)), 0.0), (Some(gaps.clone()), 0.0), (None, 1e-3), (Some(gaps), 0.02)]
        {
            let expected = dense(&a, &targets, weights.as_deref(), smoothness);
            assert!(expected.condition() < 1e3, "a problem that can be told");
            for way in WAYS {
                let what =
                    format!("{}, {way:?}, weights {}, smoothness {smoothness}", sampling.name, weights.is_some());
                let params = LsqParams { weights: weights.clone(), smoothness, ..params(&sampling, way) };
                let fit = solve(&sampling, max_degree, &targets, params);
                assert_eq!(fit.report.stop, Stop::Converged, "{what}");
                assert!(fit.report.optimality <= 2e-10, "{what}: {}", fit.report.optimality);
                expected.meets(&fit, fit.report.optimality, &what);
                // What the report says, formed anew by direct sums.
                let residual = &targets - &a.dot(fit.coefficients.values());
                assert!((&residual - &fit.residual).iter().all(|d| d.abs() < 1e-11), "{what}");
                let mut weighted = residual.clone();
                if let Some(weights) = &weights {
                    weighted.rows_mut().into_iter().zip(weights).for_each(|(mut row, w)| row *= *w);
                }
                let mut gradient = a.t().dot(&weighted);
                for (k, p) in smoothness_penalty(max_degree, smoothness).into_iter().enumerate() {
                    gradient.row_mut(k).scaled_add(-p, &fit.coefficients.values().row(k));
                }
                let optimality = largest(norms(&gradient).iter().zip(&expected.scale).map(|(g, scale)| g / scale));
                // Where a target is nearly orthogonal to the basis, errors count more beside what is left of it.
                let small = largest(expected.size.iter().zip(&expected.scale).map(|(size, scale)| size / scale));
                let allowed = 2.0 * ACCURACY * expected.singular[0] * small;
                assert!((optimality - fit.report.optimality).abs() < allowed, "{what}: {optimality:.3e} {allowed:.1e}");
                let squares: Vec<f64> = residual.rows().into_iter().map(|row| row.dot(&row)).collect();
                let [mean, most] = [squares.iter().sum::<f64>() / n as f64, largest(squares)];
                let told = fit.report.residuals[0];
                assert!((told.mean_square / mean - 1.0).abs() < 1e-10 && (told.max_square / most - 1.0).abs() < 1e-10);
                let norm = largest(norms(fit.coefficients.values()));
                assert!((fit.report.norm / norm - 1.0).abs() < 1e-12, "{what}");
                assert_eq!((fit.report.shift, fit.report.breaks_at), (0.0, None), "{what}: nothing is singular");
                assert!(fit.report.condition.is_nan() || fit.report.condition.is_finite());
                if fit.report.condition.is_finite() {
                    let ratio = fit.report.condition / expected.condition();
                    assert!(ratio > 1.0 / 3.0 && ratio < 3.0, "{what}: condition off by {ratio}");
                }
            }
        }
    }
}

#[test]
fn a_batch_gives_what_each_column_gives_alone_and_a_zero_column_zero() {
    let sampling = clustered(500);
    let mut targets = Random(3).normals(500, 8);
    targets.column_mut(5).fill(0.0);
    // Of quite another size: each column has its own optimality.
    targets.column_mut(6).mapv_inplace(|v| 1e-9 * v);
    let expected = dense(&matrix(&sampling.directions, 7), &targets, None, 0.0);
    for way in WAYS {
        let together = solve(&sampling, 7, &targets, params(&sampling, way));
        assert_eq!(together.report.stop, Stop::Converged);
        expected.meets(&together, 2e-10, &format!("{way:?}"));
        assert!(together.coefficients.values().column(5).iter().all(|v| *v == 0.0));
        for c in [0, 5, 6] {
            let one = targets.slice(s![.., c..c + 1]).to_owned();
            let alone = solve(&sampling, 7, &one, params(&sampling, way));
            let both = [&together, &alone].map(|fit| fit.coefficients.values().clone());
            let off = norms(&(&both[0].slice(s![.., c..c + 1]) - &both[1]))[0];
            assert!(off <= 1e-8 * norms(&both[1])[0], "{way:?}, column {c}: {off:.1e}");
        }
    }
    let nothing = Array2::zeros((500, 2));
    for way in WAYS {
        let fit = solve(&sampling, 7, &nothing, params(&sampling, way));
        assert_eq!((fit.report.stop, fit.report.norm, fit.report.optimality), (Stop::Converged, 0.0, 0.0), "{way:?}");
    }
}

/// One batch after another on the same solver, with the factor that the first one made.
#[test]
fn a_solver_keeps_its_factor_from_batch_to_batch() {
    let sampling = irregular(400, 4);
    let a = matrix(&sampling.directions, 14);
    let operator = transforms(&sampling.directions, 14);
    let made = std::sync::atomic::AtomicUsize::new(0);
    let gram = || {
        made.fetch_add(1, Ordering::Relaxed);
        Ok(Box::new(moment_gram(&sampling.directions, None, 14)?) as Box<dyn GramSource>)
    };
    let mut solver = LsqSolver::new(&operator, Some(&gram), params(&sampling, Way::Auto)).unwrap();
    for seed in 0..3 {
        let targets = Random(seed).normals(400, 3);
        let fit = solver.fit(&targets, std::slice::from_ref(&(0..3)), &never(), &|_| {}).unwrap();
        dense(&a, &targets, None, 0.0).meets(&fit, fit.report.optimality, "batch");
        assert_eq!((fit.report.preconditioner, fit.report.stop), ("factor", Stop::Converged), "{:?}", fit.report);
        // Iterations first, and then no more.
        assert_eq!(fit.report.iterations > 0, seed == 0);
    }
    assert_eq!(made.into_inner(), 1);
}

/// A factor in a store, as it would be opened for `sampling`.
fn stored(
    folder: &std::path::Path,
    sampling: &Sampling,
    max_degree: usize,
    weights: Option<&[f64]>,
    smoothness: f64,
    scalar: Scalar,
) -> StoredFactor {
    let spec = FactorSpec {
        key: SchemeKey::of(&sampling.directions, Scalar::F64),
        rows: sampling.directions.len(),
        max_degree,
        weights: WeightsHash::of(weights),
        smoothness,
    };
    let gram = moment_gram(&sampling.directions, weights, max_degree).unwrap();
    let penalised = Penalised::new(&gram, smoothness_penalty(max_degree, smoothness));
    let params = FactorParams { scalar, threads: 2, ..FactorParams::default() };
    build_factor(folder, &spec, &penalised, &params, &never(), &|_| {}).unwrap();
    StoredFactor::new(open_factor(folder, &spec, Some(scalar)).unwrap(), 1 << 30, 2)
}

#[test]
fn a_stored_factor_gives_what_a_made_one_gives_and_single_precision_is_refined() {
    let folder = tempfile::tempdir().unwrap();
    for (sampling, max_degree, smoothness) in
        [(even(642), 12, 0.0), (clustered(500), 9, 0.0), (irregular(300, 2), 14, 0.0), (irregular(300, 2), 14, 1e-4)]
    {
        let n = sampling.directions.len();
        let weights = uneven_weights(n);
        let targets = Random(9).normals(n, 4);
        let expected = dense(&matrix(&sampling.directions, max_degree), &targets, Some(&weights), smoothness);
        let operator = transforms(&sampling.directions, max_degree);
        let base = LsqParams { weights: Some(weights.clone()), smoothness, ..params(&sampling, Way::Factor) };
        let made = solve(&sampling, max_degree, &targets, base.clone());
        for scalar in [Scalar::F64, Scalar::F32] {
            let factor = stored(folder.path(), &sampling, max_degree, Some(&weights), smoothness, scalar);
            // No Gram matrix is there to make another from.
            let mut solver = LsqSolver::new(&operator, None, base.clone()).unwrap().with_factor(&factor);
            let fit = solver.fit(&targets, std::slice::from_ref(&(0..4)), &never(), &|_| {}).unwrap();
            let what = format!("{} {scalar:?} {smoothness} {:?}", sampling.name, fit.report);
            assert_eq!((fit.report.preconditioner, fit.report.iterations), ("stored-factor", 0), "{what}");
            assert!(fit.report.stop == Stop::Converged && fit.report.optimality <= 1e-10, "{what}");
            expected.meets(&fit, 1e-10, &what);
            if scalar == Scalar::F64 {
                assert_eq!(fit.coefficients.values(), made.coefficients.values(), "{what}: the same bits");
            }
            // Of the sum norm; it is within the size of the matrix of that of the Euclidean one, on even samplings nearer.
            let ratio = fit.report.condition / expected.condition();
            let most = if sampling.name == "even" { 3.0 } else { (basis_size(max_degree) as f64).sqrt() };
            assert!(ratio > 1.0 / most && ratio < most, "{what}: {ratio}");
        }
    }
}

/// A condition number of the normal equations at which single precision has no digit left to solve with.
#[test]
fn a_single_precision_factor_of_ill_conditioned_equations_ends_with_the_best_that_was_found() {
    let folder = tempfile::tempdir().unwrap();
    let sampling = irregular(300, 5);
    let targets = Random(9).normals(300, 2);
    let expected = dense(&matrix(&sampling.directions, 16), &targets, None, 0.0);
    assert!(expected.condition() > 2e3, "{}", expected.condition());
    let operator = transforms(&sampling.directions, 16);
    let factor = stored(folder.path(), &sampling, 16, None, 0.0, Scalar::F32);
    let mut solver = LsqSolver::new(&operator, None, params(&sampling, Way::Auto)).unwrap().with_factor(&factor);
    let fit = solver.fit(&targets, std::slice::from_ref(&(0..2)), &never(), &|_| {}).unwrap();
    assert!(fit.report.optimality <= 1e-9, "{:?}", fit.report);
    expected.meets(&fit, fit.report.optimality, "single");
}

/// Mean squared residual of the least squares in the singular vectors above `cut` of the largest value.
fn truncated(a: &Array2<f64>, targets: &Array2<f64>, cut: f64) -> f64 {
    let (u, singular, _) = a.svddc(JobSvd::Some).unwrap();
    let count = singular.iter().filter(|value| **value > cut * singular[0]).count();
    let u = u.unwrap().slice(s![.., ..count]).to_owned();
    (targets - &u.dot(&u.t().dot(targets))).iter().map(|r| r * r).sum::<f64>() / a.nrows() as f64
}

#[test]
fn what_the_sampling_does_not_determine_stays_small_and_is_told() {
    // A cap; few more rows than columns, and every one of them twice.
    let twice = {
        let few = irregular(90, 6).directions;
        let directions = Directions::from_vertices(&few.as_slice().repeat(2)).unwrap();
        Sampling { name: "twice", areas: vec![4.0 * PI / 180.0; 180], directions }
    };
    for (sampling, max_degree) in [(cap(400, 0.3), 9), (twice, 10), (cap(600, 1.0), 12)] {
        let n = sampling.directions.len();
        assert!(n >= basis_size(max_degree));
        let operator = MemoryOperator::new(&sampling.directions, max_degree, 64).unwrap();
        // A smooth function that isn't in the basis, and a little noise.
        let mut targets = Random(11).normals(n, 2) * 1e-3;
        for (mut row, v) in targets.rows_mut().into_iter().zip(sampling.directions.as_slice()) {
            row[0] += (3.0 * v[0]).sin() * v[2].exp();
            row[1] += 1.0 / (1.5 + v[1]);
        }
        let nlsf = FitParams { max_degree, method: Method::Nlsf, refinements: 2, ..FitParams::default() };
        let least = fit(&operator, targets.view(), std::slice::from_ref(&(0..2)), &nlsf).unwrap();
        assert_eq!(least.report.blocks[0].solver, "rank-revealing");
        let a = matrix(&sampling.directions, max_degree);
        let least = least.report.sweeps.last().unwrap().residuals[0].mean_square;
        for way in [Way::Auto, Way::Factor] {
            let found = solve(&sampling, max_degree, &targets, params(&sampling, way));
            let report = &found.report;
            let what = format!("{} {way:?} least {least:e} {report:?}", sampling.name);
            assert!(found.coefficients.values().iter().all(|v| v.is_finite()), "{what}");
            assert!(report.norm < 1e6, "{what}");
            assert!(report.shift > 0.0 && report.shift < 1e-9 && report.condition.is_infinite(), "{what}");
            let [column, degree] = report.breaks_at.expect(&what);
            assert!(column < basis_size(max_degree) && degree == column.isqrt() && degree > 0, "{what}");
            // Between the least there is and the least with what the shift can tell from nothing.
            let mean = report.residuals[0].mean_square;
            let cut = truncated(&a, &targets, 10.0 * report.shift.sqrt());
            assert!(mean >= least * (1.0 - 1e-6) && mean <= 1.01 * cut + 1e-15, "{what} cut {cut:e}");
        }
    }
}

#[test]
fn with_more_coefficients_than_directions_the_shortest_solution_interpolates() {
    let sampling = irregular(80, 8);
    let targets = Random(5).normals(80, 3);
    let expected = dense(&matrix(&sampling.directions, 11), &targets, None, 0.0);
    for way in [Way::Auto, Way::Plain, Way::Factor] {
        let fit = solve(&sampling, 11, &targets, params(&sampling, way));
        let what = format!("{way:?} {:?}", fit.report);
        assert!(fit.report.residuals[0].mean_square < 1e-14, "{what}");
        let least = norms(&expected.x);
        let found = norms(fit.coefficients.values());
        assert!(found.iter().zip(&least).all(|(found, least)| *found < 1.05 * least), "{found:?} {least:?} {what}");
        if way != Way::Factor {
            let off = norms(&(fit.coefficients.values() - &expected.x));
            assert!(off.iter().zip(&least).all(|(off, norm)| *off < 1e-4 * norm), "{off:?} {what}");
        }
    }
}

#[test]
fn bad_input_gets_typed_errors() {
    let sampling = even(100);
    let good = Random(1).normals(100, 2);
    let error = |targets: &Array2<f64>, change: &dyn Fn(&mut LsqParams)| {
        let mut params = params(&sampling, Way::Auto);
        change(&mut params);
        try_solve(&sampling, 4, targets, params, &never()).unwrap_err()
    };
    let mut bad = good.clone();
    bad[[17, 1]] = f64::NAN;
    assert!(matches!(error(&bad, &|_| {}), SolverError::NotFinite { row: 17, column: 1 }));
    bad[[17, 1]] = f64::NEG_INFINITY;
    assert!(matches!(error(&bad, &|_| {}), SolverError::NotFinite { row: 17, column: 1 }));
    let short = Random(1).normals(99, 2);
    assert!(matches!(error(&short, &|_| {}), SolverError::Rows { expected: 100, found: 99, .. }));
    for weight in [-1.0, f64::NAN, f64::INFINITY] {
        let mut weights = vec![1.0; 100];
        weights[42] = weight;
        let found = error(&good, &|params| params.weights = Some(weights.clone()));
        assert!(matches!(found, SolverError::Weight { row: 42, .. }), "{found}");
    }
    let found = error(&good, &|params| params.weights = Some(vec![0.0; 100]));
    assert!(matches!(found, SolverError::Weight { .. }), "{found}");
    let found = error(&good, &|params| params.weights = Some(vec![1.0; 7]));
    assert!(matches!(found, SolverError::Rows { expected: 100, found: 7, .. }), "{found}");
    let found = error(&good, &|params| params.areas = Some(vec![1.0; 101]));
    assert!(matches!(found, SolverError::Rows { expected: 100, found: 101, .. }), "{found}");
    for smoothness in [-1e-9, f64::NAN, f64::INFINITY] {
        let found = error(&good, &|params| params.smoothness = smoothness);
        assert!(matches!(found, SolverError::Smoothness { .. }), "{found}");
    }
    // Ways that need what isn't there.
    let operator = transforms(&sampling.directions, 4);
    for way in [Way::Factor, Way::LowDegrees(2)] {
        let mut solver = LsqSolver::new(&operator, None, params(&sampling, way)).unwrap();
        let found = solver.fit(&good, std::slice::from_ref(&(0..2)), &never(), &|_| {}).unwrap_err();
        assert!(matches!(found, SolverError::NoGram), "{found}");
    }
    let mut solver = LsqSolver::new(&operator, None, LsqParams { areas: None, ..params(&sampling, Way::Density) });
    if let Ok(solver) = &mut solver {
        let fit = solver.fit(&good, std::slice::from_ref(&(0..2)), &never(), &|_| {}).unwrap();
        assert_eq!(fit.report.preconditioner, "none", "no areas, no density");
    }
    let found = error(&good, &|params| (params.way, params.memory) = (Way::Factor, 1000));
    assert!(found.to_string().contains("the smallest that works is"), "{found}");
}

#[test]
fn a_fit_that_is_told_to_stop_stops() {
    let sampling = irregular(400, 4);
    let targets = Random(5).normals(400, 3);
    for way in WAYS {
        let found = try_solve(&sampling, 12, &targets, params(&sampling, way), &AtomicBool::new(true)).unwrap_err();
        assert!(matches!(found, SolverError::Interrupted), "{way:?}: {found}");
    }
    let found =
        choose_smoothness(&transforms(&sampling.directions, 12), None, &targets, &AtomicBool::new(true), &|_, _| {});
    assert!(matches!(found, Err(SolverError::Interrupted)));
    // In the middle of it.
    let operator = transforms(&sampling.directions, 12);
    let cancel = never();
    let mut solver = LsqSolver::new(&operator, None, params(&sampling, Way::Plain)).unwrap();
    let stop = |event: LsqEvent| {
        if let LsqEvent::Step(3, _) = event {
            cancel.store(true, Ordering::Relaxed);
        }
    };
    let found = solver.fit(&targets, std::slice::from_ref(&(0..3)), &cancel, &stop).unwrap_err();
    assert!(matches!(found, SolverError::Interrupted), "{found}");
}

#[test]
fn too_few_iterations_end_with_the_best_solution_so_far() {
    let sampling = irregular(400, 4);
    let targets = Random(5).normals(400, 3);
    let a = matrix(&sampling.directions, 12);
    let mut before = f64::INFINITY;
    for (max_iterations, way) in [(1, Way::Plain), (4, Way::Plain), (16, Way::Plain), (16, Way::Auto)] {
        let fit = solve(&sampling, 12, &targets, LsqParams { max_iterations, ..params(&sampling, way) });
        let what = format!("{:?}", fit.report);
        assert_eq!((fit.report.stop, fit.report.iterations), (Stop::IterationLimit, max_iterations), "{what}");
        assert_eq!((fit.report.preconditioner, fit.report.refinements), ("none", 0), "{what}");
        let residual = &targets - &a.dot(fit.coefficients.values());
        let square = residual.iter().map(|r| r * r).sum::<f64>() / 400.0;
        assert!((fit.report.residuals[0].mean_square / square - 1.0).abs() < 1e-10, "{what}");
        assert!(square <= before * (1.0 + 1e-12), "more iterations, less residual");
        before = square;
    }
}

#[test]
fn cross_validation_finds_a_smoothness_that_is_near_the_best() {
    const DEGREE: usize = 12;
    for (sampling, seed, noise) in [(even(600), 1, 0.05), (irregular(600, 3), 2, 0.05), (clustered(700), 3, 0.2)] {
        let n = sampling.directions.len();
        let a = matrix(&sampling.directions, DEGREE);
        let mut random = Random(seed);
        let known =
            Array2::from_shape_fn((basis_size(DEGREE), 3), |(k, _)| random.normal() / (1.0 + k.isqrt() as f64).powi(3));
        let truth = a.dot(&known);
        let targets = &truth + &(random.normals(n, 3) * noise);
        let operator = transforms(&sampling.directions, DEGREE);
        let weights = (sampling.name == "even").then(|| vec![2.0; n]);
        let found = choose_smoothness(&operator, weights.as_deref(), &targets, &never(), &|_, _| {}).unwrap();
        let error = |lambda: f64| {
            let x = dense(&a, &targets, weights.as_deref(), lambda).x;
            (a.dot(&x) - &truth).iter().map(|d| d * d).sum::<f64>() / n as f64
        };
        let best = (-16..6).map(|power| error(3f64.powi(power))).fold(f64::INFINITY, f64::min);
        let (chosen, without) = (error(found.smoothness), error(0.0));
        assert!(chosen < without && chosen < 1.5 * best, "{chosen:e} {without:e} {best:e} {found:?}");
        assert!(!found.at_the_end);
        // The trace of the hat matrix, against the dense one: the probes' noise is some percent of what is lost.
        for [lambda, _, trace] in found.tried {
            let weight = weights.as_ref().map_or(1.0, |w| w[0]);
            let penalised = a.t().dot(&a) * weight + diagonal(smoothness_penalty(DEGREE, lambda));
            let truth = (penalised.invc().unwrap().dot(&(a.t().dot(&a) * weight))).diag().sum();
            let lost = basis_size(DEGREE) as f64 - truth;
            let noise = 4.0 * (2.0 * lost.min(truth) / 3.0).sqrt() + 1e-3;
            assert!((trace - truth).abs() < noise, "lambda {lambda}: {trace}, not {truth}");
        }
    }
}

#[test]
fn cross_validation_asks_for_next_to_nothing_where_there_is_no_noise() {
    let sampling = even(500);
    let operator = transforms(&sampling.directions, 12);
    let mut known = Array2::zeros((basis_size(12), 3));
    known.slice_mut(s![..16, ..]).assign(&Random(1).normals(16, 3));
    let targets = matrix(&sampling.directions, 12).dot(&known);
    let found = choose_smoothness(&operator, None, &targets, &never(), &|_, _| {}).unwrap();
    let params = LsqParams { smoothness: found.smoothness, ..params(&sampling, Way::Auto) };
    let fit = solve(&sampling, 12, &targets, params);
    let off = norms(&(fit.coefficients.values() - &known));
    assert!(off.iter().zip(norms(&known)).all(|(off, norm)| *off < 1e-6 * norm), "{off:?} {found:?}");
}

/// sigma^2 (A^T W A + P)^-1, and that it tells how much coefficients scatter.
#[test]
fn standard_errors_are_those_of_the_dense_inverse() {
    for (sampling, max_degree, smoothness) in
        [(irregular(300, 2), 8, 0.0), (clustered(300), 6, 1e-2), (even(60), 8, 0.1)]
    {
        let n = sampling.directions.len();
        let k = basis_size(max_degree);
        let mut weights = uneven_weights(n);
        weights[3] = 0.0;
        let targets = Random(4).normals(n, 2);
        let a = matrix(&sampling.directions, max_degree);
        let weighted = &a * &Array2::from_shape_fn((n, 1), |(i, _)| weights[i]);
        let penalty = diagonal(smoothness_penalty(max_degree, smoothness));
        let inverse = (a.t().dot(&weighted) + &penalty).invc().unwrap();
        let operator = transforms(&sampling.directions, max_degree);
        let gram = || {
            let gram = moment_gram(&sampling.directions, Some(&weights), max_degree)?;
            Ok(Box::new(gram) as Box<dyn GramSource>)
        };
        for way in [Way::Auto, Way::Plain, Way::Factor] {
            let params = LsqParams { weights: Some(weights.clone()), smoothness, ..params(&sampling, way) };
            let mut solver = LsqSolver::new(&operator, Some(&gram), params).unwrap();
            let fit = solver.fit(&targets, std::slice::from_ref(&(0..2)), &never(), &|_| {}).unwrap();
            let errors = solver.standard_errors(&fit.residual, &never(), &|_| {}).unwrap();
            assert_eq!(errors.dim(), (k, 2));
            // What the rows tell beyond what is fitted: rows with weight less the trace of the hat matrix.
            let free = (n - 1) as f64 - inverse.dot(&a.t().dot(&weighted)).diag().sum();
            for c in 0..2 {
                let square: f64 = fit.residual.column(c).iter().zip(&weights).map(|(r, w)| w * r * r).sum();
                for j in 0..k {
                    let expected = (square / free * inverse[[j, j]]).sqrt();
                    let off = (errors[[j, c]] / expected - 1.0).abs();
                    assert!(off < 1e-8, "{} {way:?}, {j}: {} not {expected}", sampling.name, errors[[j, c]]);
                }
            }
        }
    }
}

#[test]
fn coefficients_scatter_by_their_standard_errors() {
    const DRAWS: usize = 200;
    let sampling = clustered(150);
    let weights = uneven_weights(150);
    let a = matrix(&sampling.directions, 4);
    let mut random = Random(21);
    let known = random.normals(25, 1);
    // Noise of variance 0.01 / w: a column for each draw.
    let mut targets = random.normals(150, DRAWS) * 0.1;
    for (mut row, weight) in targets.rows_mut().into_iter().zip(&weights) {
        row /= weight.sqrt();
    }
    targets += &a.dot(&known);
    let operator = transforms(&sampling.directions, 4);
    let gram = || Ok(Box::new(moment_gram(&sampling.directions, Some(&weights), 4)?) as Box<dyn GramSource>);
    let params = LsqParams { weights: Some(weights.clone()), ..params(&sampling, Way::Auto) };
    let mut solver = LsqSolver::new(&operator, Some(&gram), params).unwrap();
    let fit = solver.fit(&targets, std::slice::from_ref(&(0..DRAWS)), &never(), &|_| {}).unwrap();
    let errors = solver.standard_errors(&fit.residual, &never(), &|_| {}).unwrap();
    for k in 0..25 {
        let off = fit.coefficients.values().row(k).mapv(|x| (x - known[[k, 0]]).powi(2));
        let (spread, told) = (off.mean().unwrap().sqrt(), errors.row(k).mean().unwrap());
        assert!((spread / told - 1.0).abs() < 0.2, "coefficient {k}: {spread}, told {told}");
    }
}

#[test]
fn standard_errors_of_what_is_not_determined_are_refused() {
    let refused = |sampling: &Sampling, max_degree: usize| {
        let targets = Random(1).normals(sampling.directions.len(), 1);
        let operator = transforms(&sampling.directions, max_degree);
        let gram = || Ok(Box::new(moment_gram(&sampling.directions, None, max_degree)?) as Box<dyn GramSource>);
        let mut solver = LsqSolver::new(&operator, Some(&gram), params(sampling, Way::Auto)).unwrap();
        let fit = solver.fit(&targets, std::slice::from_ref(&(0..1)), &never(), &|_| {}).unwrap();
        solver.standard_errors(&fit.residual, &never(), &|_| {}).unwrap_err()
    };
    for (sampling, max_degree) in [(even(80), 9), (cap(400, 0.3), 9)] {
        let error = refused(&sampling, max_degree);
        assert!(matches!(error, SolverError::Underdetermined { columns: 100, .. }), "{error}");
        assert!(error.to_string().contains("--smoothness"), "{error}");
    }
}
