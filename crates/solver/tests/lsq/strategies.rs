//! Tests that every strategy gives the solution of the dense problem.

use std::fmt;
use std::sync::{Arc, Mutex};

use ndarray::{Array2, s};
use spharm_monitor::{Level, Monitor};
use spharm_solver::gram::smoothness_penalty;
use spharm_solver::lsq::{StepReport, Stop};
use spharm_solver::{GramMatrix, LsqParams, LsqSolver, Strategy, moment_gram, moment_normal};

use crate::problems::{
    ACCURACY, Random, STRATEGIES, clustered, dense, even, irregular, largest, matrix, norms, params, solve, transforms,
    uneven_weights,
};

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
            for strategy in STRATEGIES {
                let what =
                    format!("{}, {strategy:?}, weights {}, smoothness {smoothness}", sampling.name, weights.is_some());
                let params = LsqParams { weights: weights.clone(), smoothness, ..params(strategy) };
                let fit = solve(&sampling, max_degree, &targets, params);
                assert_eq!(fit.report.stop, Stop::Converged, "{what}");
                assert!(fit.report.optimality <= 2e-10, "{what}: {}", fit.report.optimality);
                expected.meets(&fit, fit.report.optimality, &what);
                // Recompute the reported values by direct sums.
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
                // If a target is nearly orthogonal to the basis, errors are larger relative to the target's component
                // in the basis.
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
    // One column is far smaller than the others, to check that each column has its own optimality.
    targets.column_mut(6).mapv_inplace(|v| 1e-9 * v);
    let expected = dense(&matrix(&sampling.directions, 7), &targets, None, 0.0);
    for strategy in STRATEGIES {
        let together = solve(&sampling, 7, &targets, params(strategy));
        assert_eq!(together.report.stop, Stop::Converged);
        expected.meets(&together, 2e-10, &format!("{strategy:?}"));
        assert!(together.coefficients.values().column(5).iter().all(|v| *v == 0.0));
        for c in [0, 5, 6] {
            let one = targets.slice(s![.., c..c + 1]).to_owned();
            let alone = solve(&sampling, 7, &one, params(strategy));
            let both = [&together, &alone].map(|fit| fit.coefficients.values().clone());
            let off = norms(&(&both[0].slice(s![.., c..c + 1]) - &both[1]))[0];
            assert!(off <= 1e-8 * norms(&both[1])[0], "{strategy:?}, column {c}: {off:.1e}");
        }
    }
    let nothing = Array2::zeros((500, 2));
    for strategy in STRATEGIES {
        let fit = solve(&sampling, 7, &nothing, params(strategy));
        assert_eq!(
            (fit.report.stop, fit.report.norm, fit.report.optimality),
            (Stop::Converged, 0.0, 0.0),
            "{strategy:?}"
        );
    }
}

#[test]
fn too_few_iterations_end_with_the_best_solution_so_far() {
    let sampling = irregular(400, 4);
    let targets = Random(5).normals(400, 3);
    let a = matrix(&sampling.directions, 12);
    let mut before = f64::INFINITY;
    for (max_iterations, strategy) in [(1, Strategy::Cg), (4, Strategy::Cg), (16, Strategy::Cg), (16, Strategy::Auto)] {
        let fit = solve(&sampling, 12, &targets, LsqParams { max_iterations, ..params(strategy) });
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

/// A monitor that records the details logged by a solver.
#[derive(Default)]
struct Details(Mutex<Vec<String>>);

impl Monitor for Details {
    fn note(&self, level: Level, text: fmt::Arguments<'_>) {
        if level == Level::Detail {
            self.0.lock().unwrap().push(text.to_string());
        }
    }
}

#[test]
fn plans_are_noted_and_the_report_has_the_steps_that_were_taken_and_why() {
    const DEGREE: usize = 14;
    let sampling = irregular(400, 4);
    let operator = transforms(&sampling.directions, DEGREE);
    let gram = || Ok(Box::new(moment_gram(&sampling.directions, None, DEGREE)?) as Box<dyn GramMatrix>);
    let moments = |accuracy: f64, _: Option<&Array2<f64>>| {
        Ok((Arc::new(moment_normal(&sampling.directions, None, DEGREE, accuracy)?), None))
    };
    let targets = Random(3).normals(400, 3);
    let taken = |params: LsqParams| {
        let details = Details::default();
        let mut solver = LsqSolver::new(&operator, Some(&gram), params).unwrap().with_moments(&moments);
        let report = solver.fit(&targets, std::slice::from_ref(&(0..3)), &details).unwrap().report;
        let why = |step: &StepReport| (step.name, step.left.clone().unwrap_or_default());
        for step in &report.steps {
            assert!(step.fits == 1 && step.seconds >= 0.0 && step.optimality.is_finite(), "{step:?}");
            assert!(!step.why.is_empty(), "{step:?}");
        }
        let steps: Vec<_> = report.steps.iter().map(why).collect();
        assert_eq!(
            report.steps.iter().map(|step| step.iterations).sum::<usize>(),
            report.iterations + report.refinements
        );
        assert_eq!(report.steps.last().unwrap().optimality, report.optimality);
        (steps, details.0.into_inner().unwrap())
    };
    let of =
        |steps: &[(&'static str, &str)]| steps.iter().map(|(name, why)| (*name, (*why).to_owned())).collect::<Vec<_>>();
    let (steps, notes) = taken(params(Strategy::Auto));
    let expected = [
        ("moments", ""),
        ("iterations by moments", "a factorisation seems faster"),
        ("factor", ""),
        ("refinement", ""),
    ];
    assert_eq!(steps, of(&expected));
    assert_eq!(notes.len(), 5, "{notes:?}");
    assert!(notes[0].starts_with("step 1: computation of the moments of the samples ("), "{notes:?}");
    let (steps, _) = taken(LsqParams { memory: 1 << 20, max_iterations: 100, ..params(Strategy::Auto) });
    assert!(steps[2].0 == "factor" && steps[2].1.starts_with("no Cholesky factor was computed"), "{steps:?}");
    assert_eq!(
        steps[3..],
        of(&[("iterations by moments", "the maximum number of iterations was reached"), ("confirmation", "")])
    );
    let (steps, notes) = taken(LsqParams { max_iterations: 5, ..params(Strategy::Cg) });
    let expected = [
        ("moments", ""),
        ("iterations by moments", "the maximum number of iterations was reached"),
        ("confirmation", ""),
    ];
    assert_eq!((steps, notes.len()), (of(&expected), 2));
}
