//! Preconditioned iterations keep their preconditioner to the end.

use std::sync::Mutex;

use ndarray::{Array2, ArrayView2};
use spharm_monitor::Silent;
use spharm_solver::lsq::Stop;
use spharm_solver::{LsqParams, MatrixFreeOperator, Operator, SolverError, Strategy, lsq};

use crate::problems::{Random, clustered, params, transforms};

/// Products with the normal matrix that are off by a part in a thousand, so that an iteration believes too early that it
/// has converged; and a record of what it was asked for.
struct Inexact {
    exact: MatrixFreeOperator,
    asked: Mutex<Vec<Asked>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Asked {
    /// A residual.
    Samples,
    /// A product with the normal matrix.
    Normal,
    /// The density preconditioner: a product with weights.
    Weighted,
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
        let product = self.exact.normal(x, weights)?;
        match weights {
            Some(_) => {
                self.note(Asked::Weighted);
                Ok(product)
            }
            None => {
                self.note(Asked::Normal);
                Ok(1.001 * product)
            }
        }
    }
}

#[test]
fn an_iteration_that_goes_on_after_a_false_convergence_keeps_its_preconditioner() {
    let sampling = clustered(400);
    let operator = Inexact { exact: transforms(&sampling.directions, 6), asked: Mutex::default() };
    let targets = Random(3).normals(400, 2);
    let params = LsqParams { tolerance: 1e-8, ..params(&sampling, Strategy::DensityCg) };
    let fit = lsq::solve(&operator, &targets, &params, &Silent).unwrap();
    assert_eq!((fit.report.stop, fit.report.preconditioner), (Stop::Converged, "density"));
    let asked = operator.asked.into_inner().unwrap();
    let confirmed = asked.iter().position(|asked| *asked == Asked::Samples).unwrap();
    let after = |what: Asked| asked[confirmed..].iter().filter(|asked| **asked == what).count();
    assert!(after(Asked::Normal) > 0, "the first convergence was a false one");
    assert!(after(Asked::Weighted) >= after(Asked::Normal), "{asked:?}");
}
