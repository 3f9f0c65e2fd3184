//! Splits a design into the part that a contrast tests and the rest.
//!
//! X is the design, Y are the values, B the coefficients of the model, and C is the contrast. With `X = Q R`, the
//! estimate of `C B` is `C R^-1 Q^T Y = U^T Q^T Y`, where U solves `R^T U = C^T`. Therefore the columns of `W = Q U`
//! span the contrast's contribution to the model. Their orthogonal complement in the span of X is the reduced model of
//! the null hypothesis. This is the partition of G. M. Ridgway, computed by orthogonal bases instead of normal
//! equations (A. M. Winkler et al., "Permutation inference for the general linear model", NeuroImage 92 (2014),
//! appendix A).

use ndarray::{Array2, ArrayView2, concatenate, s};

use super::design::{Contrast, Design, orthonormalise};
use crate::ShapeError;
use crate::product::product;

/// Orthonormal bases of the tested part of a design and of the rest, the reduced model; and the degrees of freedom of
/// the errors.
#[derive(Debug, Clone)]
pub(crate) struct Projection {
    /// Basis (n, q) of the tested part.
    pub(crate) effect: Array2<f64>,
    /// Basis (n, p - q) of the reduced model.
    pub(crate) nuisance: Array2<f64>,
    /// Ratio of the contrast's estimate to the component of the values along `effect`, used if the contrast has one row
    /// (q = 1). The ratio is the norm of the tested part before its normalisation.
    pub(crate) scale: f64,
    /// Degrees of freedom of the errors, n - p.
    pub(crate) freedom: usize,
    /// Combinations `X C^T` (n, q) of the design's columns with the contrast's weights.
    pub(crate) tested: Array2<f64>,
}

impl Projection {
    pub(crate) fn new(design: &Design, contrast: &Contrast) -> Result<Self, ShapeError> {
        let (n, p) = design.matrix().dim();
        let (q, u) = contrast_in_basis(design, contrast);
        let w = product(q.view(), u.view());
        let scale = w.iter().map(|value| value * value).sum::<f64>().sqrt();
        let (effect, dependent) = orthonormalise(w.view());
        if let Some(row) = dependent {
            let found = format!("row {}, which is zero or a combination of earlier rows", row + 1);
            return Err(ShapeError::Contrast { expected: "independent rows", found });
        }
        let both = concatenate![ndarray::Axis(1), effect, q];
        let (both, _) = orthonormalise(both.view());
        let nuisance = both.slice(s![.., effect.ncols()..p]).to_owned();
        let tested = product(design.matrix(), contrast.weights.t());
        Ok(Self { effect, nuisance, scale, freedom: n - p, tested })
    }

    /// Returns the residuals `(I - Q_Z Q_Z^T) Y` (n, V d) of the reduced model.
    pub(crate) fn residual(&self, values: ArrayView2<'_, f64>) -> Array2<f64> {
        without(self.nuisance.view(), values.to_owned())
    }

    /// Returns whether the reduced model's span contains the constant vector, so that residuals have zero mean.
    pub(crate) fn keeps_constant(&self) -> bool {
        let n = self.nuisance.nrows() as f64;
        let along: f64 = self.nuisance.columns().into_iter().map(|column| column.sum().powi(2)).sum();
        along >= n * (1.0 - 1e-9)
    }

    /// Returns whether a relabelling leaves the statistics unchanged, because it preserves the spans of `effect` and
    /// `nuisance`.
    pub(crate) fn unchanged_by(&self, relabelling: &[(u32, f64)]) -> bool {
        let keeps = |basis: &Array2<f64>| {
            if basis.ncols() == 0 {
                return true;
            }
            let mut moved = Array2::zeros(basis.raw_dim());
            for (mut row, (from, sign)) in moved.rows_mut().into_iter().zip(relabelling) {
                row.assign(&basis.row(*from as usize));
                row *= *sign;
            }
            let along = product(basis.t(), moved.view());
            along.iter().map(|value| value * value).sum::<f64>() >= basis.ncols() as f64 - 1e-9
        };
        keeps(&self.effect) && keeps(&self.nuisance)
    }
}

