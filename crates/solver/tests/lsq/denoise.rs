//! Tests denoising within the fit against dense algebra.

use ndarray::{Array2, s};
use spharm_harmonics::basis_size;
use spharm_monitor::Silent;
use spharm_solver::gram::degree_penalty;
use spharm_solver::lsq::denoise::{NOISE_COLUMNS, residual_square, white_noise};
use spharm_solver::lsq::{MomentProblem, NoisePower, solve_moments};
use spharm_solver::{LsqParams, SolverError, Strategy};
use spharm_transform::{FINEST, SampleSums};

use crate::problems::{
    Random, STRATEGIES, Sampling, clustered, diagonal, even, inverse, irregular, matrix, norms, params, solve,
    try_solve, uneven_weights,
};

const DEGREE: usize = 8;

fn sums(sampling: &Sampling, weights: Option<&[f64]>, targets: &Array2<f64>) -> MomentProblem {
    let sums = SampleSums::new(&sampling.directions, weights, targets.view(), DEGREE, FINEST).unwrap();
    MomentProblem::new(&sums, DEGREE).unwrap()
}

#[test]
fn a_penalty_by_degree_gives_the_dense_solution_by_every_strategy() {
    for (sampling, smoothness) in [(irregular(300, 1), 0.0), (clustered(300), 1e-2)] {
        let n = sampling.directions.len();
        let (weights, targets) = (uneven_weights(n), Random(2).normals(n, 3));
        let by_degree: Vec<f64> =
            (0..=DEGREE).map(|l| if l == 0 { 0.0 } else { 0.3 * 2.5f64.powi(l as i32) }).collect();
        let a = matrix(&sampling.directions, DEGREE);
        let weighted = &a * &Array2::from_shape_fn((n, 1), |(i, _)| weights[i]);
        let smooth = spharm_solver::gram::smoothness_penalty(DEGREE, smoothness);
        let penalty = degree_penalty(&by_degree).iter().zip(smooth).map(|(p, s)| p + s).collect();
        let expected = inverse(&(a.t().dot(&weighted) + diagonal(penalty))).dot(&weighted.t().dot(&targets));
        let near = |found: &Array2<f64>, what: &str| {
            for (off, norm) in norms(&(found - &expected)).into_iter().zip(norms(&expected)) {
                assert!(off < 1e-8 * norm, "{} {what}: off by {off:.1e} of {norm:.1e}", sampling.name);
            }
        };
        for strategy in STRATEGIES {
            let params = LsqParams {
                penalty: Some(by_degree.clone()),
                smoothness,
                weights: Some(weights.clone()),
                ..params(strategy)
            };
            near(solve(&sampling, DEGREE, &targets, params).coefficients.values(), &format!("{strategy:?}"));
        }
        let problem = sums(&sampling, Some(&weights), &targets);
        let params = LsqParams { penalty: Some(by_degree), smoothness, ..LsqParams::default() };
        near(solve_moments(&problem, &params, false, &Silent).unwrap().coefficients.values(), "moments");
        let two = solve_moments(&problem.of_columns(1..3), &params, false, &Silent).unwrap();
        assert!(norms(&(two.coefficients.values() - &expected.slice(s![.., 1..3]))).iter().all(|off| *off < 1e-7));
    }
}

