//! Tests of the choice of the smoothness by generalised cross-validation.

use ndarray::{Array2, s};
use spharm_harmonics::basis_size;
use spharm_monitor::Silent;
use spharm_solver::gram::smoothness_penalty;
use spharm_solver::lsq::choose_smoothness;
use spharm_solver::{LsqParams, Strategy};

use crate::problems::{
    Random, clustered, dense, diagonal, even, inverse, irregular, matrix, norms, params, solve, transforms,
};

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
        let found = choose_smoothness(&operator, weights.as_deref(), &targets, &Silent).unwrap();
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
    let found = choose_smoothness(&operator, None, &targets, &Silent).unwrap();
    let params = LsqParams { smoothness: found.smoothness, ..params(Strategy::Auto) };
    let fit = solve(&sampling, 12, &targets, params);
    let off = norms(&(fit.coefficients.values() - &known));
    assert!(off.iter().zip(norms(&known)).all(|(off, norm)| *off < 1e-6 * norm), "{off:?} {found:?}");
}
