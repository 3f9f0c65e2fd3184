//! Tests the transforms against direct sums by `harmonics`, and against each other.

use ndarray::{Array2, ArrayView1};
use spharm_harmonics::index::basis_size;
use spharm_harmonics::{Directions, synthesis};
use spharm_transform::{Transform, TransformParams};

/// Returns a pseudorandom number for a counter, uniform in [-1, 1).
fn noise(i: usize) -> f64 {
    let mut z = (i as u64 + 1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Returns scattered directions and numerically critical directions: at the poles, near them, at the seam and on the
/// equator.
fn directions(scattered: usize) -> Directions {
    let mut vertices = vec![[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [-0.0, 0.0, 1.0]];
    for sign in [1.0, -1.0] {
        for tiny in [1e-300, 1e-17, 1e-9, 1e-4, 1e-2] {
            vertices.extend([[tiny, 0.0, sign], [-tiny, tiny, sign], [0.0, -tiny, sign]]);
            vertices.extend([[sign, tiny, 0.3], [sign, -tiny, 0.3], [tiny, sign, 0.0], [sign, 0.0, tiny]]);
        }
    }
    for i in 0..scattered {
        let v = [noise(3 * i), noise(3 * i + 1), noise(3 * i + 2)];
        if v.iter().map(|x| x * x).sum::<f64>() > 1e-4 {
            vertices.push(v);
        }
    }
    Directions::from_vertices(&vertices).unwrap()
}

fn coefficients(max_degree: usize, channels: usize) -> Array2<f64> {
    Array2::from_shape_fn((basis_size(max_degree), channels), |(k, c)| noise(k * 31 + c * 1_000_003 + 17))
}

/// Returns the plain dot product: ndarray's `dot` would call the BLAS that the workspace selects, and this crate
/// doesn't link one.
fn dot(a: ArrayView1<'_, f64>, b: ArrayView1<'_, f64>) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn rms(values: &Array2<f64>) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

fn check(max_degree: usize, scattered: usize, channels: usize, accuracies: &[f64]) {
    let directions = directions(scattered);
    let x = coefficients(max_degree, channels);
    let direct = synthesis(&directions, x.view()).unwrap();
    // Random coefficients give larger values at a pole than elsewhere, by a factor of the root of the degree, so the
    // largest error is compared with the largest value.
    let peak = direct.iter().fold(0.0f64, |a, v| a.max(v.abs()));
    for &accuracy in accuracies {
        let params = TransformParams { max_degree, accuracy, ..Default::default() };
        let transform = Transform::new(&directions, &params).unwrap();
        let error = transform.synthesis(x.view()).unwrap() - &direct;
        let relative = rms(&error) / rms(&direct);
        let worst = error.iter().fold(0.0f64, |a, e| a.max(e.abs()));
        println!("degree {max_degree} accuracy {accuracy:e}: {relative:.1e}, worst {:.1e} of the peak", worst / peak);
        assert!(relative <= accuracy, "degree {max_degree}, {accuracy:e}: relative error {relative:e}");
        assert!(worst <= 3.0 * accuracy * peak, "degree {max_degree}, {accuracy:e}: {worst:e} of {peak:e}");
    }
}

#[test]
fn synthesis_is_the_direct_sum_to_the_accuracy_asked_for() {
    let accuracies: Vec<f64> = (3..=13).map(|exponent| 10f64.powi(-exponent)).collect();
    for max_degree in [0, 1, 2, 3, 10, 37, 100] {
        check(max_degree, 700, 3, &accuracies);
    }
}

/// The synthesis of a channel has the same bits whether it is computed alone or together with other channels.
#[test]
fn a_channel_has_the_same_bits_among_any_others() {
    for (max_degree, scattered) in [(1, 30), (20, 4000), (61, 900)] {
        let directions = directions(scattered);
        let x = coefficients(max_degree, 14);
        let on = |channels: usize, columns: std::ops::Range<usize>| {
            let params = TransformParams { max_degree, accuracy: 1e-12, channels };
            let transform = Transform::new(&directions, &params).unwrap();
            transform.synthesis(x.slice(ndarray::s![.., columns])).unwrap()
        };
        let all = on(14, 0..14);
        for (channels, columns) in [(1, 5..6), (3, 0..14), (12, 0..13), (3, 3..6), (2, 9..11)] {
            assert_eq!(on(channels, columns.clone()), all.slice(ndarray::s![.., columns]), "degree {max_degree}");
        }
    }
}

#[test]
fn synthesis_is_the_direct_sum_at_high_degrees() {
    check(300, 300, 2, &[1e-13]);
    check(700, 150, 1, &[1e-9, 1e-12]);
    check(2000, 100, 1, &[1e-6, 1e-12, 1e-13]);
}

/// The adjoint of each unit vector is compared with the basis entry by entry. A sum over many directions would hide an
/// error in a single direction at the edge of a strip of the grid.
#[test]
fn adjoint_of_each_direction_is_its_row_of_the_basis() {
    for max_degree in [9, 12] {
        let directions = directions(400);
        let basis = synthesis(&directions, Array2::eye(basis_size(max_degree)).view()).unwrap();
        for exponent in 3..=13 {
            let accuracy = 10f64.powi(-exponent);
            let params = TransformParams { max_degree, accuracy, channels: 3 };
            let transform = Transform::new(&directions, &params).unwrap();
            let adjoint = transform.adjoint_synthesis(Array2::eye(directions.len()).view()).unwrap();
            let worst = (&adjoint - &basis.t()).iter().fold(0.0f64, |a, e| a.max(e.abs()));
            // The norm of a row of the basis is about (L + 1) / sqrt(4 pi).
            assert!(worst <= 3.0 * accuracy * (max_degree + 1) as f64, "degree {max_degree}, {accuracy:e}: {worst:e}");
        }
    }
}

#[test]
fn adjoint_is_the_transpose() {
    for (max_degree, channels, accuracy) in
        [(0, 1, 1e-12), (1, 2, 1e-12), (10, 3, 1e-3), (37, 4, 1e-12), (100, 7, 1e-12), (101, 1, 1e-6), (500, 1, 1e-12)]
    {
        let directions = directions(1000);
        let params = TransformParams { max_degree, accuracy, ..Default::default() };
        let transform = Transform::new(&directions, &params).unwrap();
        let x = coefficients(max_degree, channels);
        let r = Array2::from_shape_fn((directions.len(), channels), |(i, c)| noise(i * 7 + c * 99_991));
        let synthesis = transform.synthesis(x.view()).unwrap();
        let adjoint = transform.adjoint_synthesis(r.view()).unwrap();
        for c in 0..channels {
            let left = dot(synthesis.column(c), r.column(c));
            let right = dot(x.column(c), adjoint.column(c));
            let size = dot(synthesis.column(c), synthesis.column(c)).sqrt() * dot(r.column(c), r.column(c)).sqrt();
            assert!((left - right).abs() <= 1e-13 * size, "degree {max_degree}: {left} {right}");
        }
    }
}

#[test]
fn normal_is_the_adjoint_of_the_weighted_synthesis() {
    let directions = directions(2000);
    let params = TransformParams { max_degree: 40, accuracy: 1e-10, channels: 2 };
    let transform = Transform::new(&directions, &params).unwrap();
    let x = coefficients(40, 5);
    let weights: Vec<f64> = (0..directions.len()).map(|i| 2.0 + noise(i)).collect();
    let mut samples = transform.synthesis(x.view()).unwrap();
    let plain = transform.adjoint_synthesis(samples.view()).unwrap();
    for (mut row, w) in samples.rows_mut().into_iter().zip(&weights) {
        row *= *w;
    }
    let weighted = transform.adjoint_synthesis(samples.view()).unwrap();
    let sorted = transform.sorted_weights(&weights).unwrap();
    for (expected, weights) in [(plain, None), (weighted, Some(&sorted))] {
        let found = transform.normal(x.view(), weights).unwrap();
        assert!(rms(&(&found - &expected)) < 1e-13 * rms(&expected));
    }
}

#[test]
fn bits_do_not_depend_on_the_number_of_threads_or_on_earlier_calls() {
    let directions = directions(3000);
    let params = TransformParams { max_degree: 60, accuracy: 1e-9, ..Default::default() };
    let transform = Transform::new(&directions, &params).unwrap();
    let x = coefficients(60, 4);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let samples = transform.synthesis(x.view()).unwrap();
            let adjoint = transform.adjoint_synthesis(samples.view()).unwrap();
            (samples, adjoint, transform.normal(x.view(), None).unwrap())
        })
    };
    let one = with(1);
    assert_eq!(one, with(3));
    assert_eq!(one, with(2));
}