/// The noise power of degree l is `tr (N^-1)_ll`; in the residual of the least squares it is n - K.
#[test]
fn noise_power_is_that_of_the_dense_matrix() {
    for sampling in [irregular(400, 3), clustered(400)] {
        let n = sampling.directions.len();
        let weights = uneven_weights(n);
        let a = matrix(&sampling.directions, DEGREE);
        let weighted = &a * &Array2::from_shape_fn((n, 1), |(i, _)| weights[i]);
        let trace = inverse(&a.t().dot(&weighted)).diag().to_owned();
        let noise = white_noise(n, 0..NOISE_COLUMNS, Some(&weights));
        let params = LsqParams { weights: Some(weights.clone()), ..params(Strategy::Auto) };
        let fit = solve(&sampling, DEGREE, &noise, params);
        let mut power = NoisePower::new(DEGREE);
        // Columns of noise may be added in groups of any size.
        for columns in [0..5, 5..NOISE_COLUMNS] {
            let residual = residual_square(fit.residual.slice(s![.., columns.clone()]), Some(&weights));
            power.add(fit.coefficients.values().slice(s![.., columns]), residual);
        }
        let left = (n - basis_size(DEGREE)) as f64;
        assert!((power.residual() / left - 1.0).abs() < 0.1, "{} {left}", power.residual());
        let of_moments = NoisePower::of_moments(&sums(&sampling, Some(&weights), &noise), &Silent).unwrap();
        assert_eq!(of_moments.residual(), left);
        for (l, (found, by_moments)) in power.by_degree().into_iter().zip(of_moments.by_degree()).enumerate() {
            let exact = trace.slice(s![l * l..(l + 1) * (l + 1)]).sum();
            // The power is the mean of 12 (2l + 1) values, which are correlated on such samplings: allow more than
            // three standard deviations.
            let allowed = 6.0 / ((NOISE_COLUMNS * (2 * l + 1)) as f64).sqrt();
            for found in [found, by_moments] {
                assert!((found / exact - 1.0).abs() < allowed, "{} {l}: {found:e}, {exact:e}", sampling.name);
            }
        }
    }
}

/// Returns samples of a function whose power decreases with the degree, without and with noise: (clean, noisy).
fn noisy(sampling: &Sampling, sigma: f64) -> (Array2<f64>, Array2<f64>) {
    let mut random = Random(7);
    let known = Array2::from_shape_fn((basis_size(DEGREE), 3), |(k, _)| random.normal() / (1.0 + k as f64).powf(1.2));
    let clean = matrix(&sampling.directions, DEGREE).dot(&known);
    let noise = random.normals(clean.nrows(), 3) * sigma;
    (clean.clone(), clean + noise)
}

#[test]
fn on_an_even_sampling_it_multiplies_by_the_gains() {
    let sampling = even(4000);
    let (_, targets) = noisy(&sampling, 0.5);
    let plain = solve(&sampling, DEGREE, &targets, params(Strategy::Auto));
    let mut power = NoisePower::new(DEGREE);
    // On an exactly even sampling, noise has the power 4 pi / n in each coefficient.
    let even_noise = Array2::from_elem((basis_size(DEGREE), 1), (4.0 * std::f64::consts::PI / 4000.0).sqrt());
    power.add(even_noise.view(), (4000 - basis_size(DEGREE)) as f64);
    let found = power.denoise(plain.coefficients.values().view(), residual_square(plain.residual.view(), None));
    assert!((found.sigma / 0.5 - 1.0).abs() < 0.03, "{}", found.sigma);
    assert!(found.gain[0] == 1.0 && found.penalty[0] == 0.0 && found.gain[DEGREE] < 0.9);
    let params = LsqParams { penalty: Some(found.penalty.clone()), ..params(Strategy::Auto) };
    let penalised = solve(&sampling, DEGREE, &targets, params);
    let gains = degree_penalty(&found.gain);
    let freedom: f64 = gains.iter().sum();
    assert!((found.degrees_of_freedom - freedom).abs() < 1e-9);
    let size = norms(plain.coefficients.values())[0];
    for (k, gain) in gains.into_iter().enumerate() {
        for c in 0..3 {
            let expected = gain * plain.coefficients.values()[[k, c]];
            assert!((penalised.coefficients.values()[[k, c]] - expected).abs() < 2e-3 * size, "{k} {c}");
        }
    }
}

