//! Provides samplings, random numbers, and the dense solution with which every strategy is compared.

use std::f64::consts::{PI, TAU};

use faer::Mat;
use faer::linalg::solvers::DenseSolveCore;
use ndarray::{Array1, Array2, Axis, concatenate};
use spharm_harmonics::{Directions, basis_size};
use spharm_monitor::{Monitor, Silent};
use spharm_solver::gram::smoothness_penalty;
use spharm_solver::{
    GramMatrix, LsqFit, LsqParams, LsqSolver, MatrixFreeOperator, MemoryOperator, Operator, SolverError, Strategy,
    moment_gram,
};
use spharm_transform::TransformParams;

/// A named sampling of the sphere.
pub(crate) struct Sampling {
    pub(crate) name: &'static str,
    pub(crate) directions: Directions,
}

/// Returns n directions on a spiral. `depth` maps their index, scaled to 0 to 1, to the depth below the pole, from 0 to
/// 1.
pub(crate) fn spiral(name: &'static str, n: usize, depth: impl Fn(f64) -> f64) -> Sampling {
    let golden = PI * (3.0 - 5f64.sqrt());
    let at = |i: usize| 1.0 - 2.0 * depth(i as f64 / n as f64);
    let angles: Vec<[f64; 2]> =
        (0..n).map(|i| [(0.5 * (at(i) + at(i + 1))).acos(), (golden * i as f64) % TAU]).collect();
    Sampling { name, directions: Directions::from_angles(&angles).unwrap() }
}

pub(crate) fn even(n: usize) -> Sampling {
    spiral("even", n, |u| u)
}

/// Returns a sampling that is a hundred times denser at one pole than at the other.
pub(crate) fn clustered(n: usize) -> Sampling {
    spiral("clustered", n, |u| 0.02 * u + 0.98 * u * u)
}

/// Returns a random sampling.
pub(crate) fn irregular(n: usize, seed: u64) -> Sampling {
    let mut random = Random(seed);
    let angles: Vec<[f64; 2]> = (0..n).map(|_| [(1.0 - 2.0 * random.unit()).acos(), TAU * random.unit()]).collect();
    Sampling { name: "irregular", directions: Directions::from_angles(&angles).unwrap() }
}

/// Returns a sampling of the cap within `angle` of the pole.
pub(crate) fn cap(n: usize, angle: f64) -> Sampling {
    spiral("cap", n, |u| 0.5 * (1.0 - angle.cos()) * u)
}

/// Generator of random numbers from a counter.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        (((z ^ (z >> 31)) >> 11) as f64 + 0.5) / (1u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        (-2.0 * self.unit().ln()).sqrt() * (TAU * self.unit()).cos()
    }

    pub(crate) fn normals(&mut self, rows: usize, columns: usize) -> Array2<f64> {
        Array2::from_shape_simple_fn((rows, columns), || self.normal())
    }
}

pub(crate) fn uneven_weights(n: usize) -> Vec<f64> {
    (0..n).map(|i| 0.25 + ((i * 31) % 7) as f64).collect()
}

/// Returns the basis matrix A, (n, K), by direct sums.
pub(crate) fn matrix(directions: &Directions, max_degree: usize) -> Array2<f64> {
    let operator = MemoryOperator::new(directions, max_degree, 64).unwrap();
    operator.apply(Array2::eye(basis_size(max_degree)).view()).unwrap()
}

/// The minimum-norm solution of the dense problem, by its singular value decomposition.
pub(crate) struct Dense {
    pub(crate) x: Array2<f64>,
    /// Singular values of `[W^(1/2) A; P^(1/2)]`, in decreasing order.
    pub(crate) singular: Array1<f64>,
    /// Norms of the columns of `A^T W f`.
    pub(crate) scale: Vec<f64>,
    /// Norms of the columns of `W^(1/2) f`.
    pub(crate) size: Vec<f64>,
}

pub(crate) fn dense(a: &Array2<f64>, targets: &Array2<f64>, weights: Option<&[f64]>, smoothness: f64) -> Dense {
    let max_degree = a.ncols().isqrt() - 1;
    let roots = Array2::from_shape_fn((a.nrows(), 1), |(i, _)| weights.map_or(1.0, |w| w[i].sqrt()));
    let mut stacked = a * &roots;
    let mut right = targets * &roots;
    let adjoint = stacked.t().dot(&right);
    if smoothness > 0.0 {
        let penalty = Array1::from(smoothness_penalty(max_degree, smoothness)).mapv(f64::sqrt);
        stacked = concatenate![Axis(0), stacked, Array2::from_diag(&penalty)];
        right = concatenate![Axis(0), right, Array2::zeros((a.ncols(), targets.ncols()))];
    }
    let (u, singular, vt) = svd(&stacked);
    let least = 1e-13 * singular[0];
    let mut inner = u.t().dot(&right);
    for (mut row, value) in inner.rows_mut().into_iter().zip(&singular) {
        row.mapv_inplace(|v| if *value > least { v / value } else { 0.0 });
    }
    Dense { x: vt.t().dot(&inner), singular, scale: norms(&adjoint), size: norms(&right) }
}

