//! Tests fits of values whose mean is much larger than their deviation from it.

use ndarray::Array2;
use spharm_harmonics::basis_size;
use spharm_monitor::Silent;
use spharm_solver::lsq::{Gcv, MomentProblem, choose_smoothness_by_moments, solve_moments};
use spharm_solver::{LsqParams, LsqSolver, SolverError};
use spharm_transform::{FINEST, SampleSums};

use crate::problems::{Random, Sampling, irregular, matrix, transforms, uneven_weights};

const DEGREE: usize = 8;

/// Returns a sampling, its weights, and a column of noisy values whose mean and deviation are about 1.
fn values() -> (Sampling, Vec<f64>, Array2<f64>) {
    let (sampling, mut random) = (irregular(500, 1), Random(2));
    let known = Array2::from_shape_fn((basis_size(DEGREE), 1), |(k, _)| random.normal() / (1.0 + k as f64));
    let values = matrix(&sampling.directions, DEGREE).dot(&known) + &(random.normals(500, 1) * 0.1);
    let weights = uneven_weights(500);
    (sampling, weights, values)
}

fn problem(sampling: &Sampling, weights: &[f64], values: &Array2<f64>) -> MomentProblem {
    let sums = SampleSums::new(&sampling.directions, Some(weights), values.view(), DEGREE, FINEST).unwrap();
    MomentProblem::new(&sums, DEGREE).unwrap()
}

#[test]
fn cross_validation_ignores_the_mean() {
    let (sampling, weights, values) = values();
    let operator = transforms(&sampling.directions, DEGREE);
    let by_samples = |mean: f64| -> Gcv {
        let params = LsqParams { weights: Some(weights.clone()), ..LsqParams::default() };
        let mut solver = LsqSolver::new(&operator, None, params).unwrap();
        solver.choose_smoothness(&(&values + mean), &Silent).unwrap()
    };
    let by_moments = |mean: f64| -> Gcv {
        choose_smoothness_by_moments(&problem(&sampling, &weights, &(&values + mean)), &Silent).unwrap()
    };
    for (without, with) in [(by_samples(0.0), by_samples(6_371_000.0)), (by_moments(0.0), by_moments(1e3))] {
        assert!((with.smoothness / without.smoothness - 1.0).abs() < 1e-6, "{with:?} {without:?}");
    }
}

#[test]
fn a_residual_below_the_rounding_errors_is_noticed() {
    let (sampling, weights, values) = values();
    let params = LsqParams::default();
    let of = |values: &Array2<f64>| problem(&sampling, &weights, values);
    let expected = solve_moments(&of(&values), &params, true, &Silent).unwrap();
    let found = solve_moments(&of(&(&values + 1e3)), &params, true, &Silent).unwrap();
    assert_eq!((expected.lost, found.lost), (vec![false], vec![false]));
    assert!((found.residual_squares[0] / expected.residual_squares[0] - 1.0).abs() < 1e-5);
    for mean in [1e6, -6_371_000.0, 1e9] {
        let problem = of(&(&values + mean));
        assert_eq!(solve_moments(&problem, &params, false, &Silent).unwrap().lost, [true]);
        let errors = solve_moments(&problem, &params, true, &Silent).map(|fit| fit.standard_errors);
        assert!(matches!(errors, Err(SolverError::LostResidual { column: 0 })), "{errors:?}");
        let smoothness = choose_smoothness_by_moments(&problem, &Silent);
        assert!(matches!(smoothness, Err(SolverError::LostResidual { column: 0 })), "{smoothness:?}");
    }
    // Values without noise have no residual, and a mean that isn't much larger than the deviation hides none.
    let exact = Array2::from_shape_fn((500, 1), |(i, _)| 2.0 + sampling.directions.as_slice()[i][2]);
    assert_eq!(solve_moments(&of(&exact), &params, true, &Silent).unwrap().lost, [false]);
}
