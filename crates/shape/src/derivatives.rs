//! Computes the derivatives of functions on the sphere under rotations: the operators L_x, L_y, L_z. For a function f,
//! a direction u and the unit vector e_k along axis k:
//!
//! ```text
//! (L_k f)(u) = <e_k x u, grad f(u)>,    L f = u x grad f,    grad f = -u x L f
//! ```
//!
//! `L_k f` is the derivative of f under an infinitesimal rotation of the directions about axis k, so it maps each
//! degree to itself. Therefore the gradient of a sum of harmonics needs only a synthesis, and no derivatives with
//! respect to angles, which are singular at the poles. The operators act on the complex coefficients c of a degree as
//! follows (D. A. Varshalovich et al., Quantum Theory of Angular Momentum (1988), section 5.8; our L is `i` times their
//! operator), with `p = sqrt((l - m + 1)(l + m))` and `q = sqrt((l + m + 1)(l - m))`:
//!
//! ```text
//! (L_x c)_m = i/2 (p c_{m-1} + q c_{m+1}),   (L_y c)_m = 1/2 (p c_{m-1} - q c_{m+1}),   (L_z c)_m = i m c_m
//! ```
//!
//! The code applies these formulas to the real coefficients. The operators are antisymmetric, `[L_x, L_y] = -L_z` and
//! so on cyclically, and `L_x^2 + L_y^2 + L_z^2` is the Laplacian, `-l (l + 1)`. Cost: about 20 flops per coefficient.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::HarmonicsError;
use spharm_harmonics::index::{column, max_degree_of};

/// Returns the canonical coefficients (K, c) of each of `L_x f`, `L_y f` and `L_z f`, given the coefficients (K, c) of
/// f.
///
/// # Errors
///
/// [`NotABasisSize`](HarmonicsError::NotABasisSize) if K isn't `(L + 1)^2`.
pub fn rotational_derivatives(coefficients: ArrayView2<'_, f64>) -> Result<[Array2<f64>; 3], HarmonicsError> {
    let (rows, channels) = coefficients.dim();
    max_degree_of(rows).ok_or(HarmonicsError::NotABasisSize { rows })?;
    let mut out: [Array2<f64>; 3] = std::array::from_fn(|_| Array2::zeros((rows, channels)));
    for (c, channel) in coefficients.columns().into_iter().enumerate() {
        let values: Vec<[f64; 1]> = channel.iter().map(|value| [*value]).collect();
        for (out, found) in out.iter_mut().zip(generators(&values)) {
            out.column_mut(c).iter_mut().zip(found).for_each(|(out, [found])| *out = found);
        }
    }
    Ok(out)
}

