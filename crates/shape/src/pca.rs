//! Computes the principal components of a group of aligned models: its modes of variation.
//!
//! Shapes are coefficients without row 0, which is the position. With the distance `|a - b| / sqrt(4 pi)` (see the
//! [crate]) the variance of a group is `sum |a_i - mean|^2 / (4 pi (n - 1))`, in the square of the unit of length.
//! Modes are coefficients of norm `sqrt(4 pi)`. The shape at z standard deviations along mode k is therefore `mean + z
//! sqrt(variance_k) mode_k` (T. F. Cootes et al., "Active shape models", Comput. Vis. Image Underst. 61, 1995). For
//! measures of quality, see [`quality`] and M. A. Styner et al., "Evaluation of 3D correspondence methods for model
//! building", IPMI 2003.
//!
//! Cost: a singular value decomposition of a (3 (K - 1), n) matrix, about `12 K n^2` flops. Memory: twice the group's
//! coefficients.

pub mod file;
pub mod quality;

use ndarray::{Array1, Array2, ArrayView2, Axis, s};
use spharm_linalg::{MatRef, ThinSvd};

use crate::ShapeError;
use crate::product::product;

const SPHERE: f64 = 4.0 * std::f64::consts::PI;

/// Mean and modes of a group of models of one degree.
#[derive(Debug, Clone)]
pub struct Modes {
    /// Mean (K, 3) of the group, with the position in row 0.
    pub mean: Array2<f64>,
    /// Modes (m, 3 (K - 1)), in order of decreasing variance. Each mode has the coefficients without row 0, in
    /// row-major order and with norm `sqrt(4 pi)`. The entry with the largest absolute value is positive.
    pub modes: Array2<f64>,
    /// Variance (m) along each mode, in the square of the unit of length.
    pub variances: Vec<f64>,
    /// Coordinates (n, m) of the group's members along the modes, in the unit of length.
    pub scores: Array2<f64>,
    /// Total variance of the group: the sum over all n - 1 modes.
    pub total_variance: f64,
}

