//! The changes of a study that leave its errors as likely as before: exchanges of subjects, flips of signs, or both.
//!
//! A. M. Winkler, G. R. Ridgway, M. A. Webster, S. M. Smith and T. E. Nichols, "Permutation inference for the general
//! linear model", NeuroImage 92 (2014). Exchanges need a constant in the reduced model: a mean that isn't accounted for
//! stays in the residuals, and no exchange changes their sum, so that tests of means would compare a statistic with
//! itself. Signs are flipped in these cases.

use ndarray::ArrayView2;

use super::projection::Projection;

/// The changes that relabelled studies differ by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Resampling {
    /// Exchanges of subjects. Assumes exchangeable errors.
    Permutations,
    /// Flips of the signs of residuals. Assumes errors that are independent and symmetric about zero.
    SignFlips,
    /// Exchanges and flips. Assumes errors that are exchangeable and symmetric about zero.
    Both,
}

impl Resampling {
    /// Returns the changes by name.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Permutations => "permutations",
            Self::SignFlips => "sign flips",
            Self::Both => "permutations and sign flips",
        }
    }

    /// Returns the assumption that the p values rest on.
    #[must_use]
    pub fn assumption(self) -> &'static str {
        match self {
            Self::Permutations => "exchangeable errors",
            Self::SignFlips => "independent errors, symmetric about zero",
            Self::Both => "exchangeable errors, symmetric about zero",
        }
    }

    /// Chooses the changes for a contrast: exchanges if the reduced model has a constant, else flips; both if flips
    /// alone are too few, as the estimate rests on few of the subjects.
    pub(crate) fn choose(model: &Projection) -> Self {
        if model.keeps_constant() {
            return Self::Permutations;
        }
        let support = support(model.effect.view());
        if support < MIN_SUPPORT && support < 0.9 * model.effect.nrows() as f64 { Self::Both } else { Self::SignFlips }
    }
}

/// Estimates that rest on fewer subjects have fewer than 1,000 statistics by flips of signs alone; the mean of 5 of 24
/// subjects has 16, and a family-wise error of 0.01 in place of 0.05.
const MIN_SUPPORT: f64 = 11.0;

/// The number of subjects that an estimate rests on: `(sum h)^2 / sum h^2` of their leverages h, n for a mean of n.
fn support(effect: ArrayView2<'_, f64>) -> f64 {
    let leverage = effect.rows().into_iter().map(|row| row.iter().map(|value| value * value).sum::<f64>());
    let (sum, squares) = leverage.fold((0.0, 0.0), |(sum, squares), h| (sum + h, squares + h * h));
    sum * sum / squares
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, array};

    use super::*;
    use crate::stats::{Contrast, Design};

    fn of(design: &Design, weights: Array2<f64>) -> Resampling {
        Resampling::choose(&Projection::new(design, &Contrast { weights }).unwrap())
    }

    #[test]
    fn means_are_tested_by_signs_and_differences_by_exchanges() {
        use Resampling::{Both, Permutations, SignFlips};
        let groups = Design::groups(&[12, 12]).unwrap();
        assert_eq!(of(&groups, array![[1.0, -1.0]]), Permutations);
        assert_eq!(of(&groups, array![[1.0, 0.0]]), SignFlips);
        assert_eq!(of(&groups, array![[0.5, 0.5]]), SignFlips);
        assert_eq!(of(&groups, array![[1.0, 0.0], [0.0, 1.0]]), SignFlips);
        let age = Array2::from_shape_fn((9, 1), |(i, _)| (i * i) as f64);
        let slope = Design::groups(&[9]).unwrap().with_covariates(age.view(), &[]).unwrap();
        assert_eq!(of(&slope, array![[1.0, 0.0]]), SignFlips);
        assert_eq!(of(&slope, array![[0.0, 1.0]]), Permutations);
        // The mean of a small group beside a large one.
        assert_eq!(of(&Design::groups(&[5, 19]).unwrap(), array![[1.0, 0.0]]), Both);
    }
}
