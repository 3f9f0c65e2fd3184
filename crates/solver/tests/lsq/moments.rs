//! Tests fits from moments against the dense solution and against the same fit from the samples.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::{Array2, ArrayView2, s};
use spharm_harmonics::{Directions, basis_size};
use spharm_monitor::Silent;
use spharm_solver::lsq::{
    LsqWarning, MomentProblem, Stop, choose_smoothness_by_moments, determined, solve_moments, solve_moments_of_groups,
};
use spharm_solver::{
    GramMatrix, LsqFit, LsqParams, LsqSolver, MatrixFreeOperator, Operator, SolverError, Strategy, moment_gram,
    moment_normal,
};
use spharm_transform::{FINEST, SampleSums, TransformParams};

use crate::problems::{
    Random, Sampling, cap, clustered, dense, even, irregular, matrix, norms, params, solve, transforms, uneven_weights,
};

fn sums(sampling: &Sampling, weights: Option<&[f64]>, targets: &Array2<f64>, max_degree: usize) -> SampleSums {
    SampleSums::new(&sampling.directions, weights, targets.view(), max_degree, FINEST).unwrap()
}

#[test]
fn moments_give_the_dense_solution_by_every_strategy() {
    const DEGREE: usize = 9;
    for (sampling, smoothness) in [(irregular(400, 1), 0.0), (clustered(400), 1e-2), (even(300), 0.0)] {
        let n = sampling.directions.len();
        let weights = uneven_weights(n);
        let targets = Random(2).normals(n, 3);
        let expected = dense(&matrix(&sampling.directions, DEGREE), &targets, Some(&weights), smoothness);
        let problem = MomentProblem::new(&sums(&sampling, Some(&weights), &targets, DEGREE), DEGREE).unwrap();
        assert_eq!((problem.rows(), problem.channels(), problem.max_degree()), (n, 3, DEGREE));
        for strategy in [Strategy::Auto, Strategy::Cg, Strategy::Cholesky] {
            let params = LsqParams { smoothness, ..params(strategy) };
            let fit = solve_moments(&problem, &params, false, &Silent).unwrap();
            assert!(fit.report.optimality <= 1e-10, "{} {strategy:?}: {:?}", sampling.name, fit.report);
            assert_eq!((fit.report.products, fit.report.rows), ("moments", n));
            let off = norms(&(fit.coefficients.values() - &expected.x));
            for (off, norm) in off.into_iter().zip(norms(&expected.x)) {
                assert!(off < 1e-8 * norm, "{} {strategy:?}: off by {off:.1e} of {norm:.1e}", sampling.name);
            }
        }
    }
}

#[test]
fn residual_and_standard_errors_are_those_of_the_samples() {
    for (sampling, max_degree, smoothness) in [(irregular(300, 3), 8, 0.0), (clustered(300), 6, 1e-2)] {
        let n = sampling.directions.len();
        let mut weights = uneven_weights(n);
        weights[7] = 0.0;
        let targets = Random(5).normals(n, 2);
        let operator = transforms(&sampling.directions, max_degree);
        let gram = || {
            let gram = moment_gram(&sampling.directions, Some(&weights), max_degree)?;
            Ok(Box::new(gram) as Box<dyn GramMatrix>)
        };
        let params = LsqParams { smoothness, ..params(Strategy::Auto) };
        let with_weights = LsqParams { weights: Some(weights.clone()), ..params.clone() };
        let mut solver = LsqSolver::new(&operator, Some(&gram), with_weights).unwrap();
        let by_samples = solver.fit(&targets, std::slice::from_ref(&(0..2)), &Silent).unwrap();
        let expected = solver.standard_errors(&by_samples.residual, &Silent).unwrap();

        let problem = MomentProblem::new(&sums(&sampling, Some(&weights), &targets, max_degree), max_degree).unwrap();
        assert_eq!(problem.rows(), n - 1);
        let fit = solve_moments(&problem, &params, true, &Silent).unwrap();
        for c in 0..2 {
            let column = by_samples.residual.column(c);
            let square: f64 = column.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
            assert!((fit.residual_squares[c] / square - 1.0).abs() < 1e-9, "{:?} {square}", fit.residual_squares);
        }
        let found = fit.standard_errors.unwrap();
        let off = (&found - &expected).iter().zip(&expected).fold(0.0f64, |most, (off, e)| most.max(off.abs() / e));
        assert!(off < 1e-8, "{}: {off:.1e}", sampling.name);
    }
}

