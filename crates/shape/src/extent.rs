//! Validates the coefficients of a surface before anything is computed from them.

use ndarray::{Axis, Slice};
use spharm_harmonics::Coefficients;

use crate::error::ShapeError;
use crate::singular_values::singular_values;

/// Singular values below this fraction of the largest one are treated as rounding errors.
const NEGLIGIBLE: f64 = 1e-12;
/// Lower limit for the largest absolute coefficient. The upper limit is the reciprocal of this value. Within these
/// limits, areas, volumes and their squares neither overflow nor underflow.
const LEAST: f64 = 1e-50;

/// Dimension of the space that a model spans.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// Three dimensions, as for any surface that encloses a volume.
    Solid,
    /// Two dimensions: the surface lies in a plane and has volume 0.
    Flat,
}

/// Checks that coefficients describe a surface, and returns whether the surface is flat.
///
/// # Errors
///
/// - [`ShapeError::NotASurface`] if the number of channels isn't 3.
/// - [`ShapeError::NotFinite`] if a coefficient is NaN or infinite.
/// - [`ShapeError::NoExtent`] if the model is a point (like every model of degree 0) or lies on a line.
/// - [`ShapeError::Range`] if the largest coefficient of degree 1 or above isn't between 1e-50 and 1e50.
pub fn extent(coefficients: &Coefficients) -> Result<Extent, ShapeError> {
    surface(coefficients)?;
    let shape = coefficients.values().slice_axis(Axis(0), Slice::from(1..));
    let largest = shape.iter().fold(0.0_f64, |largest, value| largest.max(value.abs()));
    let values = singular_values(shape);
    let rank = values.iter().filter(|value| **value > NEGLIGIBLE * values[0]).count();
    match rank {
        0 => Err(ShapeError::NoExtent { found: "a point", rank }),
        1 => Err(ShapeError::NoExtent { found: "a line", rank }),
        _ if !(LEAST..=1.0 / LEAST).contains(&largest) => Err(ShapeError::Range { largest }),
        2 => Ok(Extent::Flat),
        _ => Ok(Extent::Solid),
    }
}

/// Checks that coefficients have three columns and are finite.
///
/// # Errors
///
/// [`ShapeError::NotASurface`] if the number of columns isn't 3; [`ShapeError::NotFinite`] if a coefficient is NaN or
/// infinite.
pub(crate) fn surface(coefficients: &Coefficients) -> Result<(), ShapeError> {
    match coefficients.channels() {
        3 => finite(coefficients),
        channels => Err(ShapeError::NotASurface { channels }),
    }
}

/// Checks that no coefficient is NaN or infinite.
///
/// # Errors
///
/// [`ShapeError::NotFinite`] for the first coefficient that is NaN or infinite.
pub fn finite(coefficients: &Coefficients) -> Result<(), ShapeError> {
    let mut values = coefficients.values().indexed_iter();
    match values.find(|(_, value)| !value.is_finite()) {
        Some(((row, channel), &value)) => Err(ShapeError::NotFinite { row, channel, value }),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;

    fn of(values: Array2<f64>) -> Result<Extent, ShapeError> {
        extent(&Coefficients::new(values).unwrap())
    }

    #[test]
    fn what_is_no_surface_is_refused() {
        let mut values = Array2::zeros((9, 3));
        values[[0, 0]] = 3.0;
        assert!(matches!(of(values.clone()), Err(ShapeError::NoExtent { rank: 0, .. })));
        assert!(matches!(of(Array2::ones((1, 3))), Err(ShapeError::NoExtent { rank: 0, .. })));
        (values[[1, 0]], values[[5, 0]]) = (1.0, 2.0);
        assert!(matches!(of(values.clone()), Err(ShapeError::NoExtent { rank: 1, .. })));
        values[[3, 1]] = 1e-3;
        assert_eq!(of(values.clone()).unwrap(), Extent::Flat);
        values[[2, 2]] = 1e-3;
        assert_eq!(of(values.clone()).unwrap(), Extent::Solid);
        for unit in [1e200, 1e-100] {
            let found = of(&values * unit);
            assert!(matches!(found, Err(ShapeError::Range { largest }) if largest == 2.0 * unit), "{found:?}");
        }
        values[[8, 1]] = f64::NAN;
        assert!(matches!(of(values), Err(ShapeError::NotFinite { row: 8, channel: 1, .. })));
        assert!(matches!(of(Array2::zeros((4, 2))), Err(ShapeError::NotASurface { channels: 2 })));
    }
}
