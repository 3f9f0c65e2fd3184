//! Finds the frame of a surface's first-order ellipsoid.
//!
//! The method is described by C. Brechbuehler, G. Gerig and O. Kuebler, "Parametrization of closed surfaces for 3-D
//! shape description", Computer Vision and Image Understanding 61 (1995). The rows of degree 1 define a linear map from
//! directions to space, `F = U S V^T`, which maps the sphere to an ellipsoid. Rotating the parameters by `R = V^T` and
//! space by `Q = U^T` makes the map diagonal: x becomes the longest axis of the ellipsoid and z the shortest, both in
//! space and in the parameters. R and Q are rotations. If F includes a reflection, the third diagonal element is
//! negative.
//!
//! The frame is determined only up to a half turn about one of the axes, applied to both the parameters and space, and
//! it is undetermined if two of the singular values are equal. The half turn is chosen by the signs of the surface's
//! skewness along x and y, so that the frame rotates with the surface. The skewness along axis c is `int f_c^3 du`, the
//! integral over the sphere of the cube of the surface's coordinate f_c.

use ndarray::Array2;
use spharm_harmonics::{Coefficients, Directions, gauss_legendre, synthesis};
use spharm_monitor::Silent;

use crate::error::ShapeError;
use crate::extent::surface;
use crate::matrix3::{Matrix3, determinant, transposed};
use crate::rotation::Rotation;
use crate::transform::{Similarity, Transform};
use spharm_surface::kabsch::{Svd, svd};

/// Smallest ratio of neighbouring axes for which the frame is meaningful.
pub const LEAST_RATIO: f64 = 1.1;

/// Degree up to which the skewness is computed.
const SKEWNESS_DEGREE: usize = 8;

/// The frame of a surface's first-order ellipsoid.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EllipsoidFrame {
    /// Rotation R of the parameters into the frame.
    pub rotation: Rotation,
    /// Rotation Q of space into the frame.
    pub object: Rotation,
    /// Semi-axes in descending order, in the surface's unit. The last semi-axis is negative if the map includes a
    /// reflection.
    pub axes: [f64; 3],
}

impl EllipsoidFrame {
    /// Finds the frame of a surface. For a surface without coefficients of degree 1, the frame is the identity.
    ///
    /// # Errors
    ///
    /// [`ShapeError::NotASurface`] if the coefficients don't have three columns; [`ShapeError::NotFinite`] if a
    /// coefficient is NaN or infinite.
    pub fn of(coefficients: &Coefficients) -> Result<Self, ShapeError> {
        surface(coefficients)?;
        let (u, values, v) = proper(coefficients);
        let axes = values.map(|value| value * (3.0 / (4.0 * std::f64::consts::PI)).sqrt());
        let (rotation, object) = (Rotation::of_orthogonal(transposed(&v)), Rotation::of_orthogonal(transposed(&u)));
        let frame = Self { rotation, object, axes };
        let turned = frame.transform().apply(&low_degrees(coefficients)?, &Silent)?;
        let half_turn = half_turn(skewness(&turned)?);
        Ok(Self { rotation: half_turn * rotation, object: half_turn * object, axes })
    }

    /// Returns the transform of the surface into its frame; the surface is rotated about the origin, not centred.
    #[must_use]
    pub fn transform(&self) -> Transform {
        Transform { rotation: self.rotation, antipodal: false, similarity: Similarity::rotation(&self.object) }
    }

    /// Returns the smallest ratio of neighbouring axes, at least 1; below [`LEAST_RATIO`] the frame has little meaning.
    /// It is infinite if an axis is zero.
    #[must_use]
    pub fn ratio(&self) -> f64 {
        let [a, b, c] = self.axes.map(f64::abs);
        let ratio = |long: f64, short: f64| if long == 0.0 { 1.0 } else { long / short };
        ratio(a, b).min(ratio(b, c))
    }
}

/// Returns the singular value decomposition of the rows of degree 1: U, the singular values and V. U and V are
/// rotations, so the last singular value may be negative.
fn proper(coefficients: &Coefficients) -> (Matrix3, [f64; 3], Matrix3) {
    let values = coefficients.values();
    if coefficients.max_degree() == 0 {
        let identity = Rotation::IDENTITY.matrix();
        return (identity, [0.0; 3], identity);
    }
    proper_of(|row, c| values[[row, c]])
}

