//! Tests that components that the samples don't determine stay small.

use ndarray::{Array2, s};
use spharm_harmonics::{Directions, basis_size};
use spharm_monitor::Silent;
use spharm_solver::lsq::LsqWarning;
use spharm_solver::{IrfParams, LsqParams, MemoryOperator, Method, Strategy, irf};

use crate::problems::{Random, Sampling, cap, dense, irregular, matrix, norms, params, solve, svd};

/// Returns the mean squared residual of the least-squares fit that is restricted to the singular vectors with values
/// above `cut` times the largest.
fn truncated(a: &Array2<f64>, targets: &Array2<f64>, cut: f64) -> f64 {
    let (u, singular, _) = svd(a);
    let count = singular.iter().filter(|value| **value > cut * singular[0]).count();
    let u = u.slice(s![.., ..count]).to_owned();
    (targets - &u.dot(&u.t().dot(targets))).iter().map(|r| r * r).sum::<f64>() / a.nrows() as f64
}

#[test]
fn what_the_sampling_does_not_determine_stays_small_and_is_told() {
    // Every direction of this sampling occurs twice; the other samplings are caps.
    let twice = {
        let few = irregular(90, 6).directions;
        let directions = Directions::from_vertices(&few.as_slice().repeat(2)).unwrap();
        Sampling { name: "twice", directions }
    };
    for (sampling, max_degree) in [(cap(400, 0.3), 9), (twice, 10), (cap(600, 1.0), 12)] {
        let n = sampling.directions.len();
        assert!(n >= basis_size(max_degree));
        let operator = MemoryOperator::new(&sampling.directions, max_degree, 64).unwrap();
        // The targets are smooth functions that aren't in the basis, with a little noise.
        let mut targets = Random(11).normals(n, 2) * 1e-3;
        for (mut row, v) in targets.rows_mut().into_iter().zip(sampling.directions.as_slice()) {
            row[0] += (3.0 * v[0]).sin() * v[2].exp();
            row[1] += 1.0 / (1.5 + v[1]);
        }
        let nlsf = IrfParams { max_degree, method: Method::Nlsf, refinements: 2, ..IrfParams::default() };
        let least = irf::solve(&operator, targets.view(), std::slice::from_ref(&(0..2)), &nlsf, &Silent).unwrap();
        assert_eq!(least.report.blocks[0].solver, "rank-revealing");
        let a = matrix(&sampling.directions, max_degree);
        let least = least.report.history.last().unwrap().residuals[0].mean_square;
        for strategy in [Strategy::Auto, Strategy::Cholesky] {
            let found = solve(&sampling, max_degree, &targets, params(strategy));
            let report = &found.report;
            let what = format!("{} {strategy:?} least {least:e} {report:?}", sampling.name);
            assert!(found.coefficients.values().iter().all(|v| v.is_finite()), "{what}");
            assert!(report.norm < 1e6, "{what}");
            assert!(report.shift > 0.0 && report.shift < 1e-9 && report.condition.is_infinite(), "{what}");
            let [column, degree] = report.breaks_at.expect(&what);
            assert!(column < basis_size(max_degree) && degree == column.isqrt() && degree > 0, "{what}");
            // The residual is between the smallest possible residual and that of the components that the shift can
            // distinguish from zero.
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
    for strategy in [Strategy::Auto, Strategy::Cg, Strategy::Cholesky] {
        let fit = solve(&sampling, 11, &targets, params(strategy));
        let what = format!("{strategy:?} {:?}", fit.report);
        assert!(fit.report.residuals[0].mean_square < 1e-14, "{what}");
        let least = norms(&expected.x);
        let found = norms(fit.coefficients.values());
        assert!(found.iter().zip(&least).all(|(found, least)| *found < 1.05 * least), "{found:?} {least:?} {what}");
        let off = norms(&(fit.coefficients.values() - &expected.x));
        assert!(off.iter().zip(&least).all(|(off, norm)| *off < 1e-4 * norm), "{off:?} {what}");
    }
}

/// Directions of weight 0 don't count: with the others alone, the problem is that of the test above.
#[test]
fn with_more_coefficients_than_directions_of_nonzero_weight_the_solution_is_the_shortest() {
    let sampling = irregular(600, 8);
    let targets = Random(5).normals(600, 3);
    let weights: Vec<f64> = (0..600).map(|i| if i % 8 == 0 { 1.0 } else { 0.0 }).collect();
    let expected = dense(&matrix(&sampling.directions, 11), &targets, Some(&weights), 0.0);
    let least = norms(&expected.x);
    for strategy in [Strategy::Auto, Strategy::Cg, Strategy::DensityCg, Strategy::Cholesky] {
        let fit = solve(&sampling, 11, &targets, LsqParams { weights: Some(weights.clone()), ..params(strategy) });
        let what = format!("{strategy:?} {:?}", fit.report);
        let off = norms(&(fit.coefficients.values() - &expected.x));
        assert!(off.iter().zip(&least).all(|(off, norm)| *off < 1e-4 * norm), "{off:?} {least:?} {what}");
        let warnings = &fit.report.warnings;
        assert!(warnings.iter().any(|w| matches!(w, LsqWarning::Underdetermined { rows: 75, columns: 144, .. })));
        let refused = warnings.iter().any(|w| matches!(w, LsqWarning::NoFactor { .. }));
        assert_eq!(refused, strategy == Strategy::Cholesky, "{what}");
    }
}