impl Modes {
    /// Computes the first modes, at most `most`, of n models (K, 3) of one degree. n is at least 3, and there are at
    /// most n - 1 modes.
    ///
    /// # Errors
    ///
    /// [`ShapeError::TooFewMembers`] if there are fewer than 3 models; [`ShapeError::Degrees`] if their degrees differ
    /// or are 0; [`ShapeError::NotFiniteValue`] if a coefficient is NaN or infinite; [`ShapeError::Range`] if variances
    /// would overflow; [`ShapeError::NoDecomposition`] if the singular value decomposition doesn't converge.
    pub fn new(group: &[ArrayView2<'_, f64>], most: usize) -> Result<Self, ShapeError> {
        let n = group.len();
        if n < 3 {
            return Err(ShapeError::TooFewMembers { found: n, least: 3 });
        }
        let (rows, columns) = group[0].dim();
        for (index, model) in group.iter().enumerate() {
            if model.dim() != (rows, columns) || rows < 2 {
                return Err(ShapeError::Degrees { index, expected: rows.max(4), found: model.nrows() });
            }
            if let Some(at) = model.iter().position(|value| !value.is_finite()) {
                return Err(ShapeError::NotFiniteValue { what: "a model", row: at / columns, column: at % columns });
            }
        }
        let mut mean = Array2::zeros((rows, columns));
        group.iter().for_each(|model| mean += model);
        mean /= n as f64;
        // The members are the columns of a matrix, scaled such that squares stay in range for any unit.
        let mut largest = 0.0_f64;
        let mut centred = Vec::with_capacity(n * (rows - 1) * columns);
        for model in group {
            let rest = &model.slice(s![1.., ..]) - &mean.slice(s![1.., ..]);
            largest = rest.iter().fold(largest, |most, value| most.max(value.abs()));
            centred.extend(rest.iter().copied());
        }
        // Variances are sums of squares, which must stay in range.
        if !(1e6 * largest * largest).is_finite() {
            return Err(ShapeError::Range { largest });
        }
        let unit = if largest > 0.0 { largest } else { 1.0 };
        centred.iter_mut().for_each(|value| *value /= unit);
        let dimension = (rows - 1) * columns;
        let decomposed = ThinSvd::new(MatRef::from_column_major_slice(&centred, dimension, n));
        let decomposed = decomposed.map_err(|_| ShapeError::NoDecomposition)?;
        let singular: Vec<f64> = decomposed.singular().into_iter().map(|value| value * unit / SPHERE.sqrt()).collect();
        let of = |value: f64| value * value / (n - 1) as f64;
        let total_variance = singular.iter().map(|value| of(*value)).sum();
        let count = most.min(n - 1).min(dimension);
        let (mut modes, mut scores) = (Array2::zeros((count, dimension)), Array2::zeros((n, count)));
        for (k, &size) in singular.iter().enumerate().take(count) {
            let column = decomposed.u().col(k);
            let peak =
                column.iter().copied().fold(0.0_f64, |most, value| if value.abs() > most.abs() { value } else { most });
            let sign = if peak < 0.0 { -1.0 } else { 1.0 };
            modes.row_mut(k).iter_mut().zip(column.iter()).for_each(|(mode, u)| *mode = sign * u * SPHERE.sqrt());
            let right = decomposed.v().col(k);
            scores.column_mut(k).iter_mut().zip(right.iter()).for_each(|(score, v)| *score = sign * v * size);
        }
        let variances = singular[..count].iter().map(|value| of(*value)).collect();
        Ok(Self { mean, modes, variances, scores, total_variance })
    }

    /// Drops all modes except the first `count`.
    pub fn truncate(&mut self, count: usize) {
        let count = count.min(self.count());
        self.variances.truncate(count);
        self.modes = self.modes.slice(s![..count, ..]).to_owned();
        self.scores = self.scores.slice(s![.., ..count]).to_owned();
    }

    /// Returns the number of modes, m.
    pub fn count(&self) -> usize {
        self.variances.len()
    }

    /// Returns the shape (K, 3) at the given numbers of standard deviations along the first modes.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Mode`] if there are more deviations than modes; [`ShapeError::NotFiniteValue`] if a deviation is
    /// NaN or infinite.
    pub fn shape(&self, deviations: &[f64]) -> Result<Array2<f64>, ShapeError> {
        if deviations.len() > self.count() {
            return Err(ShapeError::Mode { found: deviations.len(), modes: self.count() });
        }
        if let Some(row) = deviations.iter().position(|z| !z.is_finite()) {
            return Err(ShapeError::NotFiniteValue { what: "standard deviations along modes", row, column: 0 });
        }
        let along: Array1<f64> =
            deviations.iter().zip(&self.variances).map(|(z, variance)| z * variance.sqrt()).collect();
        let offset = product(along.view().insert_axis(Axis(0)), self.modes.slice(s![..deviations.len(), ..]));
        let mut shape = self.mean.clone();
        shape.iter_mut().skip(self.mean.ncols()).zip(&offset).for_each(|(value, offset)| *value += offset);
        Ok(shape)
    }

    /// Returns the coordinates (m) of a model along the modes, and its distance from the space spanned by the mean and
    /// the modes, both in the unit of length.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Degrees`] if the model has another degree; [`ShapeError::NotFiniteValue`] if a coefficient is NaN
    /// or infinite.
    pub fn project(&self, model: ArrayView2<'_, f64>) -> Result<(Vec<f64>, f64), ShapeError> {
        if model.dim() != self.mean.dim() {
            return Err(ShapeError::Degrees { index: 0, expected: self.mean.nrows(), found: model.nrows() });
        }
        if let Some(at) = model.iter().position(|value| !value.is_finite()) {
            return Err(ShapeError::NotFiniteValue {
                what: "the model",
                row: at / model.ncols(),
                column: at % model.ncols(),
            });
        }
        let rest = &model.slice(s![1.., ..]) - &self.mean.slice(s![1.., ..]);
        // The differences from the mean are stored as a matrix of one column, because `product` only multiplies
        // matrices.
        let mut rest = Array2::from_shape_vec((rest.len(), 1), rest.iter().copied().collect()).unwrap_or_default();
        let scores = product(self.modes.view(), rest.view()) / SPHERE;
        rest -= &product(self.modes.t(), scores.view());
        let left = rest.iter().map(|value| value * value).sum::<f64>();
        Ok((scores.iter().copied().collect(), (left / SPHERE).sqrt()))
    }

    /// Returns the fraction of the group's variance along each of the m modes; 0 for a group without variance.
    pub fn shares(&self) -> Vec<f64> {
        let share = |variance: &f64| if self.total_variance > 0.0 { variance / self.total_variance } else { 0.0 };
        self.variances.iter().map(share).collect()
    }

    /// Returns the compactness: the fraction of the group's variance along the first k modes, for k = 1 to m.
    pub fn compactness(&self) -> Vec<f64> {
        let mut sum = 0.0;
        let shares = self.variances.iter().map(|variance| {
            sum += variance;
            if self.total_variance > 0.0 { sum / self.total_variance } else { 1.0 }
        });
        shares.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns shapes that vary along two known directions.
    pub(super) fn group(n: usize) -> Vec<Array2<f64>> {
        (0..n)
            .map(|i| {
                let mut shape = Array2::from_shape_fn((16, 3), |(k, c)| ((3 * k + c) as f64).sin() * 10.0);
                let t = i as f64 - (n - 1) as f64 / 2.0;
                shape[[4, 1]] += 2.0 * t;
                shape[[7, 2]] += 0.5 * (t * t - ((n * n - 1) as f64) / 12.0);
                shape[[0, 0]] += 100.0 * t;
                shape
            })
            .collect()
    }

    #[test]
    fn known_directions_are_found() {
        let group = group(7);
        let views: Vec<_> = group.iter().map(|member| member.view()).collect();
        let modes = Modes::new(&views, 10).unwrap();
        assert_eq!(modes.count(), 6);
        // The values of t are -3 to 3, and their squares sum to 28.
        assert!((modes.variances[0] / (4.0 * 28.0 / 6.0 / SPHERE) - 1.0).abs() < 1e-13, "{:?}", modes.variances);
        assert!(modes.variances[2..].iter().all(|variance| *variance < 1e-25));
        assert!((modes.total_variance - modes.variances.iter().sum::<f64>()).abs() < 1e-15);
        // The element of row 4 and column 1 has index 3 * 3 + 1 = 10, because row 0 is omitted.
        assert!((modes.modes[[0, 10]] - SPHERE.sqrt()).abs() < 1e-13);
        for (i, member) in group.iter().enumerate() {
            let (scores, left) = modes.project(member.view()).unwrap();
            assert!(left < 1e-13 && (scores[0] - modes.scores[[i, 0]]).abs() < 1e-13);
            let deviations: Vec<f64> = (0..2).map(|k| scores[k] / modes.variances[k].sqrt()).collect();
            let back = modes.shape(&deviations).unwrap();
            let off = &back.slice(s![1.., ..]) - &member.slice(s![1.., ..]);
            assert!(off.iter().all(|value| value.abs() < 1e-12));
        }
    }

    #[test]
    fn small_and_large_units_are_the_same() {
        let group = group(5);
        for unit in [1e-150, 1e150] {
            let scaled: Vec<Array2<f64>> = group.iter().map(|shape| shape * unit).collect();
            let views: Vec<_> = scaled.iter().map(|member| member.view()).collect();
            let modes = Modes::new(&views, 2).unwrap();
            let deviation = modes.scores[[0, 0]] / unit;
            let plain = Modes::new(&group.iter().map(|member| member.view()).collect::<Vec<_>>(), 2).unwrap();
            assert!((deviation / plain.scores[[0, 0]] - 1.0).abs() < 1e-12, "{unit}");
        }
    }

    #[test]
    fn groups_that_are_none_are_refused() {
        let (group, other) = (group(3), Array2::zeros((9, 3)));
        let views: Vec<_> = group.iter().map(|member| member.view()).collect();
        assert!(matches!(Modes::new(&views[..2], 1).unwrap_err(), ShapeError::TooFewMembers { found: 2, least: 3 }));
        let mixed = [views[0], other.view(), views[1]];
        assert!(matches!(Modes::new(&mixed, 1).unwrap_err(), ShapeError::Degrees { index: 1, .. }));
        let modes = Modes::new(&views, 1).unwrap();
        assert!(modes.shape(&[1.0, 2.0]).is_err() && modes.shape(&[f64::NAN]).is_err());
    }
}
