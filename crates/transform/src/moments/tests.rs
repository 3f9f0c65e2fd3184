//! Compares the operator with `A^T diag(w) A` computed from the basis, and with the transforms.

use ndarray::{Array2, ArrayView1};
use proptest::prelude::*;
use spharm_harmonics::{Directions, basis_size, synthesis};

use super::{MomentOperator, SampleSums};
use crate::{FINEST, Transform, TransformError, TransformParams};

/// Returns a pseudorandom number in [-1, 1), computed from a counter.
fn noise(i: usize) -> f64 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

pub(super) fn scattered(seed: usize, n: usize) -> Directions {
    let at = |i: usize| {
        let (z, phi) = (noise(seed + 2 * i), std::f64::consts::PI * noise(seed + 2 * i + 1));
        let u = (1.0 - z * z).sqrt();
        [u * phi.cos(), u * phi.sin(), z]
    };
    Directions::from_vertices(&(0..n).map(at).collect::<Vec<_>>()).unwrap()
}

pub(super) fn numbers(seed: usize, rows: usize, columns: usize) -> Array2<f64> {
    Array2::from_shape_fn((rows, columns), |(k, c)| noise(seed + k * 31 + c * 1_000_003))
}

/// Returns the basis, (n, K), whose columns are syntheses of unit coefficients.
fn basis(directions: &Directions, max_degree: usize) -> Array2<f64> {
    synthesis(directions, Array2::eye(basis_size(max_degree)).view()).unwrap()
}

pub(super) fn dot(a: ArrayView1<'_, f64>, b: ArrayView1<'_, f64>) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// Computes `A^T diag(w) A x` from the basis `a`.
fn direct(a: &Array2<f64>, weights: &[f64], x: &Array2<f64>) -> Array2<f64> {
    let (n, c) = (a.nrows(), x.ncols());
    let samples = Array2::from_shape_fn((n, c), |(i, c)| weights[i] * dot(a.row(i), x.column(c)));
    Array2::from_shape_fn(x.dim(), |(k, c)| dot(a.column(k), samples.column(c)))
}

fn moments(directions: &Directions, weights: &[f64], max_degree: usize) -> Vec<f64> {
    let a = basis(directions, 2 * max_degree);
    a.columns().into_iter().map(|column| dot(column, ArrayView1::from(weights))).collect()
}

pub(super) fn norm(values: &Array2<f64>) -> f64 {
    values.iter().map(|value| value * value).sum::<f64>().sqrt()
}

pub(super) fn off(found: &Array2<f64>, expected: &Array2<f64>) -> f64 {
    norm(&(found - expected)) / norm(expected)
}

const DEGREES: [usize; 6] = [0, 1, 2, 7, 12, 30];

#[test]
fn scattered_directions_with_weights_of_any_sign() {
    for degree in DEGREES {
        let (directions, x) = (scattered(1, 700), numbers(2, basis_size(degree), 2));
        for weights in [(0..700).map(|i| noise(i).abs()).collect::<Vec<_>>(), (0..700).map(noise).collect()] {
            let operator = MomentOperator::new(degree, &moments(&directions, &weights, degree)).unwrap();
            let expected = direct(&basis(&directions, degree), &weights, &x);
            let off = off(&operator.apply(x.view()).unwrap(), &expected);
            assert!(off < 2e-14, "degree {degree}: {off:e}");
        }
    }
}

#[test]
fn one_direction_anywhere() {
    let half = std::f64::consts::FRAC_1_SQRT_2;
    for direction in [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -half, half], [0.48, -0.6, -0.64]] {
        let directions = Directions::from_vertices(&[direction]).unwrap();
        for degree in DEGREES {
            let x = numbers(3, basis_size(degree), 1);
            let operator = MomentOperator::new(degree, &moments(&directions, &[-2.5], degree)).unwrap();
            let expected = direct(&basis(&directions, degree), &[-2.5], &x);
            // The error is relative to the operator's norm, because x may be nearly orthogonal to the only eigenvector
            // with a nonzero eigenvalue.
            let scale = 2.5 * basis_size(degree) as f64 / (4.0 * std::f64::consts::PI) * norm(&x);
            let off = norm(&(operator.apply(x.view()).unwrap() - expected)) / scale;
            assert!(off < 1e-14, "degree {degree}, {direction:?}: {off:e}");
        }
    }
}

/// At degrees 100 and 257, rings next to the poles have fewer points, and there are several runs of rings.
#[test]
fn high_degrees_agree_with_transforms() {
    for (degree, n) in [(100, 30_000), (257, 50_000)] {
        let directions = scattered(4, n);
        let weights: Vec<f64> = (0..n).map(|i| 1.0 + 0.9 * noise(i)).collect();
        let x = numbers(5, basis_size(degree), 5);
        let sums = SampleSums::new(&directions, Some(&weights), numbers(6, n, 2).view(), degree, FINEST).unwrap();
        let params = TransformParams { max_degree: degree, accuracy: FINEST, ..Default::default() };
        let transform = Transform::new(&directions, &params).unwrap();
        let expected = transform.normal(x.view(), Some(&transform.sorted_weights(&weights).unwrap())).unwrap();
        let operator = MomentOperator::new(degree, &sums.moments).unwrap();
        let off = off(&operator.apply(x.view()).unwrap(), &expected);

        assert!(off < 2e-13, "degree {degree}: {off:e}");
    }
}

