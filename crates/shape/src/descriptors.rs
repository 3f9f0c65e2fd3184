//! Computes rotation-invariant descriptors of a model: the power and the singular values of each degree.
//!
//! Let A_l be the 2l + 1 rows of the coefficients of degree l. Then:
//!
//! ```text
//! power P_l = |A_l|^2 / (4 pi),    sigma_l,1 >= sigma_l,2 >= ...: singular values of A_l / sqrt(4 pi)
//! ```
//!
//! A rotation of the directions multiplies A_l by an orthogonal matrix from the left, and a rotation of the surface
//! multiplies it from the right. Neither changes the power or the singular values. A reflection doesn't change them
//! either, so the descriptors can't detect it. The power is described by M. Kazhdan, T. Funkhouser and S. Rusinkiewicz,
//! "Rotation invariant spherical harmonic representation of 3D shape descriptors", SGP 2003. The singular values also
//! describe how the power of a degree is distributed over the axes. The descriptors depend on the parameterisation. For
//! comparisons, map surfaces to the sphere without area distortion (setting `area` 0), because other maps also depend
//! on the triangles of the input mesh. Degree 0, which is the position, is excluded.
//!
//! In Python, `Model.spectrum` has the value 4 pi P_l for each degree l from 0 to L: the sum of the squares of the
//! degree's coefficients.
//!
//! The distance between the singular values of two surfaces never exceeds the root mean square distance between the
//! surfaces' points at equal directions. This bound holds for any rotation, reflection and translation of the surfaces,
//! and for any rotation of their spheres. It follows from L. Mirsky, Q. J. Math. 11 (1960): `sum (sigma_i(A) -
//! sigma_i(B))^2 <= |A - B|^2`, for each degree. Retrieval by the distance between singular values is therefore exact;
//! see [`retrieval`](crate::retrieval). The distance between singular values doesn't bound the distance between the
//! surfaces themselves: two models of the same surface have different singular values if the surface was mapped to the
//! sphere in two ways.
//!
//! Cost: about 100 flops per coefficient.

use ndarray::{Axis, Slice};
use spharm_harmonics::Coefficients;
use spharm_harmonics::index::{first_column, order_count};
use std::f64::consts::PI;

use crate::error::ShapeError;
use crate::extent::finite;
use crate::singular_values::singular_values;

/// Descriptors of one model, in the model's unit.
#[derive(Debug, Clone, PartialEq)]
pub struct Descriptors {
    /// Powers `P_l` of the degrees 1 to L: the mean square of each degree's contribution over the sphere.
    pub power: Vec<f64>,
    /// Singular values (L, c) of the degrees 1 to L, row-major, with the largest value of each degree first; the
    /// squares of a degree's values sum to its power.
    pub singular_values: Vec<f64>,
    /// Number of channels, c.
    pub channels: usize,
}

impl Descriptors {
    /// Returns the highest degree, L.
    #[must_use]
    pub fn max_degree(&self) -> usize {
        self.power.len()
    }

    /// Returns the root mean square distance of the model from its mean position.
    #[must_use]
    pub fn size(&self) -> f64 {
        self.power.iter().sum::<f64>().sqrt()
    }

    /// Returns the descriptors of the degrees up to `degree`, or of all degrees if `degree` is above L.
    #[must_use]
    pub fn up_to(&self, degree: usize) -> Self {
        let degree = degree.min(self.max_degree());
        Self {
            power: self.power[..degree].to_vec(),
            singular_values: self.singular_values[..degree * self.channels].to_vec(),
            channels: self.channels,
        }
    }

    /// Returns the descriptors of the model scaled to size 1; the descriptors of a model of size 0 stay 0.
    #[must_use]
    pub fn unit_size(&self) -> Self {
        let size = self.size();
        let size = if size > 0.0 { size } else { 1.0 };
        Self {
            power: self.power.iter().map(|power| power / (size * size)).collect(),
            singular_values: self.singular_values.iter().map(|value| value / size).collect(),
            channels: self.channels,
        }
    }
}

