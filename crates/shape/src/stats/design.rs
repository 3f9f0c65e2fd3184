//! Defines the linear model of a study and the hypothesis to test.

use ndarray::{Array2, ArrayView1, ArrayView2};

use super::terms::centred;
use crate::ShapeError;

/// A design matrix X (n, p) of full column rank, with one row per subject.
#[derive(Debug, Clone)]
pub struct Design {
    matrix: Array2<f64>,
    names: Vec<String>,
}

/// A column is treated as linearly dependent if the norm of its part orthogonal to the preceding columns is at most
/// this fraction of the column's norm.
const DEPENDENT: f64 = 1e-9;

impl Design {
    /// Creates a design from a matrix and the names of its columns.
    ///
    /// # Errors
    ///
    /// [`ShapeError::NotFiniteValue`] if an element is NaN or infinite; [`ShapeError::Rank`] if a column depends
    /// linearly on the preceding columns; [`ShapeError::Subjects`] if the number of rows isn't above the number of
    /// columns.
    pub fn new(matrix: Array2<f64>, names: Vec<String>) -> Result<Self, ShapeError> {
        let (n, p) = matrix.dim();
        if let Some(at) = matrix.iter().position(|value| !value.is_finite()) {
            return Err(ShapeError::NotFiniteValue { what: "the design", row: at / p, column: at % p });
        }
        if n <= p {
            return Err(ShapeError::Subjects { what: "the design", expected: p + 1, found: n });
        }
        let named = |column: usize| names.get(column).cloned().unwrap_or_else(|| format!("column {}", column + 1));
        let names = (0..p).map(named).collect::<Vec<_>>();
        if let (_, Some(column)) = orthonormalise(matrix.view()) {
            return Err(ShapeError::Rank { column: names[column].clone() });
        }
        Ok(Self { matrix, names })
    }

    /// Creates the design of groups of the given sizes, with subjects in the order of their groups: a column of ones
    /// and zeros for each group.
    ///
    /// # Errors
    ///
    /// [`ShapeError::EmptyGroup`] if a group has no subjects; [`ShapeError::Subjects`] if there are no groups, or if
    /// each group has a single subject.
    pub fn groups(sizes: &[usize]) -> Result<Self, ShapeError> {
        let of: Vec<usize> = sizes.iter().enumerate().flat_map(|(group, &size)| vec![group; size]).collect();
        if let Some(empty) = sizes.iter().position(|size| *size == 0) {
            return Err(ShapeError::EmptyGroup { group: empty + 1 });
        }
        let matrix = Array2::from_shape_fn((of.len(), sizes.len()), |(i, group)| f64::from(of[i] == group));
        Self::new(matrix, (1..=sizes.len()).map(|group| format!("group {group}")).collect())
    }

    /// Adds the covariates (n, k) as columns. Each covariate is centred by subtracting its mean, so that the
    /// coefficients of the other columns keep their meaning.
    ///
    /// # Errors
    ///
    /// The errors of [`new`](Self::new), and [`ShapeError::Subjects`] if the number of rows differs from the design's.
    pub fn with_covariates(&self, covariates: ArrayView2<'_, f64>, names: &[String]) -> Result<Self, ShapeError> {
        let (n, p) = self.matrix.dim();
        if covariates.nrows() != n {
            return Err(ShapeError::Subjects { what: "covariates", expected: n, found: covariates.nrows() });
        }
        let mut matrix = Array2::zeros((n, p + covariates.ncols()));
        matrix.slice_mut(ndarray::s![.., ..p]).assign(&self.matrix);
        for (column, values) in covariates.columns().into_iter().enumerate() {
            matrix.column_mut(p + column).assign(&ArrayView1::from(&centred(&values.to_vec())));
        }
        Self::new(matrix, self.names.iter().chain(names).cloned().collect())
    }

    /// Returns the design matrix X (n, p).
    pub fn matrix(&self) -> ArrayView2<'_, f64> {
        self.matrix.view()
    }

    /// Returns the names of the p columns.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Returns the number of subjects, n.
    pub fn subjects(&self) -> usize {
        self.matrix.nrows()
    }

    /// Returns the group of each subject if the design has two columns of ones and zeros, one for each group.
    pub fn two_groups(&self) -> Option<Vec<usize>> {
        if self.matrix.ncols() != 2 {
            return None;
        }
        self.matrix
            .rows()
            .into_iter()
            .map(|row| match (row[0], row[1]) {
                (1.0, 0.0) => Some(0),
                (0.0, 1.0) => Some(1),
                _ => None,
            })
            .collect()
    }
}

