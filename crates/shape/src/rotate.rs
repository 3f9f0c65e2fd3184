//! Rotates the parameters of functions on the sphere, given their coefficients.
//!
//! A rotation R rotates the function on its sphere, `f'(u) = f(R^T u)`: a surface is unchanged in space, and the vertex
//! at direction u moves to direction R u. A rotation multiplies the coefficients of each degree by the matrix `D =
//! Z(al) J Z(be) J Z(ga)`, and doesn't mix degrees. Z(t) is the rotation about z, `a'_m = cos(mt) a_m - sin(mt) a_{-m}`
//! for m of either sign, and J is the half turn about (y + z)/sqrt2. Rotations of space are in
//! [`transform`](crate::transform).
//!
//! Cost: `(L+1)^3 (2 + 4c/3)` flops for c columns of degree L. Memory, in addition to the coefficients and the result:
//! `48 (L+1)` bytes, and `O(L)` in each thread. Degrees are independent of each other and their results don't depend on
//! the number of threads. Errors, relative to the largest value, are a few 1e-16 at degree 100, and 1e-13 at degree
//! 2,000. At degree 2,000 the error is mainly due to the rounding of the rotation matrix's elements.

use ndarray::Array2;
use rayon::prelude::*;
use spharm_harmonics::Coefficients;
use spharm_monitor::{Monitor, Stage};

use crate::error::ShapeError;
use crate::extent::finite;
use crate::half_turn::Workspace;
use crate::quarter::{Centre, Quarter};
use crate::rotation::Rotation;
use crate::row_sums::{COLUMNS, WIDTH};

/// Rotates functions on their sphere, `f'(u) = f(R^T u)`, given their coefficients (K, c).
///
/// # Errors
///
/// [`ShapeError::NotFinite`] if a coefficient is NaN or infinite; [`ShapeError::Interrupted`] if the monitor cancels.
pub fn rotate_parameters(
    coefficients: &Coefficients,
    rotation: &Rotation,
    monitor: &dyn Monitor,
) -> Result<Coefficients, ShapeError> {
    finite(coefficients)?;
    let (max_degree, columns) = (coefficients.max_degree(), coefficients.channels());
    let values = coefficients.values().as_standard_layout();
    let values = values.as_slice().unwrap_or_default();
    let (turns, centre) = (Turns::new(rotation, max_degree), Centre::new(max_degree));
    let mut rotated = vec![0.0; values.len()];
    // High degrees come first, so that no thread has to finish an expensive degree alone at the end.
    let mut degrees = Vec::with_capacity(max_degree + 1);
    let mut rest = rotated.as_mut_slice();
    for degree in 0..=max_degree {
        let (own, others) = rest.split_at_mut((2 * degree + 1) * columns);
        degrees.push((degree, own));
        rest = others;
    }
    degrees.reverse();
    // Progress is reported in units proportional to flops.
    let work = |degree: usize| ((degree + 1) * (degree + 1)) as u64;
    monitor.begin(Stage::counted("rotate", "elements"), (0..=max_degree).map(work).sum());
    let make = || (Quarter::default(), Workspace::default());
    degrees.into_par_iter().with_max_len(1).try_for_each_init(make, |(quarter, workspace), (degree, out)| {
        monitor.check()?;
        quarter.set(degree, &centre, WIDTH);
        let from = degree * degree * columns;
        rotate_degree(quarter, &turns, &values[from..from + out.len()], out, columns, workspace);
        monitor.step(work(degree));
        Ok::<_, ShapeError>(())
    })?;
    monitor.end();
    let rotated = Array2::from_shape_vec((values.len() / columns.max(1), columns), rotated);
    Ok(Coefficients::new(rotated.unwrap_or_default())?)
}

/// Values of cos(m t) and sin(m t) for each of the rotation's Euler angles, t = `al`, `be` and `ga`.
#[derive(Debug)]
struct Turns([Vec<[f64; 2]>; 3]);

impl Turns {
    fn new(rotation: &Rotation, max_degree: usize) -> Self {
        Self(rotation.turns().map(|turn| turn.multiples(max_degree)))
    }
}