/// Returns an orthonormal basis Q (n, p) of a design's columns, and the matrix U (p, q) for which `C B = U^T Q^T Y`,
/// with the least-squares coefficients B.
pub(crate) fn contrast_in_basis(design: &Design, contrast: &Contrast) -> (Array2<f64>, Array2<f64>) {
    let x = design.matrix();
    let (q, _) = orthonormalise(x);
    let r = product(q.t(), x);
    // With X = Q R, the equation R^T U = C^T is solved by forward substitution.
    let mut u = contrast.weights.t().to_owned();
    for row in 0..x.ncols() {
        for above in 0..row {
            let share = r[[above, row]];
            let known = u.row(above).to_owned();
            u.row_mut(row).scaled_add(-share, &known);
        }
        let pivot = r[[row, row]];
        u.row_mut(row).mapv_inplace(|value| value / pivot);
    }
    (q, u)
}

/// Returns values minus their projection onto the columns of an orthonormal basis.
pub(crate) fn without(basis: ArrayView2<'_, f64>, mut values: Array2<f64>) -> Array2<f64> {
    if basis.ncols() > 0 {
        let along = product(basis.t(), values.view());
        values -= &product(basis, along.view());
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_estimate_is_that_of_the_normal_equations() {
        let age = Array2::from_shape_fn((9, 1), |(i, _)| ((3 * i * i) as f64).sin());
        let design = Design::groups(&[4, 5]).unwrap().with_covariates(age.view(), &[]).unwrap();
        let contrast = Contrast::row(&[1.0, -1.0, 0.5]);
        let found = Projection::new(&design, &contrast).unwrap();
        // The model explains the values exactly, so the estimate is the contrast of the coefficients.
        let coefficients = ndarray::array![[2.0], [-1.0], [4.0]];
        let y = product(design.matrix(), coefficients.view());
        let estimate = found.scale * product(found.effect.t(), y.view())[[0, 0]];
        assert!((estimate - 5.0).abs() < 1e-12, "{estimate}");
        assert_eq!((found.nuisance.ncols(), found.freedom), (2, 6));
        let gram = product(found.nuisance.t(), found.effect.view());
        assert!(gram.iter().all(|value| value.abs() < 1e-14));
    }

    #[test]
    fn a_constant_in_the_reduced_model_is_found() {
        let ages = [21.0, 34.0, 28.0, 47.0, 39.0, 30.0];
        let age = Array2::from_shape_fn((6, 1), |(i, _)| ages[i]);
        let keeps = |design: &Design, weights: &[f64]| {
            Projection::new(design, &Contrast::row(weights)).unwrap().keeps_constant()
        };
        let groups = Design::groups(&[3, 3]).unwrap();
        assert!(keeps(&groups, &[1.0, -1.0]) && !keeps(&groups, &[1.0, 0.0]) && !keeps(&groups, &[0.5, 0.5]));
        let centred = Design::groups(&[6]).unwrap().with_covariates(age.view(), &[]).unwrap();
        assert!(keeps(&centred, &[0.0, 1.0]) && !keeps(&centred, &[1.0, 0.0]));
        let raw = concatenate![ndarray::Axis(1), Array2::ones((6, 1)), age];
        let raw = Design::new(raw, Vec::new()).unwrap();
        assert!(keeps(&raw, &[0.0, 1.0]) && !keeps(&raw, &[1.0, 0.0]));
    }

    #[test]
    fn dependent_rows_are_refused() {
        let design = Design::groups(&[4, 5]).unwrap();
        let twice = Contrast { weights: ndarray::array![[1.0, -1.0], [-2.0, 2.0]] };
        assert!(Projection::new(&design, &twice).is_err());
        assert!(Projection::new(&design, &Contrast::row(&[0.0, 0.0])).is_err());
    }
}
