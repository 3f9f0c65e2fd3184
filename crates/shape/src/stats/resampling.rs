//! Chooses the kind of relabelling that leaves the errors' distribution unchanged: permutations of subjects, sign
//! flips, or both.
//!
//! The choice follows A. M. Winkler, G. R. Ridgway, M. A. Webster, S. M. Smith and T. E. Nichols, "Permutation
//! inference for the general linear model", NeuroImage 92 (2014). Permutations need a constant in the reduced model.
//! Without a constant, the residuals include the mean. Permutations don't change the sum of the residuals, so a test of
//! the mean would compare a statistic with itself. Therefore signs are flipped instead.

use std::str::FromStr;

use ndarray::ArrayView2;

use super::blocks::Unit;
use super::projection::Projection;

/// Kind of relabelling.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Resampling {
    /// Permutations of subjects. Assumes exchangeable errors.
    Permutations,
    /// Sign flips of residuals. Assumes errors that are independent and symmetric about zero.
    SignFlips,
    /// Permutations and sign flips. Assumes errors that are exchangeable and symmetric about zero.
    Both,
}

impl Resampling {
    /// Returns the name of this kind of relabelling.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Permutations => "permutations",
            Self::SignFlips => "sign flips",
            Self::Both => "permutations and sign flips",
        }
    }

    /// Returns the assumption about the errors on which the p values rest.
    #[must_use]
    pub fn assumption(self) -> &'static str {
        match self {
            Self::Permutations => "exchangeable errors",
            Self::SignFlips => "independent errors, symmetric about zero",
            Self::Both => "exchangeable errors, symmetric about zero",
        }
    }

    /// Chooses the kind of relabelling for a contrast: permutations if the reduced model has a constant, otherwise sign
    /// flips. If the estimate depends on only a few of the units in `sets`, there are too few distinct sign flips, and
    /// both kinds are combined.
    pub(crate) fn choose(model: &Projection, sets: &[Vec<Unit>]) -> Self {
        if model.keeps_constant() {
            return Self::Permutations;
        }
        let units: Vec<&Unit> = sets.iter().flatten().collect();
        let support = support(model.effect.view(), &units);
        if support < MIN_SUPPORT && support < 0.9 * units.len() as f64 { Self::Both } else { Self::SignFlips }
    }
}

impl FromStr for Resampling {
    type Err = String;

    /// Parses an assumption about errors: `exchangeable`, `symmetric` or `both`.
    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "exchangeable" => Ok(Self::Permutations),
            "symmetric" => Ok(Self::SignFlips),
            "both" => Ok(Self::Both),
            _ => Err("expected exchangeable, symmetric or both".to_owned()),
        }
    }
}

/// Minimum effective number of units (subjects or whole blocks) on which an estimate must depend if signs alone are
/// flipped. With fewer units, sign flips give fewer than 1,000 distinct statistics. For example, the mean of 5 of 24
/// subjects has 16 distinct statistics, and the family-wise error is 0.01 instead of 0.05.
const MIN_SUPPORT: f64 = 11.0;

/// Returns the effective number of units on which an estimate depends, `(sum h)^2 / sum h^2` with the units' leverages
/// h. For a mean of n units of the same size, this number is n.
fn support(effect: ArrayView2<'_, f64>, units: &[&Unit]) -> f64 {
    let of_row = |i: &u32| effect.row(*i as usize).iter().map(|value| value * value).sum::<f64>();
    let leverage = units.iter().map(|unit| unit.iter().map(of_row).sum::<f64>());
    let (sum, squares) = leverage.fold((0.0, 0.0), |(sum, squares), h| (sum + h, squares + h * h));
    sum * sum / squares
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, array};

    use super::*;
    use crate::stats::blocks::{Blocks, Exchange, free};
    use crate::stats::{Contrast, Design};

    fn of(design: &Design, weights: Array2<f64>) -> Resampling {
        Resampling::choose(&Projection::new(design, &Contrast { weights }).unwrap(), &free(design.subjects()))
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
        // The contrast is the mean of a small group in a design with a large group.
        assert_eq!(of(&Design::groups(&[5, 19]).unwrap(), array![[1.0, 0.0]]), Both);
        // The 24 rows form 8 blocks. The contrast is the mean of 12 rows, which form 4 of the blocks.
        let model = Projection::new(&Design::groups(&[12, 12]).unwrap(), &Contrast { weights: array![[1.0, 0.0]] });
        let blocks = Blocks::new((0..24).map(|i| i / 3), Exchange::Whole);
        assert_eq!(Resampling::choose(&model.unwrap(), &blocks.sets()), Both);
    }
}