#[test]
fn noise_is_found_and_most_of_it_removed_on_uneven_samplings() {
    for sampling in [irregular(600, 5), clustered(600)] {
        let (clean, targets) = noisy(&sampling, 0.3);
        let n = clean.nrows();
        let plain = solve(&sampling, DEGREE, &targets, params(Strategy::Auto));
        let noise = solve(&sampling, DEGREE, &white_noise(n, 0..NOISE_COLUMNS, None), params(Strategy::Auto));
        let mut power = NoisePower::new(DEGREE);
        power.add(noise.coefficients.values().view(), residual_square(noise.residual.view(), None));
        let found = power.denoise(plain.coefficients.values().view(), residual_square(plain.residual.view(), None));
        assert!((found.sigma / 0.3 - 1.0).abs() < 0.06, "{}", found.sigma);
        let params = LsqParams { penalty: Some(found.penalty.clone()), ..params(Strategy::Auto) };
        let penalised = solve(&sampling, DEGREE, &targets, params);
        let a = matrix(&sampling.directions, DEGREE);
        let error = |x: &Array2<f64>| (a.dot(x) - &clean).iter().map(|d| d * d).sum::<f64>();
        let (before, after) = (error(plain.coefficients.values()), error(penalised.coefficients.values()));
        assert!(after < 0.8 * before, "{}: {after} {before}", sampling.name);
    }
}

#[test]
fn without_noise_nothing_is_penalised() {
    let sampling = even(300);
    let (clean, _) = noisy(&sampling, 0.0);
    let plain = solve(&sampling, DEGREE, &clean, params(Strategy::Auto));
    let mut power = NoisePower::new(DEGREE);
    power.add(Array2::ones((basis_size(DEGREE), 1)).view(), 200.0);
    let found = power.denoise(plain.coefficients.values().view(), 0.0);
    assert_eq!((found.sigma, found.degrees_of_freedom), (0.0, basis_size(DEGREE) as f64));
    assert!(found.penalty.iter().all(|p| *p == 0.0) && found.gain_variance.iter().all(|variance| *variance == 0.0));
    let nothing = power.denoise(Array2::zeros((basis_size(DEGREE), 1)).view(), 0.0);
    assert!(nothing.gain.iter().chain(&nothing.penalty).all(|value| value.is_finite()));
}

/// A gain of 0 that 3 channels of 96 coefficients share: the variance is that of Morris's formula.
#[test]
fn uncertain_gains_widen_the_standard_errors() {
    let mut power = NoisePower::new(9);
    power.add(Array2::ones((100, 1)).view(), 500.0);
    // Noise of variance 0.25, and no signal above degree 1.
    let coefficients = Array2::from_shape_fn((100, 3), |(k, _)| if k < 4 { 10.0 } else { 0.4 });
    let found = power.denoise(coefficients.view(), 0.25 * 3.0 * 500.0);
    assert_eq!((found.sigma, found.gain[9]), (0.5, 0.0));
    let errors = found.with_uncertain_gains(Array2::from_elem((100, 3), 0.1));
    let k = 3.0 * 96.0;
    let (b, square) = ((k - 2.0) / k, 0.25);
    let morris = 0.25 * (1.0 - b) + 2.0 / (k - 2.0) * b * b * square;
    assert!((errors[[0, 0]] - 0.1).abs() < 1e-15, "degree 0 isn't damped");
    assert!((errors[[99, 2]].powi(2) - 0.01 - morris).abs() < 1e-12, "{} {morris}", errors[[99, 2]]);
}

#[test]
fn bad_penalties_and_too_few_rows_get_typed_errors() {
    let sampling = even(100);
    let targets = Random(1).normals(100, 1);
    let error = |penalty: Vec<f64>| {
        let params = LsqParams { penalty: Some(penalty), ..params(Strategy::Auto) };
        try_solve(&sampling, 4, &targets, params, &Silent).unwrap_err()
    };
    assert!(matches!(error(vec![1.0; 4]), SolverError::Penalties { expected: 5, found: 4 }));
    for bad in [-1.0, f64::NAN, f64::INFINITY] {
        assert!(matches!(error(vec![0.0, 1.0, bad, 0.0, 0.0]), SolverError::Penalty { degree: 2, .. }));
    }
    let few = even(81);
    let problem = sums(&few, None, &Random(1).normals(81, 1));
    let found = NoisePower::of_moments(&problem, &Silent).unwrap_err();
    assert!(matches!(found, SolverError::NoResidual { rows: 81, columns: 81 }), "{found}");
}
