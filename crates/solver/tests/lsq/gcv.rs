//! Tests of the choice of the smoothness by generalised cross-validation.

use std::sync::Arc;

use ndarray::{Array2, s};
use spharm_harmonics::basis_size;
use spharm_monitor::Silent;
use spharm_solver::gram::smoothness_penalty;
use spharm_solver::lsq::Gcv;
use spharm_solver::{LsqParams, LsqSolver, MatrixFreeOperator, SolverError, Strategy, moment_normal};

use crate::problems::{
    Random, Sampling, clustered, dense, diagonal, even, inverse, irregular, matrix, norms, params, solve, transforms,
};

/// Chooses the smoothness by products by samples, and by moments.
fn by_samples_and_moments(
    sampling: &Sampling,
    operator: &MatrixFreeOperator,
    max_degree: usize,
    weights: Option<Vec<f64>>,
    targets: &Array2<f64>,
) -> [Gcv; 2] {
    let make_moments = |accuracy: f64, _: Option<&Array2<f64>>| {
        let normal = moment_normal(&sampling.directions, weights.as_deref(), max_degree, accuracy)?;
        Ok((Arc::new(normal), None))
    };
    let params = LsqParams { weights: weights.clone(), ..LsqParams::default() };
    let mut by_samples = LsqSolver::new(operator, None, params.clone()).unwrap();
    let mut by_moments = LsqSolver::new(operator, None, params).unwrap().with_moments(&make_moments);
    [&mut by_samples, &mut by_moments].map(|solver| solver.choose_smoothness(targets, &Silent).unwrap())
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
        let [found, by_moments] = by_samples_and_moments(&sampling, &operator, DEGREE, weights.clone(), &targets);
        // Iterations end at an optimality of 1e-7.
        for (found, expected) in by_moments.tried.iter().zip(&found.tried) {
            assert!((found[1] / expected[1] - 1.0).abs() < 1e-6, "{}: {found:?} {expected:?}", sampling.name);
        }
        let params = LsqParams { weights: weights.clone(), ..LsqParams::default() };
        let mut solver = LsqSolver::new(&operator, None, params).unwrap();
        assert!(matches!(solver.set_smoothness(-1.0), Err(SolverError::Smoothness { .. })));
        solver.set_smoothness(found.smoothness).unwrap();
        let fit = solver.fit(&targets, std::slice::from_ref(&(0..3)), &Silent).unwrap();
        let expected = dense(&a, &targets, weights.as_deref(), found.smoothness);
        expected.meets(&fit, fit.report.optimality, "the chosen smoothness");
        let error = |lambda: f64| {
            let x = dense(&a, &targets, weights.as_deref(), lambda).x;
            (a.dot(&x) - &truth).iter().map(|d| d * d).sum::<f64>() / n as f64
        };
        let best = (-16..6).map(|power| error(3f64.powi(power))).fold(f64::INFINITY, f64::min);
        let (chosen, without) = (error(found.smoothness), error(0.0));
        assert!(chosen < without && chosen < 1.5 * best, "{chosen:e} {without:e} {best:e} {found:?}");
        assert!(!found.at_the_end);
        // On an even sampling, the smallest lambda gives the highest degree a penalty of 1e-6 of the normal matrix's
        // diagonal, and the largest lambda gives degree 2 a penalty equal to the diagonal.
        let even = weights.as_ref().map_or(n as f64, |weights| weights.iter().sum()) / (4.0 * std::f64::consts::PI);
        let lambdas = || found.tried.iter().map(|[lambda, ..]| *lambda);
        let (least, most) = (lambdas().fold(f64::INFINITY, f64::min), lambdas().fold(0.0, f64::max));
        let highest = ((DEGREE * (DEGREE + 1)) as f64).powi(2);
        assert!((least / (1e-6 * even / highest) - 1.0).abs() < 1e-9, "{least}");
        assert!((most / (even / 36.0) - 1.0).abs() < 1e-9, "{most}");
        // The trace of the hat matrix is close to that of the dense hat matrix: the probes' noise is some percent of K
        // minus the trace.
        for [lambda, _, trace] in found.tried {
            let weight = weights.as_ref().map_or(1.0, |w| w[0]);
            let penalised = a.t().dot(&a) * weight + diagonal(smoothness_penalty(DEGREE, lambda));
            let truth = (inverse(&penalised).dot(&(a.t().dot(&a) * weight))).diag().sum();
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
    let [found, _] = by_samples_and_moments(&sampling, &operator, 12, None, &targets);
    let params = LsqParams { smoothness: found.smoothness, ..params(Strategy::Auto) };
    let fit = solve(&sampling, 12, &targets, params);
    let off = norms(&(fit.coefficients.values() - &known));
    assert!(off.iter().zip(norms(&known)).all(|(off, norm)| *off < 1e-6 * norm), "{off:?} {found:?}");
}