/// Rotates the rows (2l + 1, columns) of one degree.
fn rotate_degree(
    quarter: &Quarter,
    turns: &Turns,
    values: &[f64],
    out: &mut [f64],
    columns: usize,
    workspace: &mut Workspace,
) {
    let l = quarter.degree;
    let [alpha, beta, gamma] = &turns.0;
    for start in (0..columns).step_by(COLUMNS) {
        let group = COLUMNS.min(columns - start);
        workspace.resize(l, group);
        for (m, &[cos, sin]) in gamma[..=l].iter().enumerate() {
            let (plus, minus) = ((l + m) * columns + start, (l - m) * columns + start);
            for c in 0..group {
                let (a, b) = (values[plus + c], if m == 0 { 0.0 } else { values[minus + c] });
                workspace.cos[m * group + c] = cos * a - sin * b;
                workspace.sin[m * group + c] = cos * b + sin * a;
            }
        }
        workspace.half_turn(quarter, group);
        for (m, &[cos, sin]) in beta[..=l].iter().enumerate() {
            for at in m * group..(m + 1) * group {
                let (a, b) = (workspace.cos[at], workspace.sin[at]);
                (workspace.cos[at], workspace.sin[at]) = (cos * a - sin * b, cos * b + sin * a);
            }
        }
        workspace.half_turn(quarter, group);
        for (m, &[cos, sin]) in alpha[..=l].iter().enumerate() {
            let (plus, minus) = ((l + m) * columns + start, (l - m) * columns + start);
            for c in 0..group {
                let (a, b) = (workspace.cos[m * group + c], workspace.sin[m * group + c]);
                // At m = 0, `plus` and `minus` are the same element, so the order of the assignments matters.
                out[minus + c] = cos * b + sin * a;
                out[plus + c] = cos * a - sin * b;
            }
        }
    }
}

/// Rotates coefficients up to a fixed degree repeatedly in one thread. The data that all rotations share take `8
/// (L+1)^2` bytes.
#[derive(Debug)]
pub(crate) struct Rotator {
    quarters: Vec<Quarter>,
}

impl Rotator {
    pub(crate) fn new(max_degree: usize) -> Self {
        let centre = Centre::new(max_degree);
        let quarters = (0..=max_degree).map(|degree| {
            let mut quarter = Quarter::default();
            quarter.set(degree, &centre, WIDTH);
            quarter
        });
        Self { quarters: quarters.collect() }
    }

