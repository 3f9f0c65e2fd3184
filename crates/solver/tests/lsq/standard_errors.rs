//! Tests standard errors of the coefficients.

use ndarray::Array2;
use spharm_harmonics::basis_size;
use spharm_monitor::Silent;
use spharm_solver::gram::smoothness_penalty;
use spharm_solver::{GramMatrix, LsqParams, LsqSolver, SolverError, Strategy, moment_gram};

use crate::problems::{
    Random, Sampling, cap, clustered, diagonal, even, inverse, irregular, matrix, params, transforms, uneven_weights,
};

/// The squares of standard errors are the diagonal of sigma^2 N^-1 A^T W A N^-1 with N = A^T W A + P, with a smoothness
/// as well. For penalties by degree, they are the diagonal of sigma^2 N^-1, the variances of the posterior.
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
        let gram_matrix = a.t().dot(&weighted);
        let inverse = inverse(&(&gram_matrix + &penalty));
        let sampling_variance = inverse.dot(&gram_matrix).dot(&inverse);
        let by_degree = (0..=max_degree).map(|l| smoothness * ((l * (l + 1)) as f64).powi(2)).collect::<Vec<f64>>();
        let operator = transforms(&sampling.directions, max_degree);
        let gram = || {
            let gram = moment_gram(&sampling.directions, Some(&weights), max_degree)?;
            Ok(Box::new(gram) as Box<dyn GramMatrix>)
        };
        for (strategy, prior) in
            [(Strategy::Auto, false), (Strategy::Cg, false), (Strategy::Cholesky, false), (Strategy::Auto, true)]
        {
            let with_penalty = match prior {
                true => LsqParams { penalty: Some(by_degree.clone()), ..params(strategy) },
                false => LsqParams { smoothness, ..params(strategy) },
            };
            let variances = if prior { &inverse } else { &sampling_variance };
            let params = LsqParams { weights: Some(weights.clone()), ..with_penalty };
            let mut solver = LsqSolver::new(&operator, Some(&gram), params).unwrap();
            let fit = solver.fit(&targets, std::slice::from_ref(&(0..2)), &Silent).unwrap();
            let errors = solver.standard_errors(&fit.residual, &Silent).unwrap();
            assert_eq!(errors.dim(), (k, 2));
            // Degrees of freedom of the residual: number of rows with nonzero weight minus the trace of the hat matrix.
            let free = (n - 1) as f64 - inverse.dot(&gram_matrix).diag().sum();
            for c in 0..2 {
                let square: f64 = fit.residual.column(c).iter().zip(&weights).map(|(r, w)| w * r * r).sum();
                for j in 0..k {
                    let expected = (square / free * variances[[j, j]]).sqrt();
                    let off = (errors[[j, c]] / expected - 1.0).abs();
                    assert!(off < 1e-8, "{} {strategy:?}, {j}: {} not {expected}", sampling.name, errors[[j, c]]);
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
    // Noise of variance 0.01 / w, with a column for each draw.
    let mut targets = random.normals(150, DRAWS) * 0.1;
    for (mut row, weight) in targets.rows_mut().into_iter().zip(&weights) {
        row /= weight.sqrt();
    }
    targets += &a.dot(&known);
    let operator = transforms(&sampling.directions, 4);
    let gram = || Ok(Box::new(moment_gram(&sampling.directions, Some(&weights), 4)?) as Box<dyn GramMatrix>);
    let params = LsqParams { weights: Some(weights.clone()), ..params(Strategy::Auto) };
    let mut solver = LsqSolver::new(&operator, Some(&gram), params).unwrap();
    let fit = solver.fit(&targets, std::slice::from_ref(&(0..DRAWS)), &Silent).unwrap();
    let errors = solver.standard_errors(&fit.residual, &Silent).unwrap();
    for k in 0..25 {
        let off = fit.coefficients.values().row(k).mapv(|x| (x - known[[k, 0]]).powi(2));
        let (spread, told) = (off.mean().unwrap().sqrt(), errors.row(k).mean().unwrap());
        assert!((spread / told - 1.0).abs() < 0.2, "coefficient {k}: {spread}, told {told}");
    }
}

#[test]
fn standard_errors_of_what_is_not_determined_are_refused() {
    let refused = |sampling: &Sampling, max_degree: usize, smoothness: f64| {
        let targets = Random(1).normals(sampling.directions.len(), 1);
        let operator = transforms(&sampling.directions, max_degree);
        let gram = || Ok(Box::new(moment_gram(&sampling.directions, None, max_degree)?) as Box<dyn GramMatrix>);
        let params = LsqParams { smoothness, ..params(Strategy::Auto) };
        let mut solver = LsqSolver::new(&operator, Some(&gram), params).unwrap();
        let fit = solver.fit(&targets, std::slice::from_ref(&(0..1)), &Silent).unwrap();
        solver.standard_errors(&fit.residual, &Silent).unwrap_err()
    };
    for (sampling, max_degree) in [(even(80), 9), (cap(400, 0.3), 9)] {
        let error = refused(&sampling, max_degree, 0.0);
        assert!(matches!(error, SolverError::Underdetermined { columns: 100, .. }), "{error}");
        assert!(error.to_string().contains("smoothness"), "{error}");
    }
    // A penalty that is too large or too small gets another advice.
    for (sampling, smoothness, expected) in [(even(400), 1e14, "smaller"), (cap(400, 0.3), 1e-22, "larger")] {
        let error = refused(&sampling, 9, smoothness);
        let right = matches!(error, SolverError::UnderdeterminedWithPenalty { needed, .. } if needed == expected);
        assert!(right, "{error}");
    }
}