#[test]
fn cross_validation_finds_the_smoothness_that_the_samples_give() {
    for (sampling, weights) in [(irregular(500, 4), None), (clustered(500), Some(uneven_weights(500)))] {
        let a = matrix(&sampling.directions, 10);
        let mut random = Random(6);
        let known = Array2::from_shape_fn((basis_size(10), 2), |(k, _)| random.normal() / (1.0 + k as f64));
        let targets = a.dot(&known) + &(random.normals(500, 2) * 0.05);
        let operator = transforms(&sampling.directions, 10);
        let params = LsqParams { weights: weights.clone(), ..LsqParams::default() };
        let mut solver = LsqSolver::new(&operator, None, params).unwrap();
        let expected = solver.choose_smoothness(&targets, &Silent).unwrap();
        let problem = MomentProblem::new(&sums(&sampling, weights.as_deref(), &targets, 10), 10).unwrap();
        let found = choose_smoothness_by_moments(&problem, &Silent).unwrap();
        assert!((found.smoothness / expected.smoothness - 1.0).abs() < 1e-6, "{found:?} {expected:?}");
        for (found, expected) in found.tried.iter().zip(&expected.tried) {
            assert!((found[1] / expected[1] - 1.0).abs() < 1e-6, "{found:?} {expected:?}");
        }
    }
}

#[test]
fn a_lower_degree_needs_no_other_sums() {
    let (sampling, targets) = (irregular(600, 7), Random(8).normals(600, 1));
    let of = |degree: usize, sums: &SampleSums| {
        let problem = MomentProblem::new(sums, degree).unwrap();
        solve_moments(&problem, &LsqParams::default(), false, &Silent).unwrap().coefficients.values().to_owned()
    };
    let to_twelve = sums(&sampling, None, &targets, 12);
    let (found, expected) = (of(7, &to_twelve), of(7, &sums(&sampling, None, &targets, 7)));
    assert!(norms(&(&found - &expected))[0] < 1e-9 * norms(&expected)[0]);
    assert!(matches!(MomentProblem::new(&to_twelve, 13), Err(SolverError::MomentsDegree { found: 13, .. })));
}

/// Returns the recomputed gradient of a solution x relative to the right-hand sides: the maximum over all columns.
fn optimality_of(problem: &MomentProblem, right_sides: &Array2<f64>, x: ArrayView2<'_, f64>) -> f64 {
    let gradient = right_sides - &problem.operator().apply(x).unwrap();
    norms(&gradient).into_iter().zip(norms(right_sides)).map(|(g, b)| g / b).fold(0.0, f64::max)
}

