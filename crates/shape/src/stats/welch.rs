//! Tests the difference between the means of two groups of unequal variance.
//!
//! Group g has n_g subjects with the mean m_g and the standard deviation s_g, or the covariance S_g for d > 1
//! components. For one component, the statistic is `t = (m_1 - m_2) / sqrt(s_1^2 / n_1 + s_2^2 / n_2)` with
//! Satterthwaite's degrees of freedom (B. L. Welch, "The generalization of 'Student's' problem when several different
//! population variances are involved", Biometrika 34 (1947)). For several components, the statistic is
//! `T^2 = D^T C^-1 D` with `D = m_1 - m_2`, `C = C_1 + C_2` and `C_g = S_g / n_g`. Approximately,
//! `(v - d + 1) / (v d) T^2` is F with (d, v - d + 1) degrees of freedom, and
//!
//! ```text
//! v = (d + d^2) / sum_g (tr (C_g C^-1)^2 + (tr C_g C^-1)^2) / (n_g - 1)
//! ```
//!
//! (K. Krishnamoorthy and J. Yu, "Modified Nel and Van der Merwe test for the multivariate Behrens-Fisher problem",
//! Stat. Probab. Lett. 66 (2004)). The degrees of freedom differ between vertices. For d = 1 both formulas agree.

use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;

use super::design::{Contrast, Design};
use super::distributions::{p_of_f, p_of_t, quantile_of_t};
use super::linear::{Effect, Found, Small, Statistic, floors};
use crate::ShapeError;
use crate::product::product;

/// For a contrast of two groups, returns the group of each subject, 0 or 1, and the weight of the first group's mean.
/// Returns an error if a group has fewer than `components + 1` subjects.
pub(crate) fn groups(design: &Design, contrast: &Contrast, components: usize) -> Result<(Vec<usize>, f64), ShapeError> {
    let groups = design.two_groups().ok_or(ShapeError::NotTwoGroups)?;
    let weights = &contrast.weights;
    if weights.nrows() != 1 || weights[[0, 0]] != -weights[[0, 1]] {
        return Err(ShapeError::NotTwoGroups);
    }
    // The covariance of each group must be invertible.
    let expected = components + 1;
    let sizes = [0, 1].map(|group| groups.iter().filter(|of| **of == group).count());
    if let Some(&found) = sizes.iter().find(|size| **size < expected) {
        return Err(ShapeError::Subjects { what: "a group", expected, found });
    }
    Ok((groups, weights[[0, 0]]))
}

/// Returns Welch's statistic and its p value at each vertex, for values (n, V d); NaN at vertices without variance.
pub(crate) fn statistics(
    values: ArrayView2<'_, f64>,
    components: usize,
    (groups, weight): (&[usize], f64),
    confidence: f64,
) -> Found {
    let floor = floors(values);
    let members = [0, 1].map(|group| (0..groups.len()).filter(|i| groups[*i] == group).collect::<Vec<_>>());
    let rows: Vec<Vertex> = (0..values.ncols() / components)
        .into_par_iter()
        .map(|v| {
            let columns = v * components..(v + 1) * components;
            let floor = floor[columns.clone()].iter().copied().fold(0.0, f64::max);
            let block = values.slice(s![.., columns]);
            let halves = [0, 1].map(|group| Half::new(block.select(Axis(0), &members[group])));
            Vertex::new(&halves, weight, confidence, floor)
        })
        .collect();
    let column = |pick: fn(&Vertex) -> f64| rows.iter().map(pick).collect::<Vec<_>>();
    let table = |pick: fn(&Vertex) -> &Vec<f64>| {
        Array2::from_shape_fn((rows.len(), components), |(v, component)| pick(&rows[v])[component])
    };
    let least = rows.iter().map(|row| row.freedom).fold(f64::INFINITY, f64::min);
    let kind = match components {
        1 => Statistic::T { freedom: least },
        _ => Statistic::TSquared { components, freedom: least },
    };
    let effect = Effect {
        estimate: table(|row| &row.estimate),
        standard_error: table(|row| &row.error),
        margin: table(|row| &row.margin),
        size: column(|row| row.size),
    };
    (kind, column(|row| row.statistic), column(|row| row.p), Some(effect))
}