#[test]
fn shapes_that_do_not_fit_are_errors() {
    let directions = directions(0);
    let transform = Transform::new(&directions, &TransformParams { max_degree: 3, ..Default::default() }).unwrap();
    assert!(transform.synthesis(Array2::zeros((15, 1)).view()).is_err());
    assert!(transform.adjoint_synthesis(Array2::zeros((3, 1)).view()).is_err());
    assert!(transform.sorted_weights(&[1.0]).is_err());
    assert_eq!(transform.synthesis(Array2::zeros((16, 0)).view()).unwrap().ncols(), 0);
}

#[test]
fn plans_of_a_lower_degree_share_the_directions() {
    let directions = directions(3000);
    for (twice, max_degree) in [(40, 20), (128, 64), (31, 31), (16, 0)] {
        let params = TransformParams { max_degree: twice, accuracy: 1e-11, ..Default::default() };
        let transform = Transform::new(&directions, &params).unwrap().to_degree(max_degree, 2).unwrap();
        let x = coefficients(max_degree, 3);
        let direct = synthesis(&directions, x.view()).unwrap();
        let samples = transform.synthesis(x.view()).unwrap();
        let relative = rms(&(&samples - &direct)) / rms(&direct);
        assert!(relative <= 1e-11, "degree {max_degree} of {twice}: {relative:e}");
        let back = transform.adjoint_synthesis(direct.view()).unwrap();
        for c in 0..3 {
            let (one, other) = (dot(samples.column(c), direct.column(c)), dot(x.column(c), back.column(c)));
            assert!((one - other).abs() <= 1e-12 * one.abs(), "{one} {other}");
        }
        assert!(transform.to_degree(max_degree + 1, 1).is_err());
    }
}