/// Computes the descriptors of a model from its coefficients (K, c), with any number of channels.
///
/// # Errors
///
/// [`ShapeError::NotFinite`] if a coefficient is NaN or infinite.
pub fn descriptors(coefficients: &Coefficients) -> Result<Descriptors, ShapeError> {
    finite(coefficients)?;
    let (max_degree, channels) = (coefficients.max_degree(), coefficients.channels());
    let mut found = Descriptors { power: Vec::with_capacity(max_degree), singular_values: Vec::new(), channels };
    for l in 1..=max_degree {
        let rows = Slice::from(first_column(l)..first_column(l) + order_count(l));
        let rows = coefficients.values().slice_axis(Axis(0), rows);
        found.power.push(rows.iter().map(|value| value * value).sum::<f64>() / (4.0 * PI));
        let values = singular_values(rows);
        found.singular_values.extend(values.into_iter().map(|value| value / (4.0 * PI).sqrt()));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::product::product;
    use ndarray::Array2;
    use spharm_harmonics::index::basis_size;
    use spharm_harmonics::{Directions, gauss_legendre, synthesis};
    use spharm_surface::geometry::Vec3;

    fn sample(max_degree: usize, seed: f64) -> Coefficients {
        let value = |(k, c): (usize, usize)| ((k * 7 + c * 3) as f64 * 0.37 + seed).sin() / (1.0 + k as f64);
        Coefficients::new(Array2::from_shape_fn((basis_size(max_degree), 3), value)).unwrap()
    }

    /// Returns the coefficients of `f(R^T u)` by quadrature of the function at rotated directions, with the surface
    /// rotated by Q and translated.
    fn turned(coefficients: &Coefficients, r: &[Vec3; 3], q: &[Vec3; 3]) -> Coefficients {
        let max_degree = coefficients.max_degree();
        let n = max_degree + 1;
        let rings = gauss_legendre(n);
        let mut grid = Vec::new();
        for j in 0..n {
            grid.extend((0..2 * n).map(|k| {
                let (sin, cos) = (PI * k as f64 / n as f64).sin_cos();
                [rings.sines[j] * cos, rings.sines[j] * sin, rings.cosines[j]]
            }));
        }
        let back: Vec<Vec3> =
            grid.iter().map(|u| std::array::from_fn(|c| (0..3).map(|k| r[k][c] * u[k]).sum())).collect();
        let samples = synthesis(&Directions::from_vertices(&back).unwrap(), coefficients.values().view()).unwrap();
        let basis =
            synthesis(&Directions::from_vertices(&grid).unwrap(), Array2::eye(basis_size(max_degree)).view()).unwrap();
        let mut weighted = samples;
        for (mut row, w) in weighted.rows_mut().into_iter().zip(rings.weights.iter().flat_map(|w| vec![w; 2 * n])) {
            row *= w * PI / n as f64;
        }
        let turn = Array2::from_shape_fn((3, 3), |(i, j)| q[j][i]);
        let mut values = product(product(basis.t(), weighted.view()).view(), turn.view());
        values[[0, 1]] += 40.0;
        Coefficients::new(values).unwrap()
    }

    #[test]
    fn rotations_in_both_spaces_and_reflections_change_nothing() {
        let r = [[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]];
        let mirror = [[0.0, 0.6, 0.8], [0.0, 0.8, -0.6], [1.0, 0.0, 0.0]];
        let original = sample(15, 0.0);
        let before = descriptors(&original).unwrap();
        let after = descriptors(&turned(&original, &r, &mirror)).unwrap();
        let largest = before.singular_values[0];
        for (a, b) in before.singular_values.iter().zip(&after.singular_values) {
            assert!((a - b).abs() < 1e-13 * largest, "{a:e} {b:e}");
        }
        for (a, b) in before.power.iter().zip(&after.power) {
            assert!((a - b).abs() < 1e-13 * largest * largest, "{a:e} {b:e}");
        }
        println!(
            "invariance: {:.1e}",
            before.singular_values.iter().zip(&after.singular_values).fold(0.0f64, |m, (a, b)| m.max((a - b).abs()))
                / largest
        );
    }

    #[test]
    fn powers_are_sums_of_squares_and_add_up_to_the_mean_square() {
        let model = sample(9, 1.0);
        let found = descriptors(&model).unwrap();
        for (power, values) in found.power.iter().zip(found.singular_values.chunks(3)) {
            assert!((power - values.iter().map(|value| value * value).sum::<f64>()).abs() < 1e-15);
        }
        let square: f64 = model.values().iter().skip(3).map(|value| value * value).sum();
        assert!((found.size() - (square / (4.0 * PI)).sqrt()).abs() < 1e-14);
        assert!((found.unit_size().size() - 1.0).abs() < 1e-15);
        assert_eq!((found.max_degree(), found.up_to(4).power.len(), found.up_to(4).singular_values.len()), (9, 4, 12));
        let point = descriptors(&Coefficients::new(Array2::ones((1, 3))).unwrap()).unwrap();
        assert_eq!((point.max_degree(), point.unit_size().size()), (0, 0.0));
        let nan = Coefficients::new(Array2::from_elem((4, 1), f64::NAN)).unwrap();
        assert!(matches!(descriptors(&nan), Err(ShapeError::NotFinite { .. })));
    }
}
