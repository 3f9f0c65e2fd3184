//! Two groups of unequal variance: B. L. Welch, "The generalization of 'Student's' problem when several different
//! population variances are involved", Biometrika 34 (1947).
//!
//! `t = (m_1 - m_2) / sqrt(s_1^2 / n_1 + s_2^2 / n_2)`, on the degrees of freedom of Satterthwaite, which differ from vertex
//! to vertex.

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;

use super::design::{Contrast, Design};
use super::distributions::{p_of_t, quantile_of_t};
use super::linear::{Effect, Found, Statistic, floors};
use crate::ShapeError;

/// The sign of the first group in a contrast of two groups.
pub(crate) fn groups(design: &Design, contrast: &Contrast) -> Result<(Vec<usize>, f64), ShapeError> {
    let groups = design.two_groups().ok_or(ShapeError::NotTwoGroups)?;
    let weights = &contrast.weights;
    if weights.nrows() != 1 || weights[[0, 0]] != -weights[[0, 1]] {
        return Err(ShapeError::NotTwoGroups);
    }
    let sizes = [0, 1].map(|group| groups.iter().filter(|of| **of == group).count());
    if let Some(small) = sizes.iter().find(|size| **size < 2) {
        return Err(ShapeError::Subjects { what: "a group", expected: 2, found: *small });
    }
    Ok((groups, weights[[0, 0]]))
}

/// Welch's t and its p at each vertex, NaN where there is no variance.
pub(crate) fn statistics(
    values: ArrayView2<'_, f64>,
    design: &Design,
    contrast: &Contrast,
    confidence: f64,
) -> Result<Found, ShapeError> {
    if values.ncols() == 0 {
        return Err(ShapeError::NotTwoGroups);
    }
    let (groups, weight) = groups(design, contrast)?;
    let floor = floors(values);
    let rows: Vec<Vertex> = (0..values.ncols())
        .into_par_iter()
        .map(|v| {
            let of = |group: usize| {
                moments(values.column(v).iter().zip(&groups).filter(|(_, of)| **of == group).map(|(y, _)| *y))
            };
            let ([n1, m1, s1], [n2, m2, s2]) = (of(0), of(1));
            let (v1, v2) = (s1 / (n1 - 1.0) / n1, s2 / (n2 - 1.0) / n2);
            let error = if s1 + s2 > floor[v] { (v1 + v2).sqrt() } else { f64::NAN };
            let freedom = (v1 + v2).powi(2) / (v1 * v1 / (n1 - 1.0) + v2 * v2 / (n2 - 1.0));
            let difference = m1 - m2;
            let pooled = ((s1 + s2) / (n1 + n2 - 2.0)).sqrt();
            let t = difference / error;
            Vertex {
                estimate: weight * difference,
                error: weight.abs() * error,
                t: weight.signum() * t,
                freedom,
                p: p_of_t(t, freedom),
                size: if error.is_nan() { f64::NAN } else { weight * difference / pooled },
            }
        })
        .collect();
    let column = |pick: fn(&Vertex) -> f64| rows.iter().map(pick).collect::<Vec<_>>();
    let table = |values: Vec<f64>| Array2::from_shape_vec((rows.len(), 1), values).unwrap_or_default();
    let least = rows.iter().map(|row| row.freedom).fold(f64::INFINITY, f64::min);
    let zero = |value: f64| if value.is_nan() { 0.0 } else { value };
    let effect = Effect {
        estimate: table(column(|row| row.estimate)),
        standard_error: table(rows.iter().map(|row| zero(row.error)).collect()),
        margin: table(rows.iter().map(|row| zero(row.error * quantile_of_t(confidence, row.freedom))).collect()),
        size: column(|row| row.size),
    };
    Ok((Statistic::T { freedom: least }, column(|row| row.t), column(|row| row.p), Some(effect)))
}

/// What is found at a vertex; NaN where there is no variance.
struct Vertex {
    estimate: f64,
    error: f64,
    t: f64,
    freedom: f64,
    p: f64,
    size: f64,
}

/// Number, mean, and sum of squares about the mean, in two rounds.
fn moments(values: impl Iterator<Item = f64> + Clone) -> [f64; 3] {
    let (mut n, mut sum) = (0.0, 0.0);
    values.clone().for_each(|value| (n, sum) = (n + 1.0, sum + value));
    let mean = sum / n;
    [n, mean, values.map(|value| (value - mean).powi(2)).sum()]
}