    /// Rotates coefficients (K, 3) of at most the rotator's degree, and writes the result to `out`, which has the same
    /// length.
    pub(crate) fn rotate(
        &self,
        values: &[[f64; 3]],
        rotation: &Rotation,
        out: &mut [[f64; 3]],
        workspace: &mut Workspace,
    ) {
        let turns = Turns::new(rotation, self.quarters.len() - 1);
        for (degree, quarter) in self.quarters.iter().enumerate() {
            let rows = degree * degree..(degree + 1) * (degree + 1);
            if rows.end > values.len() {
                break;
            }
            let (values, out) = (values[rows.clone()].as_flattened(), out[rows].as_flattened_mut());
            rotate_degree(quarter, &turns, values, out, 3, workspace);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use spharm_harmonics::{Directions, basis_size, synthesis};
    use spharm_monitor::Silent;

    fn sample(degree: usize, columns: usize) -> Coefficients {
        let value = |(k, c): (usize, usize)| ((k * 7 + c * 3) as f64 * 0.37).sin() / (1.0 + k.isqrt() as f64);
        Coefficients::new(Array2::from_shape_fn((basis_size(degree), columns), value)).unwrap()
    }

    fn largest(values: &Array2<f64>) -> f64 {
        values.iter().fold(0.0, |largest: f64, v| largest.max(v.abs()))
    }

    /// Rotates a sample function f to f', and returns the largest difference between f'(u) and f(R^T u) over some
    /// directions u, relative to the largest value. Both are evaluated by direct summation.
    fn resynthesis(degree: usize, columns: usize, rotation: &Rotation) -> f64 {
        let a = sample(degree, columns);
        let rotated = rotate_parameters(&a, rotation, &Silent).unwrap();
        let directions = Directions::fibonacci(200).unwrap();
        let back: Vec<[f64; 3]> = directions.as_slice().iter().map(|&u| rotation.inverse().apply(u)).collect();
        let found = synthesis(&directions, rotated.values().view()).unwrap();
        let expected = synthesis(&Directions::from_vertices(&back).unwrap(), a.values().view()).unwrap();
        largest(&(found - &expected)) / largest(&expected)
    }

    #[test]
    fn it_agrees_with_direct_resynthesis() {
        let rotation = Rotation::from_euler(0.3, 1.1, -2.5).unwrap();
        for (degree, columns, bound) in
            [(0, 3, 1e-15), (1, 3, 1e-14), (9, 1, 1e-14), (20, 7, 3e-14), (100, 3, 1e-13), (300, 2, 5e-13)]
        {
            let off = resynthesis(degree, columns, &rotation);
            assert!(off < bound, "degree {degree}: {off:e}");
        }
    }

    #[test]
    fn it_agrees_at_and_next_to_the_poles_of_the_euler_angles() {
        let pi = std::f64::consts::PI;
        for beta in [0.0, 1e-300, 1e-13, 1e-9, 1e-5, pi / 2.0, pi - 1e-9, pi] {
            let off = resynthesis(30, 3, &Rotation::from_euler(0.7, beta, 2.1).unwrap());
            assert!(off < 1e-13, "beta {beta:e}: {off:e}");
        }
    }

    #[test]
    fn degrees_keep_their_norm_to_degree_2000() {
        // The single column has values in the highest degree only, because other degrees would only cost time.
        let degree = 2_000;
        let mut values = Array2::zeros((basis_size(degree), 1));
        let rows = degree * degree..basis_size(degree);
        rows.clone().for_each(|k| values[[k, 0]] = (k as f64 * 0.7).sin());
        let rotation = Rotation::from_euler(1.0, 0.8, 0.3).unwrap();
        let (turns, mut quarter, mut workspace) =
            (Turns::new(&rotation, degree), Quarter::default(), Workspace::default());
        quarter.set(degree, &Centre::new(degree), WIDTH);
        let own: Vec<f64> = rows.map(|k| values[[k, 0]]).collect();
        let mut out = vec![0.0; own.len()];
        rotate_degree(&quarter, &turns, &own, &mut out, 1, &mut workspace);
        let norm = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>().sqrt();
        assert!((norm(&out) / norm(&own) - 1.0).abs() < 5e-14);
    }

    #[test]
    fn threads_dont_change_bits() {
        let (a, rotation) = (sample(40, 3), Rotation::from_euler(0.3, 1.1, -2.5).unwrap());
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| rotate_parameters(&a, &rotation, &Silent).unwrap())
        };
        assert_eq!(with(1), with(3));
    }

    #[test]
    fn what_isnt_finite_is_refused() {
        let mut values = Array2::zeros((4, 3));
        values[[2, 1]] = f64::NAN;
        let found = rotate_parameters(&Coefficients::new(values).unwrap(), &Rotation::IDENTITY, &Silent);
        assert!(matches!(found, Err(ShapeError::NotFinite { row: 2, channel: 1, .. })), "{found:?}");
    }

    proptest! {
        #[test]
        fn rotations_compose(a in prop::array::uniform3(0.0..1.0), b in prop::array::uniform3(0.0..1.0)) {
            let (a, b, f) = (Rotation::uniform(a), Rotation::uniform(b), sample(11, 2));
            let once = rotate_parameters(&f, &(a * b), &Silent).unwrap();
            let first = rotate_parameters(&f, &b, &Silent).unwrap();
            let twice = rotate_parameters(&first, &a, &Silent).unwrap();
            prop_assert!(largest(&(once.values() - twice.values())) < 1e-13);
        }
    }
}