/// On even samplings the gradient of the iterations isn't recomputed at the end, and its reported size is correct.
#[test]
fn the_optimality_of_each_group_is_that_of_its_solution() {
    let (sampling, targets) = (even(1500), Random(10).normals(1500, 5));
    let sums = sums(&sampling, None, &targets, 12);
    let problem = MomentProblem::new(&sums, 12).unwrap();
    let groups = [0..3, 3..4, 4..5];
    for tolerance in [1e-6, 1e-10, 1e-13] {
        let params = LsqParams { tolerance, ..LsqParams::default() };
        let fits = solve_moments_of_groups(&problem, &groups, &params, &Silent).unwrap();
        for (group, fit) in groups.iter().zip(fits) {
            let own = problem.of_columns(group.clone());
            let alone = solve_moments(&own, &params, false, &Silent).unwrap();
            assert_eq!(fit.coefficients.values(), alone.coefficients.values());
            let right_sides = sums.right_sides.slice(s![.., group.clone()]).to_owned();
            let found = optimality_of(&problem, &right_sides, fit.coefficients.values().view());
            assert!(fit.report.optimality <= 1.5 * tolerance.max(2e-14), "{}", fit.report.optimality);
            assert!(found <= fit.report.optimality + 1e-15, "{found:.1e} {:.1e}", fit.report.optimality);
            // The reported optimality includes the estimated error of the gradient, unless the gradient was recomputed,
            // as it is near the last digits.
            let carried = fit.report.optimality - found > 0.5e-13;
            assert_eq!(carried, tolerance > 1e-12, "{found:.1e} {:.1e}", fit.report.optimality);
        }
    }
}

/// Products and iterations process three columns at a time: further columns don't change a group's bits.
#[test]
fn columns_of_many_have_the_bits_that_they_have_with_their_own_few() {
    let (sampling, mut targets) = (irregular(900, 5), Random(11).normals(900, 8));
    // The columns of the second group are zero, so this group needs fewer iterations than the others.
    targets.slice_mut(s![.., 3..6]).fill(0.0);
    let sums = sums(&sampling, None, &targets, 11);
    let problem = MomentProblem::new(&sums, 11).unwrap();
    for (strategy, max_iterations) in [(Strategy::Cg, 3000), (Strategy::Cg, 3), (Strategy::Auto, 3)] {
        let params = LsqParams { strategy, max_iterations, ..LsqParams::default() };
        let all = solve_moments(&problem, &params, false, &Silent).unwrap();
        let alone = [0..3, 3..6, 6..8].map(|group| {
            let own = solve_moments(&problem.of_columns(group.clone()), &params, false, &Silent).unwrap();
            assert_eq!(all.coefficients.values().slice(s![.., group.clone()]), own.coefficients.values(), "{group:?}");
            assert!(own.report.condition <= all.report.condition && own.report.optimality <= all.report.optimality);
            own.report.iterations
        });
        assert!(alone[1] == 0 && alone[0] >= 3, "{alone:?}");
        assert_eq!(Some(&all.report.iterations), alone.iter().max());
        assert_eq!(all.report.stop == Stop::Converged, max_iterations > 3);
    }
}

/// Whatever the condition number, the error of the iteration's gradient is at most the reported one, and near the last
/// digits the gradient is recomputed.
#[test]
fn the_gradient_of_an_ill_conditioned_problem_is_as_good_as_it_is_said_to_be() {
    for (sampling, tolerance, carried) in
        [(irregular(240, 3), 1e-10, true), (irregular(240, 6), 1e-10, true), (irregular(240, 6), 1e-12, false)]
    {
        let targets = Random(11).normals(240, 1);
        let sums = sums(&sampling, None, &targets, 12);
        let problem = MomentProblem::new(&sums, 12).unwrap();
        let params = LsqParams { tolerance, strategy: Strategy::Cg, ..LsqParams::default() };
        let fit = solve_moments(&problem, &params, false, &Silent).unwrap();
        let found = optimality_of(&problem, &sums.right_sides, fit.coefficients.values().view());
        assert!(fit.report.condition > 20.0, "{:?}", fit.report);
        assert!(found <= fit.report.optimality + 1e-15, "{found:.1e} {:?}", fit.report);
        assert_eq!(fit.report.optimality - found > 1e-14, carried, "{found:.1e} {:?}", fit.report);
    }
}

