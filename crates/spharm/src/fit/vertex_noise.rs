//! Computes the results that depend on the noise of a surface's vertices: the smoothness by cross-validation, and
//! standard errors.
//!
//! The data of a surface are its n fitted vertices; samples between the vertices are interpolated and contain no
//! further information. Therefore noise is modelled as independent noise of equal variance sigma^2 at the vertices. S
//! is the interpolation from the vertices to the samples, A the basis at the samples, W the weights of the samples, N
//! the normal matrix, and A_v the basis at the vertices. The fit of values y is `x = N^-1 A^T W S y`, and its model at
//! the vertices is `H y = A_v x`. The score of generalised cross-validation (GCV) for the smoothness lambda, and the
//! standard error sd(x_k) of coefficient k, are
//!
//! ```text
//! GCV(lambda) = n |y - H y|^2 / (n - tr H)^2,   sd(x_k)^2 = sigma^2 (N^-1 A^T W S S^T W A N^-1)_kk
//! sigma^2 = |y - H y|^2 / (n - tr H)
//! ```
//!
//! `tr H` and the diagonal entries (kk) are estimated by fits of independent random signs z at the vertices. The
//! expectation of `z^T H z` is `tr H`, and the expectation of `x_k^2` is the k-th diagonal entry (M. F. Hutchinson,
//! Commun. Stat. Simul. 19, 1990). With 256 fits, the estimated standard errors have a relative standard deviation of
//! 4.4 %.
//!
//! A standard error is the standard deviation over repeated measurements. Standard errors don't include the bias of a
//! smoothness penalty. The penalties of a denoised fit, one per degree, form the diagonal matrix P. They are sigma^2
//! divided by the variances of a prior. The bias that they cause has the covariance `sigma^2 N^-1 P N^-1`. The standard
//! errors of a denoised fit include this bias: independent random signs times `P^(1/2)` are added to the right-hand
//! sides.

use ndarray::{Array1, Array2, ArrayView2, Axis, Zip, s};
use spharm_harmonics::basis_size;
use spharm_monitor::{Monitor, OnlyCancel, Stage};
use spharm_solver::gram::degree_penalty;
use spharm_solver::lsq::{Gcv, GcvTerms, choose_smoothness_by, solve_moments};
use spharm_solver::{LsqParams, SolverError};
use spharm_surface::generate::SplitMix64;

use super::shared::check_auto;
use super::surface::Fitter;
use crate::Error;

/// Number of fits of noise from which tr H is estimated for one smoothness. The noise is the same for each smoothness,
/// so that GCV is a smooth function of the smoothness.
const PROBES_FOR_GCV: usize = 3;
/// Number of fits of noise from which standard errors are estimated.
const PROBES_FOR_ERRORS: usize = 256;
/// Largest number of columns of noise that are fitted at a time.
const PROBES_AT_A_TIME: usize = 16;
/// Optimality of the fits that GCV compares.
const TOLERANCE_OF_GCV: f64 = 1e-7;