/// Weights of a design's columns, in one or more rows c. The null hypothesis is that `c^T B` is zero for each row,
/// where B are the coefficients of the linear model.
#[derive(Debug, Clone, PartialEq)]
pub struct Contrast {
    /// Weights (q, p) of full row rank.
    pub weights: Array2<f64>,
}

impl Contrast {
    /// Creates a contrast of one row.
    pub fn row(weights: &[f64]) -> Self {
        Self { weights: Array2::from_shape_fn((1, weights.len()), |(_, column)| weights[column]) }
    }

    /// Creates the contrast of column `first` minus column `second`, for a design of `columns` columns.
    pub fn difference(columns: usize, first: usize, second: usize) -> Self {
        let weight = |column: usize| f64::from(column == first) - f64::from(column == second);
        Self { weights: Array2::from_shape_fn((1, columns), |(_, column)| weight(column)) }
    }

    /// Creates the contrast of the single column `column`, such as the slope of a covariate, for a design of `columns`
    /// columns.
    pub fn column(columns: usize, column: usize) -> Self {
        Self { weights: Array2::from_shape_fn((1, columns), |(_, at)| f64::from(at == column)) }
    }
}

/// Returns an orthonormal basis Q (n, r) of the columns' span, by Gram-Schmidt with reorthogonalisation, and the index
/// of the first column that depends on the preceding columns, if any. Dependent columns add nothing to Q.
pub(crate) fn orthonormalise(matrix: ArrayView2<'_, f64>) -> (Array2<f64>, Option<usize>) {
    let (n, p) = matrix.dim();
    let mut basis: Vec<Vec<f64>> = Vec::with_capacity(p);
    let mut dependent = None;
    for (at, column) in matrix.columns().into_iter().enumerate() {
        let mut rest: Vec<f64> = column.to_vec();
        let scale = norm(&rest);
        for _ in 0..2 {
            for q in &basis {
                let along = dot(q, &rest);
                rest.iter_mut().zip(q).for_each(|(rest, q)| *rest -= along * q);
            }
        }
        let left = norm(&rest);
        if left > DEPENDENT * scale {
            rest.iter_mut().for_each(|value| *value /= left);
            basis.push(rest);
        } else if dependent.is_none() {
            dependent = Some(at);
        }
    }
    (Array2::from_shape_fn((n, basis.len()), |(i, k)| basis[k][i]), dependent)
}

pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn norm(a: &[f64]) -> f64 {
    // Values are scaled, so that squares neither overflow nor underflow.
    let largest = a.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    if largest == 0.0 { 0.0 } else { largest * a.iter().map(|value| (value / largest).powi(2)).sum::<f64>().sqrt() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_column_that_depends_on_others_is_named() {
        let groups = Design::groups(&[3, 4]).unwrap();
        let ones = Array2::ones((7, 1));
        let error = groups.with_covariates(ones.view(), &["constant".into()]).unwrap_err();
        assert!(matches!(error, ShapeError::Rank { column } if column == "constant"));
        let sex = Array2::from_shape_fn((7, 1), |(i, _)| f64::from(i < 3));
        assert!(groups.with_covariates(sex.view(), &["sex".into()]).is_err());
        let age = Array2::from_shape_fn((7, 1), |(i, _)| 1e-200 * (i * i) as f64);
        assert_eq!(groups.with_covariates(age.view(), &["age".into()]).unwrap().names()[2], "age");
    }

    #[test]
    fn groups_are_found_again() {
        assert_eq!(Design::groups(&[2, 3]).unwrap().two_groups().unwrap(), [0, 0, 1, 1, 1]);
        assert!(Design::groups(&[2, 2, 2]).unwrap().two_groups().is_none());
        assert!(matches!(Design::groups(&[2, 0]).unwrap_err(), ShapeError::EmptyGroup { group: 2 }));
        assert!(Design::groups(&[1, 1]).is_err());
    }
}