#[test]
fn what_the_samples_dont_determine_stays_small_and_is_said() {
    let sampling = cap(400, 0.5);
    let targets = Random(9).normals(400, 1);
    let problem = MomentProblem::new(&sums(&sampling, None, &targets, 14), 14).unwrap();
    let fit = solve_moments(&problem, &LsqParams::default(), false, &Silent).unwrap();
    assert!(fit.report.shift > 0.0 && fit.report.condition.is_infinite(), "{:?}", fit.report);
    let by_samples = solve(&sampling, 14, &targets, LsqParams::default());
    assert!(fit.report.norm < 10.0 * by_samples.report.norm, "{:?} {:?}", fit.report, by_samples.report);
    let errors = solve_moments(&problem, &LsqParams::default(), true, &Silent);
    assert!(matches!(errors, Err(SolverError::Underdetermined { .. })));
}

#[test]
fn sums_that_are_none_are_refused() {
    let (sampling, targets) = (even(100), Random(9).normals(100, 1));
    let good = sums(&sampling, None, &targets, 3);
    let of = |change: &dyn Fn(&mut SampleSums)| {
        let mut sums = good.clone();
        change(&mut sums);
        MomentProblem::new(&sums, 3).map(|_| ())
    };
    assert!(of(&|_| ()).is_ok());
    assert!(matches!(of(&|sums| sums.count = 0), Err(SolverError::NoSamples { .. })));
    assert!(matches!(of(&|sums| sums.weight = 0.0), Err(SolverError::NoSamples { .. })));
    assert!(matches!(of(&|sums| sums.squares[0] = f64::NAN), Err(SolverError::SumsNotFinite)));
    assert!(matches!(of(&|sums| sums.right_sides[[2, 0]] = f64::INFINITY), Err(SolverError::SumsNotFinite)));
    assert!(matches!(of(&|sums| sums.moments[5] = f64::NAN), Err(SolverError::Transform(_))));
    assert!(matches!(of(&|sums| sums.moments.truncate(48)), Err(SolverError::Transform(_))));
    let rough = LsqParams { smoothness: -1.0, ..LsqParams::default() };
    let problem = MomentProblem::new(&good, 3).unwrap();
    assert!(matches!(solve_moments(&problem, &rough, false, &Silent), Err(SolverError::Smoothness { .. })));
    let short = SampleSums { right_sides: good.right_sides.slice(s![..9, ..]).to_owned(), ..good.clone() };
    assert!(matches!(MomentProblem::new(&short, 3), Err(SolverError::Sums { expected: 16, found: 9, .. })));
}

/// Fits two batches with moments in addition to the samples. The weights of the moments, `of_moments`, may differ from
/// those of the fit. Returns the fits, and the number of times that moments were computed.
fn fit_with_moments(
    sampling: &Sampling,
    targets: &Array2<f64>,
    of_moments: Option<&[f64]>,
    params: LsqParams,
) -> ([LsqFit; 2], usize) {
    const DEGREE: usize = 8;
    let operator = transforms(&sampling.directions, DEGREE);
    let made = AtomicUsize::new(0);
    let moments = |accuracy: f64, _: Option<&Array2<f64>>| {
        made.fetch_add(1, Ordering::Relaxed);
        Ok((Arc::new(moment_normal(&sampling.directions, of_moments, DEGREE, accuracy)?), None))
    };
    let mut solver = LsqSolver::new(&operator, None, params).unwrap().with_moments(&moments);
    let columns = 0..targets.ncols();
    let fits = [(); 2].map(|()| solver.fit(targets, std::slice::from_ref(&columns), &Silent).unwrap());
    (fits, made.into_inner())
}

#[test]
fn iterations_take_moments_of_many_samples_once_and_give_the_dense_solution() {
    for (sampling, smoothness) in [(irregular(6000, 10), 0.0), (clustered(6000), 1e-2)] {
        let weights = uneven_weights(6000);
        let targets = Random(11).normals(6000, 2);
        let expected = dense(&matrix(&sampling.directions, 8), &targets, Some(&weights), smoothness);
        for strategy in [Strategy::Auto, Strategy::Cg, Strategy::DensityCg] {
            let params = LsqParams { smoothness, weights: Some(weights.clone()), ..params(strategy) };
            let ([fit, _], made) = fit_with_moments(&sampling, &targets, Some(&weights), params);
            expected.meets(&fit, fit.report.optimality, sampling.name);
            assert!(fit.report.optimality <= 1.5e-10 && fit.report.warnings.is_empty(), "{:?}", fit.report);
            assert_eq!((made, fit.report.products), (1, "moments"));
        }
    }
}