/// Statistics of one group at a vertex.
struct Half {
    n: f64,
    mean: Vec<f64>,
    /// Scatter matrix (d, d) about the group's mean.
    scatter: Array2<f64>,
}

impl Half {
    fn new(mut values: Array2<f64>) -> Self {
        let n = values.nrows();
        let mean: Vec<f64> = values.columns().into_iter().map(|column| column.sum() / n as f64).collect();
        for mut row in values.rows_mut() {
            row.iter_mut().zip(&mean).for_each(|(value, mean)| *value -= mean);
        }
        let scatter = product(values.t(), values.view());
        Self { n: n as f64, mean, scatter }
    }

    /// Returns the element (i, j) of `C_g`, the covariance of the group's mean.
    fn error(&self, i: usize, j: usize) -> f64 {
        self.scatter[[i, j]] / (self.n - 1.0) / self.n
    }
}

/// Results of the test at a vertex. If the values have no variance at the vertex, statistic, p and size are NaN.
struct Vertex {
    estimate: Vec<f64>,
    error: Vec<f64>,
    margin: Vec<f64>,
    statistic: f64,
    freedom: f64,
    p: f64,
    size: f64,
}

impl Vertex {
    fn new(halves: &[Half; 2], weight: f64, confidence: f64, floor: f64) -> Self {
        let [a, b] = halves;
        let d = a.mean.len();
        let difference: Vec<f64> = a.mean.iter().zip(&b.mean).map(|(a, b)| a - b).collect();
        let estimate: Vec<f64> = difference.iter().map(|difference| weight * difference).collect();
        let variances: Vec<f64> = (0..d).map(|i| a.error(i, i) + b.error(i, i)).collect();
        let error: Vec<f64> = variances.iter().map(|variance| weight.abs() * variance.sqrt()).collect();
        let margin = (0..d).map(|i| {
            let halves = halves.iter().map(|half| half.error(i, i).powi(2) / (half.n - 1.0)).sum::<f64>();
            if halves > 0.0 { quantile_of_t(confidence, variances[i].powi(2) / halves) * error[i] } else { 0.0 }
        });
        let margin = margin.collect();
        let flat = |estimate, error, margin| Self {
            estimate,
            error,
            margin,
            statistic: f64::NAN,
            freedom: f64::INFINITY,
            p: f64::NAN,
            size: f64::NAN,
        };
        let mut errors = Small::zeros(d);
        errors.fill(|i, j| a.error(i, j) + b.error(i, j));
        if !errors.factorise(floor / (a.n * b.n)) {
            return flat(estimate, error, margin);
        }
        let squared = errors.quotient(&difference);
        let freedom = freedom(halves, &errors);
        let mut pooled = Small::zeros(d);
        pooled.fill(|i, j| (a.scatter[[i, j]] + b.scatter[[i, j]]) / (a.n + b.n - 2.0));
        let known = pooled.factorise(0.0);
        let size = if known { weight.abs() * pooled.quotient(&difference).sqrt() } else { f64::NAN };
        let within = freedom - d as f64 + 1.0;
        let (statistic, p, size) = if d == 1 {
            let t = (weight * difference[0]).signum() * squared.sqrt();
            (t, p_of_t(t, freedom), size.copysign(weight * difference[0]))
        } else {
            (squared, p_of_f(squared * within / (freedom * d as f64), d as f64, within), size)
        };
        Self { estimate, error, margin, statistic, freedom, p, size }
    }
}

/// Returns Krishnamoorthy and Yu's degrees of freedom, given the factorised matrix C.
fn freedom(halves: &[Half; 2], factor: &Small) -> f64 {
    let d = halves[0].mean.len();
    let spread = |half: &Half| factor.squared_traces(|i, j| half.error(i, j)).iter().sum::<f64>() / (half.n - 1.0);
    let sum: f64 = halves.iter().map(spread).sum();
    (d + d * d) as f64 / sum
}