/// All directions are near a pole, where skipping an order that isn't negligible has the largest effect.
#[test]
fn caps_around_the_poles_agree_with_transforms() {
    let (degree, n) = (150, 20_000);
    let angles: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            let theta = 0.2 * noise(2 * i).abs();
            [if i % 3 == 0 { std::f64::consts::PI - theta } else { theta }, 3.0 + 3.0 * noise(2 * i + 1)]
        })
        .collect();
    let directions = Directions::from_angles(&angles).unwrap();
    let x = numbers(7, basis_size(degree), 1);
    let sums = SampleSums::new(&directions, None, numbers(6, n, 1).view(), degree, FINEST).unwrap();
    let params = TransformParams { max_degree: degree, accuracy: FINEST, ..Default::default() };
    let expected = Transform::new(&directions, &params).unwrap().normal(x.view(), None).unwrap();
    let off = off(&MomentOperator::new(degree, &sums.moments).unwrap().apply(x.view()).unwrap(), &expected);
    assert!(off < 2e-13, "{off:e}");
}

/// The uniform measure's operator is the identity at any degree.
#[test]
fn the_uniform_measure_is_the_identity() {
    for degree in [3, 64, 500] {
        let mut moments = vec![0.0; basis_size(2 * degree)];
        moments[0] = (4.0 * std::f64::consts::PI).sqrt();
        let x = numbers(8, basis_size(degree), 1);
        let off = off(&MomentOperator::new(degree, &moments).unwrap().apply(x.view()).unwrap(), &x);
        assert!(off < 4e-14, "degree {degree}: {off:e}");
    }
}

/// The operator of the density z, whose only nonzero moment has degree 1, multiplies functions by z. This couples
/// degree l with l - 1 and l + 1. The coupling of l with l - 1 at order m is `sqrt((l^2 - m^2) / (4 l^2 - 1))`.
#[test]
fn a_density_of_z_couples_neighbouring_degrees() {
    let degree = 400;
    let mut moments = vec![0.0; basis_size(2 * degree)];
    moments[2] = (4.0 * std::f64::consts::PI / 3.0).sqrt();
    let operator = MomentOperator::new(degree, &moments).unwrap();
    let x = numbers(9, basis_size(degree), 1);
    let found = operator.apply(x.view()).unwrap();
    let coupling = |l: usize, m: isize| {
        let (l, m) = (l as f64, m as f64);
        ((l * l - m * m) / (4.0 * l * l - 1.0)).sqrt()
    };
    let expected = Array2::from_shape_fn(x.dim(), |(k, c)| {
        let (l, m) = spharm_harmonics::index::degree_order(k);
        let mut sum = 0.0;
        if l > m.unsigned_abs() {
            sum += coupling(l, m) * x[[spharm_harmonics::column(l - 1, m), c]];
        }
        if l < degree {
            sum += coupling(l + 1, m) * x[[spharm_harmonics::column(l + 1, m), c]];
        }
        sum
    });
    let off = off(&found, &expected);
    assert!(off < 4e-14, "{off:e}");
}

#[test]
fn many_columns_are_each_alone() {
    let degree = 21;
    let operator = MomentOperator::new(degree, &moments(&scattered(10, 300), &vec![1.0; 300], degree)).unwrap();
    let x = numbers(11, basis_size(degree), 8);
    let together = operator.apply(x.view()).unwrap();
    for (c, column) in x.columns().into_iter().enumerate() {
        let alone = operator.apply(column.insert_axis(ndarray::Axis(1))).unwrap();
        let off = off(&alone, &together.slice(ndarray::s![.., c..=c]).to_owned());
        assert!(off < 1e-14, "column {c}: {off:e}");
    }
}

#[test]
fn bits_depend_neither_on_threads_nor_on_earlier_calls() {
    let degree = 64;
    let sums = SampleSums::new(&scattered(12, 200), None, numbers(13, 200, 1).view(), degree, 1e-9).unwrap();
    let operator = MomentOperator::new(degree, &sums.moments).unwrap();
    let x = numbers(13, basis_size(degree), 5);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| operator.apply(x.view()).unwrap())
    };
    let one = run(1);
    for threads in [1, 2, 3] {
        assert_eq!(one, run(threads), "{threads} threads");
    }
}

