//! A factor in single precision to precondition with: from degree 63 on.

use std::sync::atomic::{AtomicUsize, Ordering};

use ndarray::Array2;
use spharm_harmonics::basis_size;
use spharm_monitor::Silent;
use spharm_solver::cholesky::plan_factor;
use spharm_solver::lsq::Stop;
use spharm_solver::{
    FactorParams, GramMatrix, LsqParams, LsqSolver, MatrixFreeOperator, SolverError, Strategy, moment_gram,
};

use crate::problems::{Random, Sampling, cap, irregular, largest, norms, params, transforms};

const MAX_DEGREE: usize = 63;

struct Problem {
    sampling: Sampling,
    operator: MatrixFreeOperator,
    targets: Array2<f64>,
    factors: AtomicUsize,
}

impl Problem {
    fn new(sampling: Sampling) -> Self {
        let operator = transforms(&sampling.directions, MAX_DEGREE);
        let targets = Random(3).normals(sampling.directions.len(), 2);
        Self { sampling, operator, targets, factors: AtomicUsize::new(0) }
    }

    /// Calls `work` with a solver.
    fn solver<T>(&self, params: LsqParams, work: impl FnOnce(&mut LsqSolver<'_>) -> T) -> T {
        let gram = || {
            self.factors.fetch_add(1, Ordering::Relaxed);
            Ok(Box::new(moment_gram(&self.sampling.directions, None, MAX_DEGREE)?) as Box<dyn GramMatrix>)
        };
        work(&mut LsqSolver::new(&self.operator, Some(&gram), params).unwrap())
    }

    fn params(&self, strategy: Strategy, smoothness: f64) -> LsqParams {
        LsqParams { smoothness, ..params(&self.sampling, strategy) }
    }
}

#[test]
fn it_gives_what_a_factor_in_double_precision_gives() {
    let problem = Problem::new(irregular(5500, 8));
    let group = 0..2;
    let groups = std::slice::from_ref(&group);
    for smoothness in [0.0, 1e-9] {
        let (expected, errors) = problem.solver(problem.params(Strategy::Cholesky, smoothness), |solver| {
            let fit = solver.fit(&problem.targets, groups, &Silent).unwrap();
            let errors = solver.standard_errors(&fit.residual, &Silent).unwrap();
            (fit, errors)
        });
        problem.factors.store(0, Ordering::Relaxed);
        problem.solver(problem.params(Strategy::Auto, smoothness), |solver| {
            for batch in 0..2 {
                let fit = solver.fit(&problem.targets, groups, &Silent).unwrap();
                let report = &fit.report;
                assert_eq!((report.preconditioner, report.stop), ("factor-f32", Stop::Converged), "{report:?}");
                assert!(report.optimality <= 2e-10, "{report:?}");
                // The first batch tries without; the second has it from the start.
                assert_eq!(report.iterations > 30, batch == 0, "{report:?}");
                assert_eq!((report.shift, report.breaks_at), (0.0, None));
                let ratio = report.condition / expected.report.condition;
                assert!(ratio > 0.5 && ratio < 2.0, "{} {}", report.condition, expected.report.condition);
                let off = norms(&(fit.coefficients.values() - expected.coefficients.values()));
                let size = norms(expected.coefficients.values());
                let off = largest(off.iter().zip(&size).map(|(off, size)| off / size));
                let allowed = 1e-8;
                assert!(off <= allowed, "{off:e}");
            }
            assert_eq!(problem.factors.load(Ordering::Relaxed), 1, "one factor for both batches");
            // Standard errors come from one in double precision.
            let residual = solver.fit(&problem.targets, groups, &Silent).unwrap().residual;
            let found = solver.standard_errors(&residual, &Silent).unwrap();
            let off = largest(found.iter().zip(&errors).map(|(found, error)| (found / error - 1.0).abs()));
            assert!(off < 1e-6, "{off:e}");
        });
    }
}

/// Half of the memory is enough, and none of it where even that isn't there.
#[test]
fn it_fits_where_one_in_double_precision_does_not() {
    let problem = Problem::new(irregular(5500, 9));
    let fit = |memory: usize| {
        let params = LsqParams { memory, max_iterations: 400, ..problem.params(Strategy::Auto, 0.0) };
        problem.solver(params, |solver| solver.fit(&problem.targets, std::slice::from_ref(&(0..2)), &Silent)).unwrap()
    };
    let size = basis_size(MAX_DEGREE);
    // With the narrowest panel.
    let least = match plan_factor(size, &FactorParams { memory: 0, threads: 2, ..FactorParams::default() }, false) {
        Err(SolverError::Store(spharm_store::StoreError::Budget { needed, .. })) => needed,
        found => panic!("{found:?}"),
    };
    assert_eq!(fit(least - 1).report.preconditioner, "factor-f32");
    let none = fit(least / 4).report;
    assert_eq!((none.preconditioner, none.warnings.len()), ("none", 1), "{none:?}");
}

/// What a sampling doesn't determine is for the factor in double precision, which is shifted.
#[test]
fn a_singular_matrix_is_left_to_double_precision() {
    let problem = Problem::new(cap(5000, 1.5));
    let params = problem.params(Strategy::Auto, 0.0);
    let fit = problem.solver(params, |solver| solver.fit(&problem.targets, std::slice::from_ref(&(0..2)), &Silent));
    let report = fit.unwrap().report;
    assert_eq!(report.preconditioner, "factor");
    assert!(report.shift > 0.0 && report.condition.is_infinite(), "{report:?}");
}