/// Transforms that count the calls of the adjoint.
#[derive(Debug)]
struct Counted(MatrixFreeOperator, AtomicUsize);

impl Operator for Counted {
    fn rows(&self) -> usize {
        self.0.rows()
    }

    fn max_degree(&self) -> usize {
        self.0.max_degree()
    }

    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        self.0.apply(x)
    }

    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        self.1.fetch_add(1, Ordering::Relaxed);
        self.0.apply_adjoint(r)
    }

    fn normal(&self, x: ArrayView2<'_, f64>, weights: Option<&[f64]>) -> Result<Array2<f64>, SolverError> {
        self.0.normal(x, weights)
    }
}

#[test]
fn where_moments_are_exact_enough_the_residual_tells_that_the_tolerance_is_met() {
    for (sampling, weights, adjoints) in [
        (irregular(6000, 16), None, 1),
        (irregular(6000, 17), Some(uneven_weights(6000)), 1),
        // The density is too large at one pole for moments to suffice: the gradient is also computed from the samples.
        (clustered(6000), None, 2),
    ] {
        let operator = Counted(transforms(&sampling.directions, 8), AtomicUsize::new(0));
        let targets = Random(18).normals(6000, 2);
        let make = |accuracy, _: Option<&Array2<f64>>| {
            Ok((Arc::new(moment_normal(&sampling.directions, weights.as_deref(), 8, accuracy)?), None))
        };
        let params = LsqParams { weights: weights.clone(), ..params(Strategy::Cg) };
        let mut solver = LsqSolver::new(&operator, None, params).unwrap().with_moments(&make);
        let fit = solver.fit(&targets, std::slice::from_ref(&(0..2)), &Silent).unwrap();
        assert_eq!(fit.report.products, "moments");
        assert_eq!(operator.1.load(Ordering::Relaxed), adjoints, "{}", sampling.name);
        let synthesis = operator.apply(fit.coefficients.values().view()).unwrap();
        assert_eq!(fit.residual, &targets - &synthesis);
        // The reported optimality is at least that of the gradient recomputed from the samples.
        let adjoint_of = |samples: &Array2<f64>| {
            let mut weighted = samples.clone();
            let weights = weights.iter().flatten();
            weighted.rows_mut().into_iter().zip(weights).for_each(|(mut row, &w)| row *= w);
            norms(&operator.apply_adjoint(weighted.view()).unwrap())
        };
        let optimality = adjoint_of(&fit.residual).into_iter().zip(adjoint_of(&targets)).map(|(g, b)| g / b);
        let optimality = optimality.fold(0.0, f64::max);
        assert!(optimality <= fit.report.optimality * (1.0 + 1e-6), "{optimality:e} {:?}", fit.report);
        assert!(fit.report.optimality <= 1.5e-10, "{:?}", fit.report);
    }
}

#[test]
fn right_sides_that_come_with_moments_are_those_of_the_samples() {
    let sampling = irregular(6000, 19);
    let targets = Random(20).normals(6000, 2);
    let weights = uneven_weights(6000);
    let expected = dense(&matrix(&sampling.directions, 8), &targets, Some(&weights), 0.0);
    let transform = TransformParams { max_degree: 8, accuracy: 1e-13, ..TransformParams::default() };
    let shared = MatrixFreeOperator::with_moments(&sampling.directions, &transform).unwrap();
    let operator = Counted(shared, AtomicUsize::new(0));
    let make = |accuracy, targets: Option<&Array2<f64>>| {
        let (moments, right_sides) = operator.0.moments(&sampling.directions, Some(&weights), accuracy, targets)?;
        Ok((Arc::new(moments), right_sides))
    };
    let params = LsqParams { weights: Some(weights.clone()), ..params(Strategy::Cg) };
    let mut solver = LsqSolver::new(&operator, None, params).unwrap().with_moments(&make);
    // Right-hand sides are computed with the moments for the first batch, and by the adjoint for the second.
    for adjoints in [0, 1] {
        let fit = solver.fit(&targets, std::slice::from_ref(&(0..2)), &Silent).unwrap();
        expected.meets(&fit, fit.report.optimality, sampling.name);
        assert_eq!((fit.report.products, operator.1.load(Ordering::Relaxed)), ("moments", adjoints));
    }
}