#[test]
fn sums_are_those_of_the_basis_and_add_up() {
    let (degree, n) = (9, 400);
    let (directions, values) = (scattered(14, n), numbers(15, n, 2));
    let weights: Vec<f64> = (0..n).map(|i| if i % 7 == 0 { 0.0 } else { noise(i).abs() }).collect();
    let sums = SampleSums::new(&directions, Some(&weights), values.view(), degree, FINEST).unwrap();
    let expected = moments(&directions, &weights, degree);
    let scale: f64 = weights.iter().sum();
    assert!(sums.moments.iter().zip(&expected).all(|(found, expected)| (found - expected).abs() < 1e-12 * scale));
    let weighted = Array2::from_shape_fn(values.dim(), |(i, c)| weights[i] * values[[i, c]]);
    let a = basis(&directions, degree);
    let expected = Array2::from_shape_fn((basis_size(degree), 2), |(k, c)| dot(a.column(k), weighted.column(c)));
    assert!(off(&sums.right_sides, &expected) < 1e-12);
    assert!((sums.squares[1] - dot(weighted.column(1), values.column(1))).abs() < 1e-12 * scale);
    assert!((sums.weight - scale).abs() < 1e-12 * scale);
    assert_eq!(sums.count, weights.iter().filter(|w| **w > 0.0).count() as u64);
}

#[test]
fn wrong_shapes_are_refused() {
    assert!(matches!(
        MomentOperator::new(2, &[0.0; 9]),
        Err(TransformError::MomentCount { degree: 4, expected: 25, found: 9 })
    ));
    let mut moments = vec![0.0; 25];
    moments[3] = f64::NAN;
    assert!(matches!(MomentOperator::new(2, &moments), Err(TransformError::MomentNotFinite { column: 3, .. })));
    let operator = MomentOperator::new(2, &[0.0; 25]).unwrap();
    assert!(matches!(
        operator.apply(Array2::zeros((4, 1)).view()),
        Err(TransformError::Shape { expected: 9, found: 4, .. })
    ));
    let directions = scattered(1, 10);
    let values = Array2::zeros((10, 1));
    assert!(SampleSums::new(&directions, Some(&[1.0; 9]), values.view(), 2, FINEST).is_err());
    assert!(SampleSums::new(&directions, None, Array2::zeros((9, 1)).view(), 2, FINEST).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The operator is symmetric, and positive semidefinite for nonnegative weights, up to rounding errors relative
    /// to the sum of the weights.
    #[test]
    fn symmetric_and_positive_semidefinite(degree in 0usize..20, n in 1usize..60, seed in 0usize..1_000_000) {
        let weights: Vec<f64> = (0..n).map(|i| noise(seed + i).abs()).collect();
        let operator = MomentOperator::new(degree, &moments(&scattered(seed, n), &weights, degree)).unwrap();
        let (x, y) = (numbers(seed + 1, basis_size(degree), 1), numbers(seed + 2, basis_size(degree), 1));
        let (nx, ny) = (operator.apply(x.view()).unwrap(), operator.apply(y.view()).unwrap());
        let of = |a: &Array2<f64>, b: &Array2<f64>| dot(a.column(0), b.column(0));
        let scale = (of(&x, &x) * of(&y, &y)).sqrt() * weights.iter().sum::<f64>() * basis_size(degree) as f64;
        prop_assert!((of(&y, &nx) - of(&x, &ny)).abs() <= 1e-15 * scale);
        prop_assert!(of(&x, &nx) >= -1e-15 * scale);
    }

    /// Rotating about the axis and then applying the operator of the rotated directions equals applying the operator
    /// and then rotating.
    #[test]
    fn turned_directions_turn_the_operator(degree in 0usize..16, angle in -3.0f64..3.0, seed in 0usize..1_000_000) {
        let directions = scattered(seed, 50);
        let (sine, cosine) = angle.sin_cos();
        let turned: Vec<[f64; 3]> =
            directions.as_slice().iter().map(|[x, y, z]| [cosine * x - sine * y, sine * x + cosine * y, *z]).collect();
        let turned = Directions::from_vertices(&turned).unwrap();
        let weights = vec![1.0; 50];
        let turn = |x: &Array2<f64>| Array2::from_shape_fn(x.dim(), |(k, c)| {
            let (l, m) = spharm_harmonics::index::degree_order(k);
            let (sine, cosine) = (m as f64 * angle).sin_cos();
            cosine * x[[k, c]] - sine * x[[spharm_harmonics::column(l, -m), c]]
        });
        let x = numbers(seed, basis_size(degree), 1);
        let of = |directions: &Directions| MomentOperator::new(degree, &moments(directions, &weights, degree)).unwrap();
        let (found, expected) = (of(&turned).apply(turn(&x).view()).unwrap(), turn(&of(&directions).apply(x.view()).unwrap()));
        prop_assert!(off(&found, &expected) < 1e-12);
    }
}

/// Degree 11 has twelve pairs of rings in two runs of eight lanes. The places of unused lanes depend on the number of
/// columns.
#[test]
fn what_is_no_number_stays_in_its_call() {
    let moments: Vec<f64> = (0..529).map(|k| if k == 0 { 10.0 } else { (k as f64).sin() }).collect();
    let x = Array2::from_shape_fn((144, 1), |(k, _)| (k as f64).cos());
    let expected = MomentOperator::new(11, &moments).unwrap().apply(x.view()).unwrap();
    let operator = MomentOperator::new(11, &moments).unwrap();
    for columns in [3, 2, 1] {
        let bad = operator.apply(Array2::from_elem((144, columns), f64::NAN).view()).unwrap();
        assert!(bad.iter().all(|value| value.is_nan()));
        assert_eq!(operator.apply(x.view()).unwrap(), expected);
    }
}
