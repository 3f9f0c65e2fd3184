//! Preconditioners: approximate inverses of the normal matrix, symmetric and positive definite.

use ndarray::Array2;
use spharm_harmonics::index::order_count;
#[cfg(feature = "dense")]
use spharm_transform::InverseDensity;

use super::columns::scale_rows;
use crate::SolverError;
#[cfg(feature = "dense")]
use crate::cholesky::CholeskyFactor;

/// An approximate inverse M of N = A^T W A + P.
pub trait Preconditioner: Sync {
    /// Returns the preconditioner's name in reports.
    fn name(&self) -> &'static str;

    /// Returns a bound on the preconditioner's condition number; `None` if unknown.
    fn condition(&self) -> Option<f64> {
        None
    }

    /// Returns whether processing a few columns at a time costs no more than processing all at once.
    fn takes_columns_alone(&self) -> bool {
        false
    }

    /// Computes `M r` for r (K, c).
    ///
    /// # Errors
    ///
    /// If the preconditioner's data can't be read.
    fn apply(&self, r: &Array2<f64>) -> Result<Array2<f64>, SolverError>;
}

impl<P: Preconditioner + ?Sized> Preconditioner for &P {
    fn name(&self) -> &'static str {
        (**self).name()
    }

    fn condition(&self) -> Option<f64> {
        (**self).condition()
    }

    fn takes_columns_alone(&self) -> bool {
        (**self).takes_columns_alone()
    }

    fn apply(&self, r: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        (**self).apply(r)
    }
}

/// The inverse of the diagonal `sum w / 4 pi + P`, which the normal matrix N would have on an even sampling of the
/// sphere. Without a penalty this is a multiple of the identity, which doesn't change the iterates.
#[derive(Debug)]
pub struct Diagonal {
    inverse: Vec<f64>,
}

impl Diagonal {
    /// Computes the inverse of the diagonal from `weight`, the sum of the weights, and `penalty`, the diagonal (K) of
    /// P.
    pub fn new(max_degree: usize, weight: f64, penalty: Option<&[f64]>) -> Self {
        let even = weight / (4.0 * std::f64::consts::PI);
        let inverse = match penalty {
            None => (0..=max_degree).flat_map(|l| std::iter::repeat_n(1.0 / even, order_count(l))).collect(),
            Some(penalty) => penalty.iter().map(|p| 1.0 / (even + p)).collect(),
        };
        Self { inverse }
    }
}

impl Preconditioner for Diagonal {
    /// Returns `none`: without a penalty this preconditioner has no effect, and with a penalty it only scales by the
    /// diagonal.
    fn name(&self) -> &'static str {
        "none"
    }

    fn condition(&self) -> Option<f64> {
        let ends = self.inverse.iter().fold([f64::INFINITY, 0.0f64], |[low, high], &v| [low.min(v), high.max(v)]);
        Some(ends[1] / ends[0])
    }

    fn takes_columns_alone(&self) -> bool {
        true
    }

    fn apply(&self, r: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        let mut z = r.clone();
        scale_rows(&mut z, &self.inverse);
        Ok(z)
    }
}

/// The inverse of the sampling density, computed from the moments of the sampling: see [`InverseDensity`].
#[cfg(feature = "dense")]
pub(crate) struct Density<'a>(pub(crate) &'a InverseDensity);

#[cfg(feature = "dense")]
impl Preconditioner for Density<'_> {
    fn name(&self) -> &'static str {
        "density"
    }

    fn condition(&self) -> Option<f64> {
        Some(self.0.condition())
    }

    fn takes_columns_alone(&self) -> bool {
        true
    }

    fn apply(&self, r: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        Ok(self.0.apply(r.view())?)
    }
}

/// A Cholesky factor of N that isn't accurate enough for refinement, but serves as a preconditioner.
#[cfg(feature = "dense")]
pub(crate) struct ByFactor<'a>(pub(crate) &'a dyn CholeskyFactor);

#[cfg(feature = "dense")]
impl Preconditioner for ByFactor<'_> {
    fn name(&self) -> &'static str {
        "factor"
    }

    fn apply(&self, r: &Array2<f64>) -> Result<Array2<f64>, SolverError> {
        let mut z = r.clone();
        self.0.solve(&mut z)?;
        Ok(z)
    }
}