/// Returns the singular value decomposition `u diag(s) vt`, with values in decreasing order.
pub(crate) fn svd(a: &Array2<f64>) -> (Array2<f64>, Array1<f64>, Array2<f64>) {
    let svd = to_faer(a).thin_svd().unwrap();
    let singular = svd.S().column_vector().iter().copied().collect();
    (to_ndarray(svd.U().to_owned()), singular, to_ndarray(svd.V().transpose().to_owned()))
}

pub(crate) fn inverse(a: &Array2<f64>) -> Array2<f64> {
    to_ndarray(to_faer(a).partial_piv_lu().inverse())
}

fn to_faer(a: &Array2<f64>) -> Mat<f64> {
    Mat::from_fn(a.nrows(), a.ncols(), |i, j| a[[i, j]])
}

fn to_ndarray(a: Mat<f64>) -> Array2<f64> {
    Array2::from_shape_fn((a.nrows(), a.ncols()), |(i, j)| a[(i, j)])
}

pub(crate) fn diagonal(values: Vec<f64>) -> Array2<f64> {
    Array2::from_diag(&Array1::from(values))
}

pub(crate) fn norms(a: &Array2<f64>) -> Vec<f64> {
    a.columns().into_iter().map(|c| c.dot(&c).sqrt()).collect()
}

pub(crate) fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    values.into_iter().fold(0.0, f64::max)
}

impl Dense {
    pub(crate) fn condition(&self) -> f64 {
        self.singular[0] / self.singular[self.singular.len() - 1]
    }

    /// Checks that the error of the coefficients is at most the error caused by a gradient of relative norm
    /// `optimality`, plus the error of computing the gradient with the accuracy of the transforms.
    pub(crate) fn meets(&self, fit: &LsqFit, optimality: f64, what: &str) {
        let (most, least) = (self.singular[0], self.singular[self.singular.len() - 1]);
        let off = norms(&(fit.coefficients.values() - &self.x));
        for (c, off) in off.into_iter().enumerate() {
            let gradient = 1.01 * optimality * self.scale[c] + ACCURACY * most * self.size[c];
            let allowed = gradient / (least * least);
            assert!(off <= allowed, "{what}, column {c}: off by {off:.2e}, allowed {allowed:.2e}");
        }
    }
}

pub(crate) fn transforms(directions: &Directions, max_degree: usize) -> MatrixFreeOperator {
    let params = TransformParams { max_degree, accuracy: ACCURACY, channels: 3 };
    MatrixFreeOperator::new(directions, &params).unwrap()
}

/// Solves for targets whose columns form one group.
pub(crate) fn solve(sampling: &Sampling, max_degree: usize, targets: &Array2<f64>, params: LsqParams) -> LsqFit {
    try_solve(sampling, max_degree, targets, params, &Silent).unwrap()
}

pub(crate) fn try_solve(
    sampling: &Sampling,
    max_degree: usize,
    targets: &Array2<f64>,
    params: LsqParams,
    monitor: &dyn Monitor,
) -> Result<LsqFit, SolverError> {
    let operator = transforms(&sampling.directions, max_degree);
    let weights = params.weights.clone();
    let gram = || {
        let gram = moment_gram(&sampling.directions, weights.as_deref(), max_degree)?;
        Ok(Box::new(gram) as Box<dyn GramMatrix>)
    };
    let mut solver = LsqSolver::new(&operator, Some(&gram), params)?;
    solver.fit(targets, std::slice::from_ref(&(0..targets.ncols())), monitor)
}

/// Accuracy of the transforms.
pub(crate) const ACCURACY: f64 = 1e-12;
pub(crate) const STRATEGIES: [Strategy; 4] = [Strategy::Auto, Strategy::Cg, Strategy::DensityCg, Strategy::Cholesky];

pub(crate) fn params(strategy: Strategy) -> LsqParams {
    LsqParams { strategy, threads: 2, ..LsqParams::default() }
}
