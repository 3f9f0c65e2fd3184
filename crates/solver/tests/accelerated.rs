//! Tests accelerated residual fitting, and fits with Gram matrices from moments, against plain fitting and the full
//! least squares.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Directions;
use spharm_monitor::Silent;
use spharm_solver::{ChunkedRows, IrfFit, IrfParams, IrfSolver, MemoryOperator, Method, Operator, irf, moment_gram};

const L: usize = 8;

/// Returns 1,200 directions, most of them around the north pole, so that blocks are far from orthogonal.
fn uneven() -> Directions {
    let north = (0..900).map(|i| [1.2 * ((i as f64 + 0.5) / 900.0).sqrt(), 2.4 * i as f64]);
    let south = (0..300).map(|i| [1.2 + 1.9 * (i as f64 + 0.5) / 300.0, 2.4 * i as f64]);
    Directions::from_angles(&north.chain(south).collect::<Vec<_>>()).unwrap()
}

fn targets(columns: usize) -> Array2<f64> {
    Array2::from_shape_fn((1200, columns), |(i, j)| ((i * 7 + j * 13) as f64 * 0.37 + 5.0).sin() + j as f64)
}

fn weights() -> Vec<f64> {
    (0..1200).map(|i| ((i * 31) % 7) as f64 * 0.5).collect()
}

fn params(passes: usize, granularity: usize, accelerate: bool, weights: Option<Vec<f64>>) -> IrfParams {
    let method = Method::Irf { passes, granularity };
    IrfParams { max_degree: L, method, accelerate, weights, threads: 2, ..IrfParams::default() }
}

fn run(operator: &MemoryOperator, targets: ArrayView2<'_, f64>, params: &IrfParams) -> IrfFit {
    irf::solve(operator, targets, std::slice::from_ref(&(0..targets.ncols())), params, &Silent).unwrap()
}

/// Returns `|A^T W (f - A x)|` relative to `|A^T W f|`: the maximum over the columns.
fn optimality(operator: &MemoryOperator, targets: &Array2<f64>, x: &Array2<f64>, weights: Option<&[f64]>) -> f64 {
    let gradient = |mut r: Array2<f64>| {
        r.rows_mut().into_iter().enumerate().for_each(|(i, mut row)| row *= weights.map_or(1.0, |w| w[i]));
        operator.apply_adjoint(r.view()).unwrap()
    };
    let norms = |g: Array2<f64>| g.columns().into_iter().map(|c| c.dot(&c).sqrt()).collect::<Vec<_>>();
    let left = norms(gradient(targets - &operator.apply(x.view()).unwrap()));
    let whole = norms(gradient(targets.clone()));
    left.iter().zip(whole).map(|(left, whole)| left / whole).fold(0.0, f64::max)
}

/// Accelerated fits reach the least squares for different blocks, weights and numbers of columns. Without weights each
/// iteration also decreases the residual.
#[test]
fn accelerated_fits_reach_the_least_squares() {
    let operator = MemoryOperator::new(&uneven(), L, 104).unwrap();
    for (columns, granularity, weights) in [(1, 1, None), (3, 10, Some(weights())), (11, 30, None), (3, 1000, None)] {
        let targets = targets(columns);
        let found = run(&operator, targets.view(), &params(120, granularity, true, weights.clone()));
        let off = optimality(&operator, &targets, found.coefficients.values(), weights.as_deref());
        assert!(off < 1e-11, "g = {granularity}, {columns} columns: {off}");
        assert!(found.report.history.len() < 60, "it ends early: {}", found.report.history.len());
        let sweeps = &found.report.history;
        assert!(sweeps.iter().enumerate().all(|(i, sweep)| sweep.pass == 2 * (i + 1)));
        // The reported residual equals the recomputed one.
        let residual = &targets - &operator.apply(found.coefficients.values().view()).unwrap();
        let mean = residual.iter().map(|r| r * r).sum::<f64>() / 1200.0;
        let told = sweeps.last().unwrap().residuals[0].mean_square;
        assert!((mean - told).abs() < 1e-12 * mean, "{mean} {told}");
        if weights.is_none() {
            let squares: Vec<f64> = sweeps.iter().map(|sweep| sweep.residuals[0].mean_square).collect();
            assert!(squares.windows(2).all(|pair| pair[1] <= pair[0] * (1.0 + 1e-12)), "{squares:?}");
        }
    }
}

/// Acceleration at least halves the number of passes on a very irregular sampling: 1,050 directions are within 0.9 of
/// the pole, and only 150 elsewhere.
#[test]
fn acceleration_takes_fewer_passes_than_plain_fitting() {
    let crowd = (0..1050).map(|i| [0.9 * ((i as f64 + 0.5) / 1050.0).sqrt(), 2.4 * i as f64]);
    let rest = (0..150).map(|i| [0.9 + 2.2 * (i as f64 + 0.5) / 150.0, 2.4 * i as f64]);
    let directions = Directions::from_angles(&crowd.chain(rest).collect::<Vec<_>>()).unwrap();
    let operator = MemoryOperator::new(&directions, L, 104).unwrap();
    let targets = targets(3);
    let nlsf = IrfParams { max_degree: L, method: Method::Nlsf, refinements: 2, ..IrfParams::default() };
    let best = run(&operator, targets.view(), &nlsf).report.history.last().unwrap().residuals[0].mean_square;
    let passes_to = |accelerate| {
        let report = run(&operator, targets.view(), &params(400, 10, accelerate, None)).report;
        let there = report.history.iter().find(|sweep| sweep.residuals[0].mean_square <= best * (1.0 + 1e-9));
        there.expect("it converges").pass
    };
    let (plain, accelerated) = (passes_to(false), passes_to(true));
    assert!(2 * accelerated <= plain, "{accelerated} against {plain}");
}

