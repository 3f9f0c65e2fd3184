//! Tests the fast recurrence against reference values, against the textbook form, and by identities that the harmonics
//! satisfy.

use proptest::prelude::*;
use spharm_harmonics::textbook::harmonic;
use spharm_harmonics::{Directions, Recurrence, Sweep, basis_size, column};

/// Returns every harmonic up to `max_degree` at one direction, in the order of the columns.
fn all(recurrence: &Recurrence, direction: [f64; 3], max_degree: usize) -> Vec<f64> {
    let mut values = vec![0.0; basis_size(max_degree)];
    let mut sweep = Sweep::new(recurrence, &[direction]);
    for l in 0..=max_degree {
        sweep.next_degree(&mut values[l * l..(l + 1) * (l + 1)]);
    }
    values
}

fn scale(degree: usize) -> f64 {
    ((2 * degree + 1) as f64 / (4.0 * std::f64::consts::PI)).sqrt()
}

/// The references in `tests/data/reference.csv` were computed by `make_reference.py` with mpmath, to degree 2,000, at
/// directions that include the poles, 1e-8 from the poles, the equator and the seam.
#[test]
fn agrees_with_fifty_digit_references_to_degree_2000() {
    let table = include_str!("data/reference.csv");
    let recurrence = Recurrence::new(2000).unwrap();
    let mut rows: Vec<([f64; 3], usize, isize, f64)> = Vec::new();
    for line in table.lines().filter(|line| !line.starts_with('#')).skip(1) {
        let f: Vec<&str> = line.split(',').collect();
        let number = |i: usize| f[i].parse::<f64>().unwrap();
        rows.push(([number(0), number(1), number(2)], f[3].parse().unwrap(), f[4].parse().unwrap(), number(5)));
    }
    assert!(rows.len() > 10_000);
    let (mut direction, mut values, mut worst) = ([f64::NAN; 3], Vec::new(), (0.0, [0.0; 3], 0, 0));
    for (d, degree, order, expected) in rows {
        if d.map(f64::to_bits) != direction.map(f64::to_bits) {
            (direction, values) = (d, all(&recurrence, d, 2000));
        }
        let error = (values[column(degree, order)] - expected).abs() / scale(degree);
        assert!(error.is_finite());
        if error > worst.0 {
            worst = (error, d, degree, order);
        }
    }
    println!("largest error / sqrt((2l+1)/(4 pi)): {worst:?}");
    assert!(worst.0 <= 1e-12, "{worst:?}");
}

/// The addition theorem for the orders of one degree is `sum_m S_lm(x) S_lm(y) = (2l+1)/(4 pi) P_l(x . y)`. Here x = y,
/// so the sum is `(2l+1)/(4 pi)`.
#[test]
fn addition_theorem_holds_to_degree_2000_at_any_colatitude() {
    let recurrence = Recurrence::new(2000).unwrap();
    for theta in [0.0f64, 1e-9, 1e-6, 1e-3, 0.02, 0.049, 0.051, 0.1, 0.3, 0.7, 1.2, 1.57, 2.2, 3.0, 3.1] {
        let values = all(&recurrence, [theta.sin() * 0.6, theta.sin() * 0.8, theta.cos()], 2000);
        for l in [0, 1, 86, 150, 700, 1500, 2000] {
            let sum: f64 = values[l * l..(l + 1) * (l + 1)].iter().map(|s| s * s).sum();
            let ratio = sum / scale(l).powi(2);
            assert!((ratio - 1.0).abs() < 1e-12, "theta {theta}, l {l}: {ratio}");
        }
    }
}

/// With an exact quadrature, the Gram matrix of the harmonics is the identity. The quadrature has Gauss-Legendre nodes
/// in colatitude, found by Newton's method, and equidistant azimuths.
#[test]
fn harmonics_are_orthonormal_over_the_sphere() {
    let max_degree = 24;
    let (rings, azimuths) = (max_degree + 1, 2 * max_degree + 2);
    let mut vertices = Vec::new();
    let mut weights = Vec::new();
    for ring in 0..rings {
        let (z, weight) = gauss_legendre(rings, ring);
        let u = (1.0 - z * z).sqrt();
        for k in 0..azimuths {
            let phi = std::f64::consts::TAU * k as f64 / azimuths as f64;
            vertices.push([u * phi.cos(), u * phi.sin(), z]);
            weights.push(weight * std::f64::consts::TAU / azimuths as f64);
        }
    }
    let recurrence = Recurrence::new(max_degree).unwrap();
    let k = basis_size(max_degree);
    let mut gram = vec![0.0; k * k];
    for (&vertex, &weight) in vertices.iter().zip(&weights) {
        let s = all(&recurrence, vertex, max_degree);
        for i in 0..k {
            for j in 0..k {
                gram[i * k + j] += weight * s[i] * s[j];
            }
        }
    }
    for i in 0..k {
        for j in 0..k {
            let expected = if i == j { 1.0 } else { 0.0 };
            assert!((gram[i * k + j] - expected).abs() < 1e-12, "{i} {j} {}", gram[i * k + j]);
        }
    }
}

