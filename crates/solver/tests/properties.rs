//! Tests properties of operators and fits that hold for any sampling.

use ndarray::{Array2, ArrayView2, s};
use proptest::prelude::*;
use spharm_harmonics::{Directions, basis_size, synthesis};
use spharm_monitor::Silent;
use spharm_solver::{IrfFit, IrfParams, MatrixFreeOperator, MemoryOperator, Method, Operator, irf};
use spharm_transform::TransformParams;

/// Returns n random directions from a seed, by splitmix64 (Steele, Lea, Flood 2014). A plain multiple of the counter
/// would be a Weyl sequence, which for some seeds lies on so few curves that the samples don't determine the fit.
fn scattered(n: usize, seed: u64) -> Directions {
    let mut state = seed;
    let mut unit = || {
        state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((mixed ^ (mixed >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    };
    let angles: Vec<[f64; 2]> = (0..n).map(|_| [(1.0 - 2.0 * unit()).acos(), std::f64::consts::TAU * unit()]).collect();
    Directions::from_angles(&angles).unwrap()
}

fn filled(rows: usize, columns: usize, seed: u64) -> Array2<f64> {
    Array2::from_shape_fn((rows, columns), |(i, j)| ((i * 7 + j * 13) as f64 * 0.37 + seed as f64).sin())
}

fn inner(a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Checks that `<A x, r> = <x, A^T r>`, and that `A x` equals the direct sum.
    #[test]
    fn synthesis_and_adjoint_are_transposes(
        n in 1usize..300, max_degree in 0usize..12, channels in 1usize..12, chunk in 1usize..9, seed in 0u64..1000
    ) {
        let directions = scattered(n, seed);
        let operator = MemoryOperator::new(&directions, max_degree, 8 * chunk).unwrap();
        let x = filled(basis_size(max_degree), channels, seed);
        let r = filled(n, channels, seed + 1);
        let (forward, back) = (operator.apply(x.view()).unwrap(), operator.apply_adjoint(r.view()).unwrap());
        let scale = (inner(forward.view(), forward.view()) * inner(r.view(), r.view())).sqrt();
        let difference = inner(forward.view(), r.view()) - inner(x.view(), back.view());
        prop_assert!(difference.abs() <= 1e-13 * (1.0 + scale), "{}", difference);
        let sums = synthesis(&directions, x.view()).unwrap();
        prop_assert!((&sums - &forward).iter().all(|d| d.abs() < 1e-12));
    }

    /// At the full least squares the residual is orthogonal to every basis function, weighted or not; functions in the
    /// span of the basis are recovered.
    #[test]
    fn least_squares_leaves_nothing_that_the_basis_could_explain(
        max_degree in 0usize..8, channels in 1usize..10, weighted: bool, seed in 0u64..1000
    ) {
        let n = 3 * basis_size(max_degree) + 40;
        let directions = scattered(n, seed);
        let operator = MemoryOperator::new(&directions, max_degree, 64).unwrap();
        let weights = weighted.then(|| (0..n).map(|i| 0.5 + ((i * 31) % 7) as f64).collect::<Vec<_>>());
        let params = IrfParams {
            max_degree, method: Method::Nlsf, refinements: 3, weights: weights.clone(), ..IrfParams::default()
        };
        let noise = filled(n, channels, seed);
        let groups: Vec<_> = (0..channels).map(|c| c..c + 1).collect();
        let found = irf::solve(&operator, noise.view(), &groups, &params, &Silent).unwrap();
        let mut residual = &noise - &operator.apply(found.coefficients.values().view()).unwrap();
        // The reported residual equals the recomputed one.
        let mean = residual.column(0).iter().map(|r| r * r).sum::<f64>() / n as f64;
        let reported = found.report.history.last().unwrap().residuals[0].mean_square;
        prop_assert!((mean - reported).abs() <= 1e-10 * (mean + 1e-20), "{} {}", mean, reported);
        if let Some(weights) = &weights {
            residual.rows_mut().into_iter().zip(weights).for_each(|(mut row, &w)| row *= w);
        }
        let gradient = operator.apply_adjoint(residual.view()).unwrap();
        prop_assert!(gradient.iter().all(|g| g.abs() < 1e-10 * n as f64), "{:?}", gradient);

        let known = filled(basis_size(max_degree), channels, seed);
        let samples = operator.apply(known.view()).unwrap();
        let found = irf::solve(&operator, samples.view(), &groups, &params, &Silent).unwrap();
        prop_assert!((found.coefficients.values() - &known).iter().all(|d| d.abs() < 1e-9));
    }
}

/// The fast operator equals the direct operator, for coefficients of any degree up to its own, with and without
/// weights.
#[test]
fn the_fast_operator_is_the_direct_one() {
    let directions = scattered(200, 4);
    let params = TransformParams { max_degree: 6, accuracy: 1e-12, channels: 2 };
    let fast = MatrixFreeOperator::new(&directions, &params).unwrap();
    let direct = MemoryOperator::new(&directions, 6, 64).unwrap();
    assert_eq!((fast.rows(), fast.max_degree()), (200, 6));
    let near = |a: &Array2<f64>, b: &Array2<f64>| {
        assert_eq!(a.dim(), b.dim());
        assert!((a - b).iter().all(|d| d.abs() < 1e-9), "{a} {b}");
    };
    for degree in [0, 3, 6] {
        let x = filled(basis_size(degree), 2, 1);
        near(&fast.apply(x.view()).unwrap(), &direct.apply(x.view()).unwrap());
    }
    let (x, r) = (filled(basis_size(6), 2, 1), filled(200, 2, 2));
    near(&fast.apply_adjoint(r.view()).unwrap(), &direct.apply_adjoint(r.view()).unwrap());
    let weights: Vec<f64> = (0..200).map(|i| 0.5 + f64::from(i % 3)).collect();
    for weights in [None, Some(&weights[..])] {
        near(&fast.normal(x.view(), weights).unwrap(), &direct.normal(x.view(), weights).unwrap());
    }
}

/// If 900 of 1,200 vertices are on the northern part of the sphere, blocks are far from orthogonal, but IRF still
/// converges to the least squares.
#[test]
fn passes_converge_to_the_full_least_squares_on_uneven_samplings() {
    let north: Vec<[f64; 2]> = (0..900).map(|i| [1.4 * ((i as f64 + 0.5) / 900.0).sqrt(), 2.4 * i as f64]).collect();
    let south: Vec<[f64; 2]> = (0..300).map(|i| [1.4 + 1.7 * (i as f64 + 0.5) / 300.0, 2.4 * i as f64]).collect();
    let directions = Directions::from_angles(&[north, south].concat()).unwrap();
    let operator = MemoryOperator::new(&directions, 6, 104).unwrap();
    let targets = filled(1200, 3, 5);
    let run = |method| {
        let params = IrfParams { max_degree: 6, method, ..IrfParams::default() };
        irf::solve(&operator, targets.view(), std::slice::from_ref(&(0..3)), &params, &Silent).unwrap()
    };
    let best = run(Method::Nlsf);
    for granularity in [1, 10, 30] {
        let found = run(Method::Irf { passes: 200, granularity });
        let squares: Vec<f64> = found.report.history.iter().map(|s| s.residuals[0].mean_square).collect();
        assert!(squares.windows(2).all(|pair| pair[1] <= pair[0] * (1.0 + 1e-12)), "each pass lowers the residual");
        let off =
            (found.coefficients.values() - best.coefficients.values()).iter().map(|d| d.abs()).fold(0.0, f64::max);
        assert!(off < 1e-9, "g = {granularity}: {off}");
    }
}

/// For linearly dependent columns the fit finds the minimum-norm solution and reports the rank.
#[test]
fn repeated_directions_leave_a_rank_that_is_told() {
    // Nine different directions, four times each, give 16 columns the rank 9.
    let few = scattered(9, 3).as_slice().to_vec();
    let directions = Directions::from_vertices(&few.repeat(4)).unwrap();
    let operator = MemoryOperator::new(&directions, 3, 16).unwrap();
    let targets = filled(9, 2, 1);
    let targets = ndarray::concatenate(ndarray::Axis(0), &[targets.view(); 4]).unwrap();
    let params = IrfParams { max_degree: 3, method: Method::Nlsf, refinements: 2, ..IrfParams::default() };
    let found = irf::solve(&operator, targets.view(), std::slice::from_ref(&(0..2)), &params, &Silent).unwrap();
    let block = &found.report.blocks[0];
    assert_eq!((block.rank, block.columns, block.solver), (9, 16, "rank-revealing"));
    let residual = &targets - &operator.apply(found.coefficients.values().view()).unwrap();
    assert!(residual.iter().all(|r| r.abs() < 1e-11), "nine directions can be met exactly");
    // Nine functions alone also fit the targets; of all solutions, the one found has the smallest norm.
    let alone = IrfParams { max_degree: 2, ..params };
    let other = irf::solve(&operator, targets.view(), std::slice::from_ref(&(0..2)), &alone, &Silent).unwrap();
    let norm = |x: &Array2<f64>| inner(x.view(), x.view());
    assert!(norm(found.coefficients.values()) <= norm(other.coefficients.values()));
}

/// Each direction five times in succession, more rows than columns: the coefficients are those of one time each.
#[test]
fn many_repeated_directions_leave_the_rank_of_their_number() {
    let few = scattered(150, 3);
    let five = Directions::from_vertices(&few.as_slice().iter().flat_map(|u| [*u; 5]).collect::<Vec<_>>()).unwrap();
    let targets = filled(150, 2, 1);
    let targets_of_five = Array2::from_shape_fn((750, 2), |(i, j)| targets[[i / 5, j]]);
    let run = |directions: &Directions, targets: ArrayView2<'_, f64>| {
        let operator = MemoryOperator::new(directions, 20, 256).unwrap();
        let params = IrfParams { max_degree: 20, method: Method::Nlsf, threads: 2, ..IrfParams::default() };
        irf::solve(&operator, targets, std::slice::from_ref(&(0..2)), &params, &Silent).unwrap()
    };
    let (found, expected) = (run(&five, targets_of_five.view()), run(&few, targets.view()));
    assert_eq!((found.report.blocks[0].rank, expected.report.blocks[0].rank), (150, 150));
    let off = found.coefficients.values() - expected.coefficients.values();
    assert!(off.iter().all(|off| off.abs() < 1e-9));
}

/// A fit in which most rows have weight 0 finds the rank and the minimum-norm solution of the other rows alone.
#[test]
fn rows_of_weight_0_count_for_nothing_in_the_rank() {
    let all = scattered(1500, 3);
    let kept: Vec<[f64; 3]> = all.as_slice().iter().copied().step_by(10).collect();
    let kept = Directions::from_vertices(&kept).unwrap();
    let targets = filled(1500, 2, 1);
    let targets_kept = targets.slice(s![..;10, ..]);
    let weights: Vec<f64> = (0..1500).map(|i| if i % 10 == 0 { 1.0 } else { 0.0 }).collect();
    for method in [Method::Nlsf, Method::Irf { passes: 1, granularity: 200 }] {
        let run = |directions: &Directions, targets: ArrayView2<'_, f64>, weights: Option<Vec<f64>>| {
            let operator = MemoryOperator::new(directions, 20, 256).unwrap();
            let params = IrfParams { max_degree: 20, method, weights, threads: 2, ..IrfParams::default() };
            irf::solve(&operator, targets, std::slice::from_ref(&(0..2)), &params, &Silent).unwrap()
        };
        let (found, expected) = (run(&all, targets.view(), Some(weights.clone())), run(&kept, targets_kept, None));
        let ranks = |fit: &IrfFit| fit.report.blocks.iter().map(|block| block.rank).collect::<Vec<_>>();
        assert_eq!((ranks(&found), ranks(&found)[0]), (ranks(&expected), 150), "{method:?}");
        let off = found.coefficients.values() - expected.coefficients.values();
        assert!(off.iter().all(|off| off.abs() < 1e-9), "{method:?}");
    }
}

/// For blocks of 1,024 functions and more, the threads share one Gram matrix. The fit still recovers the coefficients
/// by Cholesky, with and without weights, for chunk sizes that do and don't divide the number of rows.
#[test]
fn a_block_of_more_than_a_thousand_functions_finds_what_the_samples_hold() {
    let max_degree = 31;
    let directions = Directions::fibonacci(2500).unwrap();
    let known = filled(basis_size(max_degree), 2, 5);
    let samples = synthesis(&directions, known.view()).unwrap();
    let weights: Vec<f64> = (0..2500).map(|i| 0.5 + ((i * 31) % 7) as f64).collect();
    for (chunk, weights) in [(120, None), (2500, Some(weights))] {
        let operator = MemoryOperator::new(&directions, max_degree, chunk).unwrap();
        let params =
            IrfParams { max_degree, method: Method::Nlsf, refinements: 0, weights, threads: 2, ..IrfParams::default() };
        let found = irf::solve(&operator, samples.view(), &[0..1, 1..2], &params, &Silent).unwrap();
        let block = &found.report.blocks[0];
        assert_eq!((block.columns, block.solver, block.rank), (1024, "cholesky", 1024));
        let off = found.coefficients.values() - &known;
        assert!(
            off.iter().all(|off| off.abs() < 1e-11),
            "{chunk}: {:e}",
            off.iter().fold(0.0f64, |a, b| a.max(b.abs()))
        );
    }
}