/// A group of channels has the same bits whether it is transformed alone or with other groups. The numbers of
/// directions cover groups that are sorted together; the last group has fewer channels.
#[test]
fn groups_of_channels_are_transformed_as_if_alone() {
    for (n, channels) in [(1000, 11), (200_000, 20)] {
        let directions = directions(n);
        let params = TransformParams { max_degree: 6, accuracy: 1e-10, channels: 3 };
        let transform = Transform::new(&directions, &params).unwrap();
        let x = coefficients(6, channels);
        let samples = transform.synthesis(x.view()).unwrap();
        let back = transform.adjoint_synthesis(samples.view()).unwrap();
        for first in (0..channels).step_by(3) {
            let columns = ndarray::s![.., first..(first + 3).min(channels)];
            assert_eq!(transform.synthesis(x.slice(columns)).unwrap(), samples.slice(columns), "{n} {first}");
            assert_eq!(
                transform.adjoint_synthesis(samples.slice(columns)).unwrap(),
                back.slice(columns),
                "{n} {first}"
            );
        }
    }
}

#[test]
fn weighted_sums_are_adjoint_syntheses_of_weights_and_weighted_samples() {
    let directions = directions(700);
    let n = directions.len();
    // The transform processes 2 channels at a time, fewer than the 3 of the samples.
    let params = TransformParams { max_degree: 20, accuracy: 1e-12, channels: 2 };
    let transform = Transform::new(&directions, &params).unwrap();
    let samples = Array2::from_shape_fn((n, 3), |(i, c)| noise(5 * i + c));
    let weights: Vec<f64> = (0..n).map(|i| noise(7 * i).abs()).collect();
    for weights in [None, Some(&weights[..])] {
        let weight = |i: usize| weights.map_or(1.0, |weights| weights[i]);
        let columns =
            Array2::from_shape_fn((n, 4), |(i, c)| weight(i) * if c == 0 { 1.0 } else { samples[[i, c - 1]] });
        let expected = transform.adjoint_synthesis(columns.view()).unwrap();
        assert_eq!(transform.weighted_sums(samples.view(), weights).unwrap(), expected);
    }
    assert!(transform.weighted_sums(samples.view(), Some(&weights[1..])).is_err());
    assert!(transform.weighted_sums(samples.slice(ndarray::s![1.., ..]), None).is_err());
}