impl Fitter<'_> {
    /// Chooses the smoothness of `target` (vertices x channels) by generalised cross-validation at the vertices.
    pub(super) fn choose_smoothness(&self, target: ArrayView2<'_, f64>, monitor: &dyn Monitor) -> Result<Gcv, Error> {
        let (vertices, columns) = (self.vertices_with_weight, target.ncols());
        check_auto(vertices, self.params.max_degree)?;
        // Centre the target: GCV doesn't depend on the target's position, but a solution's errors grow with the
        // target's values.
        let target = self.centred(target);
        let target = target.view();
        let probes = self.signs(PROBES_FOR_GCV, &mut SplitMix64::new(0));
        let all = columns + PROBES_FOR_GCV;
        let problem = self.problem(&[(0..columns, target), (columns..all, probes.view())], monitor)?;
        let terms = |smoothness: f64| -> Result<GcvTerms, Error> {
            let params = LsqParams { smoothness, tolerance: TOLERANCE_OF_GCV, ..self.solver.clone() };
            let fit = solve_moments(&problem, &params, false, &OnlyCancel(monitor))?;
            let model = self.at_vertices(fit.coefficients.values().view(), target.nrows())?;
            let residual = &target - &model.slice(s![.., ..columns]);
            Ok(GcvTerms {
                square: self.squares(&residual).sum(),
                trace: (&probes * &model.slice(s![.., columns..])).sum() / PROBES_FOR_GCV as f64,
                rows: vertices as f64,
            })
        };
        choose_smoothness_by(self.params.max_degree, problem.weight(), terms, monitor)
    }

    /// Returns the standard errors of the coefficients (basis functions x channels) of a fit with the settings
    /// `solver`. `residual` (vertices x channels) is the fit's residual at the vertices.
    pub(super) fn standard_errors(
        &self,
        solver: &LsqParams,
        residual: &Array2<f64>,
        monitor: &dyn Monitor,
    ) -> Result<Array2<f64>, Error> {
        let (vertices, functions) = (self.vertices_with_weight, basis_size(self.params.max_degree));
        let (mut variances, mut trace, mut random) = (Array1::zeros(functions), 0.0, SplitMix64::new(1));
        monitor.begin(Stage::counted("standard errors", "fits"), PROBES_FOR_ERRORS as u64);
        for _ in 0..PROBES_FOR_ERRORS / PROBES_AT_A_TIME {
            let signs = self.signs(PROBES_AT_A_TIME, &mut random);
            let targets = [(0..PROBES_AT_A_TIME, signs.view())];
            let problem = match &solver.penalty {
                None => self.problem(&targets, &OnlyCancel(monitor))?,
                Some(by_degree) => {
                    let mut bias = random_signs((functions, PROBES_AT_A_TIME), &mut random);
                    Zip::from(bias.rows_mut()).and(&Array1::from(degree_penalty(by_degree))).for_each(|mut row, p| {
                        row *= p.sqrt();
                    });
                    self.problem_plus(&targets, &bias, &OnlyCancel(monitor))?
                }
            };
            let fit = solve_moments(&problem, solver, false, &OnlyCancel(monitor))?;
            let coefficients = fit.coefficients.values();
            let model = self.at_vertices(coefficients.view(), signs.nrows())?;
            trace += (&signs * &model).sum() / PROBES_FOR_ERRORS as f64;
            variances += &(coefficients.map(|x| x * x).sum_axis(Axis(1)) / PROBES_FOR_ERRORS as f64);
            monitor.step(PROBES_AT_A_TIME as u64);
        }
        monitor.end();
        let freedom = vertices as f64 - trace;
        // The estimated trace has an uncertainty of a few tenths of a percent.
        let (rows, columns, penalised) = (vertices, functions, solver.smoothness > 0.0 || solver.penalty.is_some());
        if freedom < 1.0 && penalised {
            return Err(SolverError::UnderdeterminedWithPenalty { rows, columns, needed: "larger" }.into());
        }
        if (vertices <= functions && !penalised) || freedom < 1.0 {
            return Err(SolverError::Underdetermined { rows, columns }.into());
        }
        let sigma = self.squares(residual).map(|square| (square / freedom).sqrt());
        Ok(Array2::from_shape_fn((functions, sigma.len()), |(k, c)| sigma[c] * variances[k].sqrt()))
    }

    /// Returns columns of independent random signs at the vertices, with 0 at vertices that aren't fitted.
    fn signs(&self, columns: usize, random: &mut SplitMix64) -> Array2<f64> {
        let mut signs = random_signs((self.vertices(), columns), random);
        if let Some(weights) = self.weights() {
            Zip::from(signs.rows_mut()).and(weights).for_each(|mut row, weight| {
                if *weight == 0.0 {
                    row.fill(0.0);
                }
            });
        }
        signs
    }

    /// Returns `target` (vertices x channels) minus the mean of each column over the fitted vertices.
    fn centred(&self, target: ArrayView2<'_, f64>) -> Array2<f64> {
        let weights = self.weights();
        let is_fitted = |vertex: usize| weights.is_none_or(|weights| weights[vertex] > 0.0);
        let mut centred = target.to_owned();
        for mut column in centred.columns_mut() {
            let values = column.iter().enumerate().filter(|(vertex, _)| is_fitted(*vertex));
            let mean = values.map(|(_, value)| value).sum::<f64>() / self.vertices_with_weight as f64;
            column -= mean;
        }
        centred
    }

    /// Returns the sum of squares of each column of `residual` (vertices x channels) over the fitted vertices.
    fn squares(&self, residual: &Array2<f64>) -> Array1<f64> {
        let mut squares = Array1::zeros(residual.ncols());
        for (vertex, row) in residual.rows().into_iter().enumerate() {
            if self.weights().is_none_or(|weights| weights[vertex] > 0.0) {
                squares += &row.map(|r| r * r);
            }
        }
        squares
    }

    /// Evaluates models at the vertices, which are the first `rows` evaluation points, with as many columns at a time
    /// as planned.
    fn at_vertices(&self, coefficients: ArrayView2<'_, f64>, rows: usize) -> Result<Array2<f64>, Error> {
        let mut all = Array2::zeros((rows, coefficients.ncols()));
        for (mut values, columns) in all
            .axis_chunks_iter_mut(Axis(1), self.evaluated())
            .zip(coefficients.axis_chunks_iter(Axis(1), self.evaluated()))
        {
            values.assign(&self.evaluate(columns)?.slice(s![..rows, ..]));
        }
        Ok(all)
    }
}

/// Returns an array of independent random signs.
fn random_signs(shape: (usize, usize), random: &mut SplitMix64) -> Array2<f64> {
    Array2::from_shape_simple_fn(shape, || random.between(-1.0, 1.0).signum())
}
