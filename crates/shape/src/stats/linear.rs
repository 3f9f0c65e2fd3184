//! Fits the linear model at each vertex, and computes t, F or Hotelling's `T^2`, and effects with their confidence
//! intervals.
//!
//! The orthonormal bases of the design, which has p columns, are from `projection`. Q_E (n, q) is the basis of the part
//! that a contrast of q rows tests, and Y (n, d) are the values at a vertex. With b = Q_E^T Y and T = |residual of the
//! reduced model|^2, the errors have the sum of squares `W = T - b^T b` and v = n - p degrees of freedom. The
//! statistics are
//!
//! - d = 1, one row: `t = b / sqrt(W / v)`;
//! - d = 1, q rows: `F = (|b|^2 / q) / (W / v)` with (q, v) degrees of freedom;
//! - d > 1, one row: `T^2 = v b W^-1 b^T`, for which `(v - d + 1) / (v d) T^2` is F with (d, v - d + 1) degrees of
//!   freedom (T. W. Anderson, "An Introduction to Multivariate Statistical Analysis", 3rd ed. (2003), theorem 5.2.2).
//!
//! With a design of two groups, these are the two-sample tests. With a design of the mean alone, they are the
//! one-sample tests. Cost: about `2 n V d (2 p + q + 2)` flops.

use ndarray::{Array2, ArrayView2, Axis};
use rayon::prelude::*;

use super::TestParams;
use super::blocks::Blocks;
use super::design::{Contrast, Design};
use super::distributions::{p_of_f, p_of_t, quantile_of_t};
use super::projection::{Projection, without};
use super::resampling::Resampling;
use crate::ShapeError;
use crate::product::product;

/// Statistic of a test.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum Statistic {
    /// Student's t.
    T {
        /// Degrees of freedom of the errors; for unequal variances, the minimum over all vertices.
        freedom: f64,
    },
    /// Fisher's F.
    F {
        /// Number of rows of the contrast.
        between: f64,
        /// Degrees of freedom of the errors; for unequal variances, the minimum over all vertices.
        within: f64,
    },
    /// Hotelling's `T^2`.
    TSquared {
        /// Number of components per vertex, d.
        components: usize,
        /// Degrees of freedom of the errors; for unequal variances, the minimum over all vertices.
        freedom: f64,
    },
}

impl Statistic {
    /// Returns the two-sided p value of `statistic`.
    pub(crate) fn p(&self, statistic: f64) -> f64 {
        match *self {
            Self::T { freedom } => p_of_t(statistic, freedom),
            Self::F { between, within } => p_of_f(statistic, between, within),
            Self::TSquared { components, freedom } => {
                let d = components as f64;
                let within = freedom - d + 1.0;
                p_of_f(statistic * within / (freedom * d), d, within)
            }
        }
    }

    /// Returns the positive statistic with the two-sided p value `p`, in (0, 1).
    pub(crate) fn threshold(&self, p: f64) -> f64 {
        let (mut low, mut high) = (0.0, 1.0);
        while self.p(high) > p && high < 1e150 {
            high *= 2.0;
        }
        for _ in 0..200 {
            let middle = 0.5 * (low + high);
            if self.p(middle) > p { low = middle } else { high = middle }
        }
        high
    }
}

/// Estimate of a contrast of one row, `c^T B`, in the measurement's unit.
#[derive(Debug, Clone)]
pub struct Effect {
    /// Estimates of the contrast (V, d).
    pub estimate: Array2<f64>,
    /// Standard errors of the estimates (V, d).
    pub standard_error: Array2<f64>,
    /// Half the widths of the estimates' confidence intervals (V, d).
    pub margin: Array2<f64>,
    /// Effect sizes (V): the estimate divided by the errors' standard deviation. This is Cohen's d for two groups
    /// without covariates, and the Mahalanobis distance for measurements of d > 1 components. NaN at vertices without
    /// variance.
    pub size: Vec<f64>,
}