/// Returns the coefficients of the derivatives `L_x f`, `L_y f` and `L_z f` of C functions f under rotations about the
/// axes. Each of the `(L + 1)^2` rows of `values` holds one coefficient of every function.
pub(crate) fn generators<const C: usize>(values: &[[f64; C]]) -> [Vec<[f64; C]>; 3] {
    let mut out = [(); 3].map(|()| vec![[0.0; C]; values.len()]);
    let [x, y, z] = &mut out;
    let mut l = 1;
    while (l + 1) * (l + 1) <= values.len() {
        let centre = column(l, 0);
        // Coefficients of orders above the degree are zero. For order 0, the cosine has a factor sqrt2, and the sine is
        // zero.
        let cosine = |m: usize| match m {
            0 => values[centre].map(|v| v * std::f64::consts::SQRT_2),
            m if m <= l => values[centre + m],
            _ => [0.0; C],
        };
        let sine = |m: usize| if m == 0 || m > l { [0.0; C] } else { values[centre - m] };
        let root = ((l * (l + 1)) as f64 / 2.0).sqrt();
        (x[centre], y[centre]) = (sine(1).map(|v| -root * v), cosine(1).map(|v| root * v));
        for m in 1..=l {
            let p = 0.5 * (((l - m + 1) * (l + m)) as f64).sqrt();
            let q = 0.5 * (((l + m + 1) * (l - m)) as f64).sqrt();
            let (below, above) = ([cosine(m - 1), sine(m - 1)], [cosine(m + 1), sine(m + 1)]);
            let (plus, minus) = (centre + m, centre - m);
            for c in 0..C {
                x[plus][c] = -(p * below[1][c] + q * above[1][c]);
                x[minus][c] = p * below[0][c] + q * above[0][c];
                y[plus][c] = q * above[0][c] - p * below[0][c];
                y[minus][c] = q * above[1][c] - p * below[1][c];
                z[plus][c] = m as f64 * values[minus][c];
                z[minus][c] = -(m as f64) * values[plus][c];
            }
        }
        l += 1;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::half_turn::Workspace;
    use crate::rotate::Rotator;
    use crate::rotation::Rotation;
    use spharm_harmonics::index::{basis_size, degree_order};
    use spharm_harmonics::{Directions, synthesis};
    use spharm_surface::geometry::{Vec3, cross};

    fn sample(max_degree: usize) -> Array2<f64> {
        Array2::from_shape_fn((basis_size(max_degree), 2), |(k, c)| ((k * 7 + c * 3) as f64 * 0.37).sin())
    }

    fn values(a: &Array2<f64>, at: &[Vec3]) -> Array2<f64> {
        synthesis(&Directions::from_vertices(at).unwrap(), a.view()).unwrap()
    }

    /// The derivatives equal central differences over directions rotated by `exp(t [axis])`, also at the poles.
    #[test]
    fn they_are_differences_of_turned_directions() {
        let a = sample(7);
        let derivatives = rotational_derivatives(a.view()).unwrap();
        let at = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.6, 0.0, 0.8], [-0.48, 0.64, 0.6], [0.0, -1.0, 0.0]];
        for axis in 0..3 {
            let e: Vec3 = std::array::from_fn(|k| f64::from(u8::from(k == axis)));
            let turned = |angle: f64| -> Vec<Vec3> {
                let turn = |u: &Vec3| {
                    let (v, along) = (cross(e, *u), u[axis]);
                    std::array::from_fn(|k| {
                        angle.cos() * u[k] + angle.sin() * v[k] + (1.0 - angle.cos()) * along * e[k]
                    })
                };
                at.iter().map(turn).collect()
            };
            let step = 1e-3;
            // The differences are of fourth order, with an error of about 7^5 step^4 / 30.
            let difference = |h: f64| (values(&a, &turned(h)) - values(&a, &turned(-h))) / (2.0 * h);
            let expected = (difference(step) * 4.0 - difference(2.0 * step)) / 3.0;
            let found = values(&derivatives[axis], &at);
            let off = (&found - &expected).iter().fold(0.0f64, |most, d| most.max(d.abs()));
            assert!(off < 1e-8, "axis {axis}: {off:e}");
        }
    }

    #[test]
    fn their_squares_are_the_laplacian_and_they_commute_as_rotations_do() {
        let a = sample(40);
        let l = |a: &Array2<f64>| rotational_derivatives(a.view()).unwrap();
        let [x, y, z] = l(&a);
        let laplacian = &l(&x)[0] + &l(&y)[1] + &l(&z)[2];
        let commutator = &l(&y)[0] - &l(&x)[1] + &z;
        for ((k, c), value) in laplacian.indexed_iter() {
            let degree = degree_order(k).0 as f64;
            let scale = 1e-15 * (1.0 + degree * degree) * 8.0;
            assert!((value + degree * (degree + 1.0) * a[[k, c]]).abs() < scale, "{k} {value}");
            assert!(commutator[[k, c]].abs() < scale, "{k} {}", commutator[[k, c]]);
        }
    }

    #[test]
    fn they_are_the_derivatives_of_rotations() {
        let values: Vec<[f64; 3]> = (0..49).map(|k| [0, 1, 2].map(|c| ((k * 5 + c * 11) as f64 * 0.7).sin())).collect();
        let (rotator, mut workspace, step) = (Rotator::new(6), Workspace::default(), 1e-5);
        for (axis, generated) in generators(&values).iter().enumerate() {
            let mut turned = [vec![[0.0; 3]; 49], vec![[0.0; 3]; 49]];
            for (out, t) in turned.iter_mut().zip([-step, step]) {
                let w = std::array::from_fn(|k| if k == axis { t } else { 0.0 });
                rotator.rotate(&values, &Rotation::exponential(w), out, &mut workspace);
            }
            for (k, row) in generated.iter().enumerate() {
                for c in 0..3 {
                    let difference = (turned[0][k][c] - turned[1][k][c]) / (2.0 * step);
                    assert!((row[c] - difference).abs() < 1e-8, "{axis} {k} {c}: {} {difference}", row[c]);
                }
            }
        }
    }

    #[test]
    fn other_numbers_of_rows_are_refused() {
        let error = rotational_derivatives(Array2::zeros((5, 3)).view()).unwrap_err();
        assert_eq!(error, HarmonicsError::NotABasisSize { rows: 5 });
    }
}