/// With acceleration, one pass is a plain pass, and three passes are a plain pass and an iteration.
#[test]
fn an_odd_number_of_passes_begins_with_a_plain_one() {
    let operator = MemoryOperator::new(&uneven(), L, 104).unwrap();
    let targets = targets(3);
    let [plain, one, three] = [(1, false), (1, true), (3, true)]
        .map(|(p, accelerate)| run(&operator, targets.view(), &params(p, 10, accelerate, None)));
    assert_eq!(plain.coefficients.values(), one.coefficients.values());
    assert_eq!(three.report.history.iter().map(|sweep| sweep.pass).collect::<Vec<_>>(), [1, 3]);
    let square = |fit: &IrfFit, at: usize| fit.report.history[at].residuals[0].mean_square;
    assert!(square(&three, 0) == square(&plain, 0) && square(&three, 1) < square(&plain, 0));
}

#[test]
fn the_same_fit_gives_the_same_bits_and_a_zero_column_stays_zero() {
    let operator = MemoryOperator::new(&uneven(), L, 104).unwrap();
    let mut targets = targets(4);
    targets.column_mut(2).fill(0.0);
    let [first, second] = [0, 1].map(|_| run(&operator, targets.view(), &params(20, 10, true, Some(weights()))));
    assert_eq!(first.coefficients.values(), second.coefficients.values());
    assert!(first.coefficients.values().column(2).iter().all(|&x| x == 0.0));
}

/// Acceleration handles singular blocks: with nine directions that occur four times each, blocks have more functions
/// than the directions determine.
#[test]
fn singular_blocks_are_accelerated_too() {
    let angles: Vec<[f64; 2]> = (0..36).map(|i| i % 9).map(|i| [0.3 * i as f64 + 0.2, 2.4 * i as f64]).collect();
    let operator = MemoryOperator::new(&Directions::from_angles(&angles).unwrap(), 3, 16).unwrap();
    let targets = Array2::from_shape_fn((36, 2), |(i, j)| ((i % 9) as f64 + j as f64).sin());
    let params = IrfParams { max_degree: 3, ..params(60, 12, true, None) };
    let found = run(&operator, targets.view(), &params);
    let residual = &targets - &operator.apply(found.coefficients.values().view()).unwrap();
    assert!(residual.iter().all(|r| r.abs() < 1e-10), "nine directions can be met exactly: {residual:?}");
}

#[test]
fn gram_matrices_from_moments_give_the_same_fit() {
    let directions = uneven();
    let operator = MemoryOperator::new(&directions, L, 104).unwrap();
    let targets = targets(3);
    for weights in [None, Some(weights())] {
        let grams = moment_gram(&directions, weights.as_deref(), L).unwrap();
        for (granularity, accelerate) in [(1, false), (30, false), (1000, false), (10, true)] {
            let params = params(4, granularity, accelerate, weights.clone());
            let old = run(&operator, targets.view(), &params);
            let mut fitter = IrfSolver::with_gram(&operator, 3, params, &grams).unwrap();
            let rows = ChunkedRows::from_array(targets.view(), 104);
            let new = fitter.fit(rows, std::slice::from_ref(&(0..3)), &Silent).unwrap();
            let scale = old.coefficients.values().iter().fold(0.0f64, |m, x| m.max(x.abs()));
            let difference = old.coefficients.values() - new.coefficients.values();
            let off = difference.iter().fold(0.0f64, |m, d| m.max(d.abs())) / scale;
            assert!(off < 1e-12, "g = {granularity}: {off}");
            assert!(new.report.blocks.iter().all(|block| block.solver == "cholesky"));
        }
    }
}

/// The plan includes the memory of a source of Gram matrices, and a fit above the source's degree is refused.
#[test]
fn the_plan_counts_the_source_and_the_iteration() {
    let directions = uneven();
    let operator = MemoryOperator::new(&directions, L, 104).unwrap();
    let plan = |params: &IrfParams| spharm_solver::irf::plan(&operator, 3, params).unwrap();
    let base = params(4, 30, false, None);
    let held = 50 << 20;
    let with = plan(&IrfParams { gram_bytes: Some(held), ..base.clone() });
    assert!(with.total > held && with.grams > held && with.work < plan(&base).work);
    let accelerated = plan(&IrfParams { accelerate: true, ..base.clone() });
    assert_eq!(accelerated.arrays - plan(&base).arrays, 8 * 2 * (1200 + 81) * 3);
    let low = moment_gram(&directions, None, L - 1).unwrap();
    assert!(IrfSolver::with_gram(&operator, 3, base, &low).is_err());
}