pub(crate) fn check(
    values: ArrayView2<'_, f64>,
    components: usize,
    design: &Design,
    contrast: &Contrast,
    params: &TestParams,
) -> Result<(), ShapeError> {
    let (n, columns) = values.dim();
    if n != design.subjects() {
        return Err(ShapeError::Subjects { what: "the values", expected: design.subjects(), found: n });
    }
    if components == 0 || columns == 0 || !columns.is_multiple_of(components) {
        return Err(ShapeError::Components { columns, components });
    }
    if let Some(at) = values.iter().position(|value| !value.is_finite()) {
        return Err(ShapeError::NotFiniteValue { what: "the values", row: at / columns, column: at % columns });
    }
    check_design(components, design, contrast, params)
}

/// Checks the design, the contrast and the settings, which is possible before the values are available.
pub(crate) fn check_design(
    components: usize,
    design: &Design,
    contrast: &Contrast,
    params: &TestParams,
) -> Result<(), ShapeError> {
    let (n, p) = design.matrix().dim();
    let (rows, weights) = contrast.weights.dim();
    if weights != p || rows == 0 || rows > p {
        return Err(ShapeError::Contrast {
            expected: "a weight for each column of the design, and at most as many rows as columns",
            found: format!("{rows} rows of {weights} weights for {p} columns"),
        });
    }
    if !contrast.weights.iter().all(|weight| weight.is_finite()) {
        return Err(ShapeError::Contrast { expected: "finite weights", found: "NaN or infinity".to_owned() });
    }
    if rows > 1 && components > 1 {
        return Err(ShapeError::Contrast {
            expected: "one row, because the values have several components",
            found: format!("{rows} rows"),
        });
    }
    // Hotelling's T^2 needs v - d + 1 > 0, with v the degrees of freedom and d the number of components.
    let least = p + components;
    if n < least {
        return Err(ShapeError::Subjects { what: "the design", expected: least, found: n });
    }
    check_relabellings(n, components, params)?;
    for (what, found) in [("confidence", params.confidence), ("level", params.level)] {
        if !(found > 0.0 && found < 1.0) {
            return Err(ShapeError::Share { what, found });
        }
    }
    Ok(())
}

/// Checks that blocks, variance groups and assumptions about errors match the n subjects and each other.
fn check_relabellings(n: usize, components: usize, params: &TestParams) -> Result<(), ShapeError> {
    let differ = |what, found| ShapeError::Subjects { what, expected: n, found };
    if let Some(found) = params.blocks.as_ref().map(Blocks::observations).filter(|found| *found != n) {
        return Err(differ("blocks", found));
    }
    let unlike =
        |expected, found: &str| ShapeError::Setting { name: "variance_groups", found: found.to_owned(), expected };
    match (&params.variance_groups, components) {
        (Some(_), _) if params.welch => Err(unlike("use only one of the two", "given together with Welch's test")),
        (Some(of), _) if of.len() != n => Err(differ("variance_groups", of.len())),
        (Some(_), 2..) => Err(unlike("only values of one component are possible", "given for positions")),
        _ => match params.errors {
            Some(errors) if params.welch && errors != Resampling::SignFlips => Err(ShapeError::Setting {
                name: "the assumption about the errors",
                found: errors.assumption().to_owned(),
                expected: "Welch's test needs independent errors, symmetric about zero",
            }),
            _ => Ok(()),
        },
    }
}

pub(crate) type Found = (Statistic, Vec<f64>, Vec<f64>, Option<Effect>);