#[test]
fn moments_that_lose_digits_give_way_to_the_samples() {
    let sampling = irregular(6000, 12);
    let targets = Random(13).normals(6000, 1);
    let expected = dense(&matrix(&sampling.directions, 8), &targets, None, 0.0);
    // Moments for other weights don't give the solution.
    let others: Vec<f64> = (0..6000).map(|i| if i % 3 == 0 { 0.1 } else { 0.3 }).collect();
    let (fits, made) = fit_with_moments(&sampling, &targets, Some(&others), params(Strategy::Auto));
    for (fit, warnings) in fits.iter().zip([1, 0]) {
        expected.meets(fit, fit.report.optimality, "others");
        assert_eq!((fit.report.products, fit.report.warnings.len()), ("samples", warnings), "{:?}", fit.report);
        assert!(fit.report.optimality <= 1.5e-10, "{:?}", fit.report);
    }
    assert_eq!(made, 1, "not again for the next batch");
}

#[test]
fn moments_that_dont_fit_the_memory_are_not_made() {
    let sampling = irregular(6000, 14);
    let targets = Random(15).normals(6000, 1);
    for (strategy, warnings) in [(Strategy::Cg, 0), (Strategy::DensityCg, 1)] {
        let params = LsqParams { memory: 1 << 20, held: 1 << 19, moment_bytes: 1 << 20, ..params(strategy) };
        let ([fit, _], made) = fit_with_moments(&sampling, &targets, None, params);
        assert_eq!((made, fit.report.products, fit.report.preconditioner), (0, "samples", "none"));
        let said = fit.report.warnings.iter().filter(|warning| matches!(warning, LsqWarning::NoDensity { .. }));
        assert_eq!((said.count(), fit.report.warnings.len()), (warnings, warnings), "{:?}", fit.report);
    }
}

/// However many samples repeat them, few places don't determine a fit, and neither do many places on few circles.
#[test]
fn functions_that_are_zero_at_all_samples_are_noticed() {
    const DEGREE: usize = 8;
    let of = |places: &[[f64; 3]], repeats: usize| {
        let directions = Directions::from_vertices(&places.repeat(repeats)).unwrap();
        let targets = Array2::from_shape_fn((directions.len(), 1), |(i, _)| (i as f64).sin());
        let sums = SampleSums::new(&directions, None, targets.view(), DEGREE, FINEST).unwrap();
        let problem = MomentProblem::new(&sums, DEGREE).unwrap();
        determined(&problem, &LsqParams::default(), &Silent).unwrap()
    };
    let circles = |count: usize| -> Vec<[f64; 3]> {
        let place = |i: usize| {
            let (z, turn) = ((2 * (i / 40) + 1) as f64 / count as f64 - 1.0, (i % 40) as f64 * 0.157);
            let radius = (1.0 - z * z).sqrt();
            [radius * turn.cos(), radius * turn.sin(), z]
        };
        (0..40 * count).map(place).collect()
    };
    for (places, repeats, expected) in [(200, 1, true), (200, 5, true), (80, 20, false), (5, 100, false)] {
        assert_eq!(of(even(places).directions.as_slice(), repeats), expected, "{places} places");
    }
    assert!(of(&circles(12), 1) && !of(&circles(6), 1));
}