fn gauss_legendre(n: usize, index: usize) -> (f64, f64) {
    let mut z = (std::f64::consts::PI * (index as f64 + 0.75) / (n as f64 + 0.5)).cos();
    let mut derivative = 0.0;
    for _ in 0..100 {
        let (mut p0, mut p1) = (1.0, z);
        for l in 2..=n {
            (p0, p1) = (p1, ((2 * l - 1) as f64 * z * p1 - (l - 1) as f64 * p0) / l as f64);
        }
        derivative = n as f64 * (z * p1 - p0) / (z * z - 1.0);
        z -= p1 / derivative;
    }
    (z, 2.0 / ((1.0 - z * z) * derivative * derivative))
}

fn direction() -> impl Strategy<Value = [f64; 3]> {
    (-1.0..1.0f64, 0.0..std::f64::consts::TAU).prop_map(|(z, phi)| {
        let u = (1.0 - z * z).sqrt();
        Directions::from_vertices(&[[u * phi.cos(), u * phi.sin(), z]]).unwrap().as_slice()[0]
    })
}

proptest! {
    #[test]
    fn agrees_with_the_textbook(d in direction()) {
        let recurrence = Recurrence::new(90).unwrap();
        let values = all(&recurrence, d, 90);
        for l in 0..=90usize {
            for m in -(l as isize)..=l as isize {
                let expected = harmonic(l, m, d);
                prop_assert!((values[column(l, m)] - expected).abs() < 2e-13 * scale(l), "{l} {m}");
            }
        }
    }

    /// The addition theorem `sum_m S_lm(x) S_lm(y) = (2l+1)/(4 pi) P_l(x . y)` holds for any two directions.
    #[test]
    fn addition_theorem_holds_between_any_two_directions(a in direction(), b in direction()) {
        let recurrence = Recurrence::new(150).unwrap();
        let cosine: f64 = (0..3).map(|i| a[i] * b[i]).sum();
        let (a, b) = (all(&recurrence, a, 150), all(&recurrence, b, 150));
        let (mut older, mut legendre) = (0.0, 1.0);
        for l in 0..=150usize {
            let sum: f64 = (l * l..(l + 1) * (l + 1)).map(|k| a[k] * b[k]).sum();
            let expected = scale(l).powi(2) * legendre;
            prop_assert!((sum - expected).abs() < 1e-14 * (1 + l * l) as f64 , "{}: {} {}", l, sum, expected);
            let next = ((2 * l + 1) as f64 * cosine * legendre - l as f64 * older) / (l + 1) as f64;
            (older, legendre) = (legendre, next);
        }
    }

    /// A rotation transforms the harmonics of one degree by an orthogonal matrix. Therefore the inner product of the
    /// harmonics' values at two directions stays equal if both directions are rotated.
    #[test]
    fn inner_products_of_a_degree_survive_rotation(a in direction(), b in direction(), axis in direction(), angle in 0.0..6.3f64) {
        let recurrence = Recurrence::new(40).unwrap();
        let inner = |a, b, l: usize| {
            let (a, b) = (all(&recurrence, a, 40), all(&recurrence, b, 40));
            (l * l..(l + 1) * (l + 1)).map(|k| a[k] * b[k]).sum::<f64>()
        };
        let rotated = |v: [f64; 3]| {
            let (s, c) = angle.sin_cos();
            let dot: f64 = (0..3).map(|i| axis[i] * v[i]).sum();
            let r: [f64; 3] = std::array::from_fn(|i| {
                let cross = axis[(i + 1) % 3] * v[(i + 2) % 3] - axis[(i + 2) % 3] * v[(i + 1) % 3];
                c * v[i] + s * cross + (1.0 - c) * dot * axis[i]
            });
            r
        };
        for l in [0, 1, 2, 7, 40] {
            let (before, after) = (inner(a, b, l), inner(rotated(a), rotated(b), l));
            prop_assert!((before - after).abs() < 1e-13 * (1 + l * l) as f64, "{l}: {before} {after}");
        }
    }
}

/// Values have the same bits whether they are computed for one direction at a time, for all directions together, or
/// with degrees skipped.
#[test]
fn values_do_not_depend_on_the_run_they_are_computed_in() {
    let directions: Vec<[f64; 3]> = (0..37)
        .map(|i| {
            let (theta, phi) = (3.1 * i as f64 / 36.0, 1.7 * i as f64);
            [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
        })
        .collect();
    let recurrence = Recurrence::new(130).unwrap();
    let mut whole = Sweep::new(&recurrence, &directions);
    let mut singles: Vec<Sweep<'_>> =
        directions.iter().map(|d| Sweep::new(&recurrence, std::slice::from_ref(d))).collect();
    for l in 0..=130 {
        let mut block = vec![0.0; 37 * (2 * l + 1)];
        whole.next_degree(&mut block);
        for (row, sweep) in singles.iter_mut().enumerate() {
            if l % 3 == 1 {
                sweep.skip_degree();
                continue;
            }
            let mut values = vec![0.0; 2 * l + 1];
            sweep.next_degree(&mut values);
            for (column, value) in values.iter().enumerate() {
                assert_eq!(value.to_bits(), block[column * 37 + row].to_bits(), "{l} {row}");
            }
        }
    }
}