/// Returns the singular value decomposition of rows 1 to 3 of the coefficients: U, the singular values and V. U and V
/// are rotations. The function `values` returns the elements of these rows.
fn proper_of(values: impl Fn(usize, usize) -> f64) -> (Matrix3, [f64; 3], Matrix3) {
    // The harmonics x, y and z have the orders 1, -1 and 0.
    let map: Matrix3 = std::array::from_fn(|c| [3, 1, 2].map(|row| values(row, c)));
    let Svd { mut u, mut values, mut v } = svd(&map);
    for side in [&mut u, &mut v] {
        if determinant(side) < 0.0 {
            side.iter_mut().for_each(|row| row[2] = -row[2]);
            values[2] = -values[2];
        }
    }
    (u, values, v)
}

/// Returns the four rotations of the parameters that align the axes of the ellipsoids of two surfaces (K, 3), or no
/// rotations if a surface has degree 0.
pub(crate) fn common_axes(from: &[[f64; 3]], to: &[[f64; 3]]) -> Vec<Rotation> {
    if from.len() < 4 || to.len() < 4 {
        return Vec::new();
    }
    let [own, other] = [from, to].map(|rows| Rotation::of_orthogonal(proper_of(|row, c| rows[row][c]).2));
    half_turns().map(|half_turn| other * half_turn * own.inverse()).to_vec()
}

fn low_degrees(coefficients: &Coefficients) -> Result<Coefficients, ShapeError> {
    let mut values = coefficients.up_to(SKEWNESS_DEGREE).to_owned();
    values.row_mut(0).fill(0.0);
    Ok(Coefficients::new(values)?)
}

/// Returns the skewness `int f_c^3 du` of each of the three coordinates, computed exactly from the degrees up to
/// [`SKEWNESS_DEGREE`].
fn skewness(coefficients: &Coefficients) -> Result<[f64; 3], ShapeError> {
    // 13 rings and 26 azimuths integrate functions of degree 24 exactly.
    let (rings, around) = (3 * SKEWNESS_DEGREE / 2 + 1, 3 * SKEWNESS_DEGREE + 2);
    let rule = gauss_legendre(rings);
    let mut directions = Vec::with_capacity(rings * around);
    for (&z, &r) in rule.cosines.iter().zip(&rule.sines) {
        for j in 0..around {
            let (sin, cos) = (std::f64::consts::TAU * j as f64 / around as f64).sin_cos();
            directions.push([r * cos, r * sin, z]);
        }
    }
    let values: Array2<f64> = synthesis(&Directions::from_vertices(&directions)?, coefficients.values().view())?;
    let mut sums = [0.0; 3];
    for (at, row) in values.rows().into_iter().enumerate() {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += rule.weights[at / around] * value.powi(3);
        }
    }
    Ok(sums)
}

/// Returns the half turn about an axis, or the identity, that makes the skewness along x and y non-negative.
fn half_turn(skewness: [f64; 3]) -> Rotation {
    let sign = |v: f64| if v < 0.0 { -1.0 } else { 1.0 };
    let (x, y) = (sign(skewness[0]), sign(skewness[1]));
    Rotation::of_orthogonal([[x, 0.0, 0.0], [0.0, y, 0.0], [0.0, 0.0, x * y]])
}

/// Returns the identity and the half turns about x, y and z.
pub(crate) fn half_turns() -> [Rotation; 4] {
    [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)].map(|(x, y)| half_turn([x, y, 1.0]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::samples::{apart, blob, ellipsoid, posed, reflected, some_pose};

    #[test]
    fn an_ellipsoid_has_its_axes() {
        let frame = EllipsoidFrame::of(&posed(&ellipsoid([2.0, 5.0, 3.0]), &some_pose(1))).unwrap();
        for (found, expected) in frame.axes.iter().zip([5.0, 3.0, 2.0]) {
            assert!((found - expected).abs() < 1e-13, "{frame:?}");
        }
        assert!((frame.ratio() - 1.5).abs() < 1e-13);
    }

    #[test]
    fn the_frame_follows_the_surface() {
        for surface in [blob(12, 1), reflected(&blob(12, 4))] {
            let framed = |surface: &Coefficients| {
                let mut values = surface.values().clone();
                values.row_mut(0).fill(0.0);
                let centred = Coefficients::new(values).unwrap();
                posed(&centred, &EllipsoidFrame::of(&centred).unwrap().transform())
            };
            let expected = framed(&surface);
            for n in 0..8 {
                assert!(apart(&expected, &framed(&posed(&surface, &some_pose(n)))) < 1e-12);
            }
        }
    }

    #[test]
    fn surfaces_without_an_ellipsoid_have_a_frame_nevertheless() {
        let point = Coefficients::new(Array2::ones((1, 3))).unwrap();
        let frame = EllipsoidFrame::of(&point).unwrap();
        assert_eq!((frame.axes, frame.ratio()), ([0.0; 3], 1.0));
        assert!(EllipsoidFrame::of(&Coefficients::new(Array2::zeros((4, 2))).unwrap()).is_err());
    }
}
