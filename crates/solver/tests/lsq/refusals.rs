//! Tests that invalid input is refused, and that interruptions end a fit.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use ndarray::Array2;
use spharm_monitor::{Monitor, Silent};
use spharm_solver::{LsqParams, LsqSolver, SolverError, Strategy};

use crate::problems::{Random, STRATEGIES, even, irregular, params, transforms, try_solve};

#[test]
fn bad_input_gets_typed_errors() {
    let sampling = even(100);
    let good = Random(1).normals(100, 2);
    let error = |targets: &Array2<f64>, change: &dyn Fn(&mut LsqParams)| {
        let mut params = params(Strategy::Auto);
        change(&mut params);
        try_solve(&sampling, 4, targets, params, &Silent).unwrap_err()
    };
    let mut bad = good.clone();
    bad[[17, 1]] = f64::NAN;
    assert!(matches!(error(&bad, &|_| {}), SolverError::NotFinite { row: 17, column: 1 }));
    bad[[17, 1]] = f64::NEG_INFINITY;
    assert!(matches!(error(&bad, &|_| {}), SolverError::NotFinite { row: 17, column: 1 }));
    let short = Random(1).normals(99, 2);
    assert!(matches!(error(&short, &|_| {}), SolverError::Rows { expected: 100, found: 99, .. }));
    for weight in [-1.0, f64::NAN, f64::INFINITY] {
        let mut weights = vec![1.0; 100];
        weights[42] = weight;
        let found = error(&good, &|params| params.weights = Some(weights.clone()));
        assert!(matches!(found, SolverError::Weight { row: 42, .. }), "{found}");
    }
    let found = error(&good, &|params| params.weights = Some(vec![0.0; 100]));
    assert!(matches!(found, SolverError::Weight { .. }), "{found}");
    let found = error(&good, &|params| params.weights = Some(vec![1.0; 7]));
    assert!(matches!(found, SolverError::Rows { expected: 100, found: 7, .. }), "{found}");
    for smoothness in [-1e-9, f64::NAN, f64::INFINITY] {
        let found = error(&good, &|params| params.smoothness = smoothness);
        assert!(matches!(found, SolverError::Smoothness { .. }), "{found}");
    }
    // This strategy needs a Gram matrix, but the solver has none.
    let operator = transforms(&sampling.directions, 4);
    let mut solver = LsqSolver::new(&operator, None, params(Strategy::Cholesky)).unwrap();
    let found = solver.fit(&good, std::slice::from_ref(&(0..2)), &Silent).unwrap_err();
    assert!(matches!(found, SolverError::NoGram), "{found}");
    let found = error(&good, &|params| (params.strategy, params.memory) = (Strategy::Cholesky, 1000));
    assert!(found.to_string().contains("is too small; at least"), "{found}");
}

#[test]
fn a_fit_that_is_told_to_stop_stops() {
    let sampling = irregular(400, 4);
    let targets = Random(5).normals(400, 3);
    for strategy in STRATEGIES {
        let found = try_solve(&sampling, 12, &targets, params(strategy), &AtomicBool::new(true)).unwrap_err();
        assert!(matches!(found, SolverError::Interrupted(_)), "{strategy:?}: {found}");
    }
    let operator = transforms(&sampling.directions, 12);
    let mut solver = LsqSolver::new(&operator, None, LsqParams::default()).unwrap();
    let found = solver.choose_smoothness(&targets, &AtomicBool::new(true));
    assert!(matches!(found, Err(SolverError::Interrupted(_))));
    // Interrupt a fit in the middle.
    let operator = transforms(&sampling.directions, 12);
    struct StopAtThird(AtomicU64);
    impl Monitor for StopAtThird {
        fn step(&self, steps: u64) {
            self.0.fetch_add(steps, Ordering::Relaxed);
        }
        fn cancelled(&self) -> bool {
            self.0.load(Ordering::Relaxed) >= 3
        }
    }
    let mut solver = LsqSolver::new(&operator, None, params(Strategy::Cg)).unwrap();
    let monitor = StopAtThird(AtomicU64::new(0));
    let found = solver.fit(&targets, std::slice::from_ref(&(0..3)), &monitor).unwrap_err();
    assert!(matches!(found, SolverError::Interrupted(_)), "{found}");
}
