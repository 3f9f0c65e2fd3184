//! Computes the error of truncating a model to a lower degree, by Parseval's identity.
//!
//! ```text
//! tail(d) = sqrt(sum over l > d of |A_l|^2 / (4 pi))
//! ```
//!
//! is the root mean square distance over the sphere between the model and its truncation to degree d. A_l are the
//! coefficients of degree l. The formula is exact, and no surface is evaluated. Distances from points to the nearest
//! points of the other surface are smaller.

use ndarray::{Axis, Slice};
use spharm_harmonics::Coefficients;
use spharm_harmonics::index::{first_column, order_count};
use std::f64::consts::PI;

use crate::error::ShapeError;
use crate::extent::finite;

/// Returns the root mean square distance between a model with coefficients (K, c) and its truncation to each degree
/// from 0 to L, in the model's unit. The last of the L + 1 values is 0.
///
/// # Errors
///
/// [`ShapeError::NotFinite`] if a coefficient is NaN or infinite.
pub fn tails(coefficients: &Coefficients) -> Result<Vec<f64>, ShapeError> {
    finite(coefficients)?;
    let max_degree = coefficients.max_degree();
    let mut tails = vec![0.0; max_degree + 1];
    let mut sum = 0.0;
    // The highest degrees are summed first, because their terms are the smallest.
    for l in (1..=max_degree).rev() {
        let rows = Slice::from(first_column(l)..first_column(l) + order_count(l));
        let rows = coefficients.values().slice_axis(Axis(0), rows);
        sum += rows.iter().map(|value| value * value).sum::<f64>();
        tails[l - 1] = (sum / (4.0 * PI)).sqrt();
    }
    Ok(tails)
}

/// Returns the smallest degree whose truncation error is at most `tolerance`, in the model's unit, and the error at
/// that degree.
///
/// # Errors
///
/// [`ShapeError::NotFinite`] if a coefficient is NaN or infinite; [`ShapeError::Setting`] if the tolerance is negative
/// or NaN.
pub fn degree_within(coefficients: &Coefficients, tolerance: f64) -> Result<(usize, f64), ShapeError> {
    if tolerance.is_nan() || tolerance < 0.0 {
        let (name, expected) = ("the tolerance", "it must be 0 or more");
        return Err(ShapeError::Setting { name, expected, found: tolerance.to_string() });
    }
    let tails = tails(coefficients)?;
    let degree = tails.iter().position(|tail| *tail <= tolerance).unwrap_or(tails.len() - 1);
    Ok((degree, tails[degree]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use ndarray::Array2;
    use spharm_harmonics::index::basis_size;
    use spharm_harmonics::{Directions, gauss_legendre, synthesis};

    fn sample() -> Coefficients {
        let value = |(k, c): (usize, usize)| ((k * 7 + c * 3) as f64 * 0.37).sin() / (1.0 + k as f64);
        Coefficients::new(Array2::from_shape_fn((basis_size(9), 3), value)).unwrap()
    }

    #[test]
    fn tails_are_distances_by_quadrature() {
        let model = sample();
        let (n, rings) = (10, gauss_legendre(10));
        let mut grid = Vec::new();
        for j in 0..n {
            grid.extend((0..2 * n).map(|k| {
                let (sin, cos) = (PI * k as f64 / n as f64).sin_cos();
                [rings.sines[j] * cos, rings.sines[j] * sin, rings.cosines[j]]
            }));
        }
        let grid = Directions::from_vertices(&grid).unwrap();
        let whole = synthesis(&grid, model.values().view()).unwrap();
        for (degree, tail) in tails(&model).unwrap().into_iter().enumerate() {
            let part = synthesis(&grid, model.up_to(degree)).unwrap();
            let squares = (&whole - &part).mapv(|d| d * d).sum_axis(Axis(1));
            let rings = squares.as_slice().unwrap().chunks(2 * n).zip(&rings.weights);
            let mean = rings.map(|(ring, w)| w / (4 * n) as f64 * ring.iter().sum::<f64>()).sum::<f64>();
            assert!((mean.sqrt() - tail).abs() < 1e-14, "{degree}: {tail}");
        }
    }

    #[test]
    fn the_degree_is_the_smallest_within_the_tolerance() {
        let model = sample();
        let tails = tails(&model).unwrap();
        assert_eq!((tails.len(), tails[9]), (10, 0.0));
        for (degree, tail) in tails.iter().enumerate() {
            assert_eq!(degree_within(&model, *tail).unwrap(), (degree, *tail));
        }
        assert_eq!(degree_within(&model, f64::INFINITY).unwrap().0, 0);
        assert_eq!(degree_within(&model, 0.0).unwrap(), (9, 0.0));
        for bad in [-1e-9, f64::NAN] {
            assert!(matches!(degree_within(&model, bad), Err(ShapeError::Setting { .. })));
        }
    }
}