/// Returns the statistics and p values at all vertices; NaN at vertices without variance.
pub(crate) fn statistics(
    values: ArrayView2<'_, f64>,
    components: usize,
    contrast: &Contrast,
    model: &Projection,
    confidence: f64,
) -> Result<Found, ShapeError> {
    let reduced = model.residual(values);
    let along = product(model.effect.t(), reduced.view()); // (q, V d)
    let errors = without(model.effect.view(), reduced);
    let (freedom, rows) = (model.freedom as f64, contrast.weights.nrows());
    debug_assert_eq!(rows, along.nrows());
    let vertices = values.ncols() / components;
    // Each column has a floor, which depends on the size of the column's values. A sum of squares up to this floor is
    // treated as a rounding error.
    let floor = floors(values);
    if components == 1 {
        let squares = column_squares(errors.view());
        let variance = |v: usize| if squares[v] > floor[v] { squares[v] / freedom } else { f64::NAN };
        let (kind, statistic): (_, Vec<f64>) = if rows == 1 {
            let t = (0..vertices).map(|v| along[[0, v]] / variance(v).sqrt()).collect();
            (Statistic::T { freedom }, t)
        } else {
            let between = rows as f64;
            let sum = |v: usize| along.column(v).iter().map(|b| b * b).sum::<f64>();
            let f = (0..vertices).map(|v| sum(v) / between / variance(v)).collect();
            (Statistic::F { between, within: freedom }, f)
        };
        let p = statistic.par_iter().map(|statistic| kind.p(*statistic)).collect();
        let effect = (rows == 1).then(|| effect(model, &along, &squares, &floor, components, confidence, None));
        return Ok((kind, statistic, p, effect));
    }
    let quotients: Vec<f64> = (0..vertices)
        .into_par_iter()
        .map(|v| {
            let columns = v * components..(v + 1) * components;
            let block = errors.slice(ndarray::s![.., columns.clone()]);
            let mut scatter = Small::gram(block);
            let b: Vec<f64> = columns.clone().map(|column| along[[0, column]]).collect();
            let floor = columns.map(|column| floor[column]).fold(0.0, f64::max);
            if scatter.factorise(floor) { scatter.quotient(&b) } else { f64::NAN }
        })
        .collect();
    let statistic: Vec<f64> = quotients.iter().map(|quotient| freedom * quotient).collect();
    let kind = Statistic::TSquared { components, freedom };
    let p = statistic.par_iter().map(|t2| kind.p(*t2)).collect();
    let sizes = quotients.iter().map(|quotient| model.scale * (freedom * quotient).sqrt()).collect();
    let squares = column_squares(errors.view());
    let effect = effect(model, &along, &squares, &floor, components, confidence, Some(sizes));
    Ok((kind, statistic, p, Some(effect)))
}

fn effect(
    model: &Projection,
    along: &Array2<f64>,
    squares: &[f64],
    floor: &[f64],
    components: usize,
    confidence: f64,
    sizes: Option<Vec<f64>>,
) -> Effect {
    let freedom = model.freedom as f64;
    let vertices = squares.len() / components;
    let shape = |values: Vec<f64>| Array2::from_shape_vec((vertices, components), values).unwrap_or_default();
    let estimate = shape(along.row(0).iter().map(|b| model.scale * b).collect());
    let standard_error = shape(squares.iter().map(|square| model.scale * (square / freedom).sqrt()).collect());
    let margin = standard_error.mapv(|error| quantile_of_t(confidence, freedom) * error);
    let deviation = |v: usize| if squares[v] > floor[v] { (squares[v] / freedom).sqrt() } else { f64::NAN };
    let size = sizes.unwrap_or_else(|| (0..vertices).map(|v| estimate[[v, 0]] / deviation(v)).collect());
    Effect { estimate, standard_error, margin, size }
}

/// Returns the sum of squares of each column.
pub(crate) fn column_squares(values: ArrayView2<'_, f64>) -> Vec<f64> {
    let mut sums = vec![0.0; values.ncols()];
    for row in values.axis_iter(Axis(0)) {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value * value);
    }
    sums
}

/// For each column, returns an upper bound of the sum of squares that rounding errors of the column's values can cause.
pub(crate) fn floors(values: ArrayView2<'_, f64>) -> Vec<f64> {
    let n = values.nrows() as f64;
    column_squares(values).into_iter().map(|sum| sum * n * (8.0 * f64::EPSILON).powi(2)).collect()
}

