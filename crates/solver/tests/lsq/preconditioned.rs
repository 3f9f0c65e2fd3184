//! Tests that preconditioning reduces the number of iterations by moments, and that iterations keep their
//! preconditioner to the end.

use std::sync::Mutex;

use ndarray::{Array2, ArrayView2, s};
use spharm_monitor::Silent;
use spharm_solver::lsq::cg::{self, CgParams};
use spharm_solver::lsq::preconditioner::{Diagonal, Preconditioner};
use spharm_solver::lsq::{MomentFit, MomentProblem, NormalEquations, Stop, solve_moments, solve_moments_of_groups};
use spharm_solver::{LsqParams, MatrixFreeOperator, Operator, SolverError, Strategy};
use spharm_transform::{FINEST, SampleSums};

use crate::problems::{Random, Sampling, clustered, dense, even, irregular, matrix, norms, transforms};

/// An operator whose products with the normal matrix have a relative error of 1e-3, so that an iteration seems to
/// converge too early. It records its calls.
struct Inexact {
    exact: MatrixFreeOperator,
    asked: Mutex<Vec<Asked>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// A residual was computed.
    Samples,
    /// A product with the normal matrix was computed.
    Normal,
    /// The preconditioner was applied.
    Preconditioned,
}

impl Inexact {
    fn note(&self, asked: Asked) {
        self.asked.lock().unwrap().push(asked);
    }
}

impl Operator for Inexact {
    fn rows(&self) -> usize {
        self.exact.rows()
    }

    fn max_degree(&self) -> usize {
        self.exact.max_degree()
    }

    fn apply(&self, x: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        self.note(Asked::Samples);
        self.exact.apply(x)
    }

    fn apply_adjoint(&self, r: ArrayView2<'_, f64>) -> Result<Array2<f64>, SolverError> {
        self.exact.apply_adjoint(r)
    }

    fn normal(&self, x: ArrayView2<'_, f64>, weights: Option<&[f64]>) -> Result<Array2<f64>, SolverError> {
        self.note(Asked::Normal);
        Ok(1.001 * self.exact.normal(x, weights)?)
    }
}

/// A preconditioner that records its use.
struct Recorded<'a>(&'a Inexact, Diagonal);

impl Preconditioner for Recorded<'_> {
    fn name(&self) -> &'static str {
        "recorded"
    }

    fn apply(&self, r: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        self.0.note(Asked::Preconditioned);
        self.1.apply(r)
    }
}

#[test]
fn an_iteration_that_goes_on_after_a_false_convergence_keeps_its_preconditioner() {
    let sampling = clustered(400);
    let operator = Inexact { exact: transforms(&sampling.directions, 6), asked: Mutex::default() };
    let targets = Random(3).normals(400, 2);
    let equations = NormalEquations { operator: &operator, weights: None, penalty: None };
    let preconditioner = Recorded(&operator, equations.diagonal());
    let params = CgParams { tolerance: 1e-8, ..CgParams::default() };
    let fit = cg::solve(&equations, &targets, &preconditioner, &params, &Silent).unwrap();
    assert_eq!(fit.stop, Stop::Converged);
    let asked = operator.asked.into_inner().unwrap();
    let confirmed = asked.iter().position(|asked| *asked == Asked::Samples).unwrap();
    let after = |what: Asked| asked[confirmed..].iter().filter(|asked| **asked == what).count();
    assert!(after(Asked::Normal) > 0, "the first convergence was a false one");
    assert!(after(Asked::Preconditioned) >= after(Asked::Normal), "{asked:?}");
}

const DEGREE: usize = 12;

fn problem(sampling: &Sampling, targets: &Array2<f64>) -> MomentProblem {
    let sums = SampleSums::new(&sampling.directions, None, targets.view(), DEGREE, FINEST).unwrap();
    MomentProblem::new(&sums, DEGREE).unwrap()
}

fn by(problem: &MomentProblem, strategy: Strategy) -> MomentFit {
    solve_moments(problem, &LsqParams { strategy, ..LsqParams::default() }, false, &Silent).unwrap()
}

#[test]
fn uneven_samplings_take_fewer_iterations_by_moments() {
    // The first sampling has six random samples per coefficient. The second has six times as many samples, and is a
    // hundred times denser at one pole.
    for (sampling, gain) in [(irregular(1000, 4), 1.6), (clustered(6000), 2.0)] {
        let targets = Random(5).normals(sampling.directions.len(), 5);
        let problem = problem(&sampling, &targets);
        let expected = dense(&matrix(&sampling.directions, DEGREE), &targets, None, 0.0).x;
        let plain = by(&problem, Strategy::Cg);
        assert_eq!(plain.report.preconditioner, "none");
        for strategy in [Strategy::Auto, Strategy::DensityCg] {
            let fit = by(&problem, strategy);
            assert_eq!((fit.report.preconditioner, fit.report.products), ("density", "moments"));
            assert_eq!(fit.report.stop, Stop::Converged);
            let bound = fit.report.condition / plain.report.condition;
            assert!((1.0..4.0).contains(&bound), "{bound}");
            let iterations = [&plain, &fit].map(|fit| fit.report.iterations as f64);
            assert!(iterations[1] * gain < iterations[0], "{}: {iterations:?}", sampling.name);
            let off = norms(&(fit.coefficients.values() - &expected));
            assert!(off.iter().zip(norms(&expected)).all(|(off, norm)| *off < 1e-8 * norm), "{off:?}");
            // Three columns have the same bits as when they are solved alone.
            let alone = by(&problem.of_columns(0..3), strategy);
            assert_eq!(alone.coefficients.values(), fit.coefficients.values().slice(s![.., ..3]));
        }
    }
}

/// Groups share the inverse of the density; each group runs on a thread of its own.
#[test]
fn groups_of_an_uneven_sampling_are_each_as_if_alone() {
    let targets = Random(5).normals(1000, 12);
    let sampling = irregular(1000, 4);
    let alone = problem(&sampling, &targets);
    let groups: Vec<_> = (0..12).map(|c| c..c + 1).collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(6).build().unwrap();
    for _ in 0..20 {
        // The new problem starts without an inverse of the density.
        let all = problem(&sampling, &targets);
        let fits = pool.install(|| solve_moments_of_groups(&all, &groups, &LsqParams::default(), &Silent)).unwrap();
        for (group, fit) in groups.iter().zip(fits) {
            let alone = by(&alone.of_columns(group.clone()), Strategy::Auto);
            assert_eq!(
                (fit.report.preconditioner, fit.coefficients.values()),
                ("density", alone.coefficients.values())
            );
        }
    }
}

#[test]
fn the_density_is_left_alone_where_it_gains_nothing() {
    let preconditioner = |sampling: &Sampling, smoothness: f64| {
        let targets = Random(5).normals(sampling.directions.len(), 1);
        let params = LsqParams { smoothness, ..LsqParams::default() };
        solve_moments(&problem(sampling, &targets), &params, false, &Silent).unwrap().report.preconditioner
    };
    assert_eq!(preconditioner(&irregular(1000, 4), 0.0), "density");
    assert_eq!(preconditioner(&irregular(1000, 4), 1e-3), "none");
    assert_eq!(preconditioner(&even(1000), 0.0), "none");
    // With fewer than two samples per coefficient there may be many solutions.
    assert_ne!(preconditioner(&irregular(330, 4), 0.0), "density");
}