/// A small symmetric matrix. Its lower triangle is stored and factorised in place.
pub(crate) struct Small {
    size: usize,
    values: Vec<f64>,
}

impl Small {
    /// Returns the matrix `B^T B` of a block B (n, d) of values.
    pub(crate) fn gram(block: ArrayView2<'_, f64>) -> Self {
        let size = block.ncols();
        let mut values = vec![0.0; size * size];
        for row in block.rows() {
            for i in 0..size {
                for j in 0..=i {
                    values[i * size + j] += row[i] * row[j];
                }
            }
        }
        Self { size, values }
    }

    pub(crate) fn zeros(size: usize) -> Self {
        Self { size, values: vec![0.0; size * size] }
    }

    /// Sets each element of the lower triangle to `value(row, column)`.
    pub(crate) fn fill(&mut self, value: impl Fn(usize, usize) -> f64) {
        for i in 0..self.size {
            for j in 0..=i {
                self.values[i * self.size + j] = value(i, j);
            }
        }
    }

    /// Returns the identity matrix minus `sum g g^T` over the given vectors g.
    pub(crate) fn unit_without<'g>(size: usize, vectors: impl Iterator<Item = &'g [f64]>) -> Self {
        let mut values = vec![0.0; size * size];
        (0..size).for_each(|i| values[i * size + i] = 1.0);
        for g in vectors {
            for i in 0..size {
                for j in 0..=i {
                    values[i * size + j] -= g[i] * g[j];
                }
            }
        }
        Self { size, values }
    }

    /// Replaces the lower triangle by the Cholesky factor. Returns false if a pivot is at most `floor`, or so small
    /// that it is a rounding error.
    pub(crate) fn factorise(&mut self, floor: f64) -> bool {
        let d = self.size;
        let largest = (0..d).map(|i| self.values[i * d + i]).fold(0.0, f64::max);
        for i in 0..d {
            for j in 0..=i {
                let mut sum = self.values[i * d + j];
                for k in 0..j {
                    sum -= self.values[i * d + k] * self.values[j * d + k];
                }
                if i == j {
                    if !(sum > floor && sum > 1e-13 * largest) {
                        return false;
                    }
                    self.values[i * d + i] = sum.sqrt();
                } else {
                    self.values[i * d + j] = sum / self.values[j * d + j];
                }
            }
        }
        true
    }

    /// Returns `b M^-1 b^T` for the factorised matrix M.
    pub(crate) fn quotient(&self, b: &[f64]) -> f64 {
        let mut b = b.to_vec();
        self.whiten(&mut b);
        b.iter().map(|value| value * value).sum()
    }

    /// Returns `tr (S M^-1)^2` and `(tr S M^-1)^2` for the factorised matrix M and the symmetric matrix S whose
    /// elements `element` returns.
    pub(crate) fn squared_traces(&self, element: impl Fn(usize, usize) -> f64) -> [f64; 2] {
        // With M = L L^T, the matrix B = L^-1 S L^-T is similar to S M^-1, so their powers have the same traces.
        let d = self.size;
        let mut b: Vec<Vec<f64>> = (0..d).map(|i| (0..d).map(|j| element(i, j)).collect()).collect();
        b.iter_mut().for_each(|row| self.whiten(row));
        let mut columns: Vec<Vec<f64>> = (0..d).map(|j| b.iter().map(|row| row[j]).collect()).collect();
        columns.iter_mut().for_each(|column| self.whiten(column));
        let trace: f64 = (0..d).map(|i| columns[i][i]).sum();
        [columns.iter().flatten().map(|value| value * value).sum(), trace * trace]
    }

    /// Replaces b by `L^-1 b`, with L the Cholesky factor.
    pub(crate) fn whiten(&self, b: &mut [f64]) {
        let d = self.size;
        for i in 0..d {
            for k in 0..i {
                b[i] -= self.values[i * d + k] * b[k];
            }
            b[i] /= self.values[i * d + i];
        }
    }
}
