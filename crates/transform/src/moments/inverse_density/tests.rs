//! Tests the inverse together with the operator, on densities whose inverse is known and on various samplings.

use ndarray::{Array2, s};
use spharm_harmonics::{Directions, basis_size};

use super::super::tests::{dot, norm, numbers, off, scattered};
use super::InverseDensity;
use crate::moments::MomentOperator;
use crate::{FINEST, SampleSums, TransformError};

fn moments(directions: &Directions, max_degree: usize) -> Vec<f64> {
    let none = Array2::zeros((directions.len(), 0));
    SampleSums::new(directions, None, none.view(), max_degree, FINEST).unwrap().moments
}

/// Returns the moments of a density `1 + slope z`.
fn sloping(max_degree: usize, slope: f64) -> Vec<f64> {
    let mut moments = vec![0.0; basis_size(2 * max_degree)];
    moments[0] = (4.0 * std::f64::consts::PI).sqrt();
    moments[2] = slope * (4.0 * std::f64::consts::PI / 3.0).sqrt();
    moments
}

/// Returns random directions, without those for which `kept` is false.
fn kept(n: usize, kept: impl Fn(usize, [f64; 3]) -> bool) -> Directions {
    let all = scattered(5, n);
    let some = all.as_slice().iter().enumerate().filter(|&(i, &v)| kept(i, v)).map(|(_, &v)| v);
    Directions::from_vertices(&some.collect::<Vec<_>>()).unwrap()
}

#[test]
fn a_density_that_varies_slowly_is_inverted() {
    const DEGREE: usize = 40;
    let moments = sloping(DEGREE, 0.6);
    let operator = MomentOperator::new(DEGREE, &moments).unwrap();
    let inverse = InverseDensity::new(DEGREE, &moments).unwrap().unwrap();
    // Only low degrees are nonzero, so that their products with the density aren't cut off.
    let mut x = numbers(1, basis_size(DEGREE), 2);
    x.slice_mut(s![basis_size(20).., ..]).fill(0.0);
    let found = inverse.apply(operator.apply(x.view()).unwrap().view()).unwrap();
    assert!(off(&found, &x) < 2e-3, "{:e}", off(&found, &x));
}

/// Returns the ratio of the extreme eigenvalues of `operator`, which bounds the number of iterations. Both eigenvalues
/// are computed by power iterations. The largest eigenvalue is that of `operator` itself. The smallest follows from the
/// largest eigenvalue of `top I - operator`, where `top` is the largest eigenvalue of `operator`.
fn spread(operator: impl Fn(&Array2<f64>) -> Array2<f64>, size: usize) -> f64 {
    let largest = |of: &dyn Fn(&Array2<f64>) -> Array2<f64>| {
        let mut x = numbers(3, size, 1);
        let mut found = 0.0;
        for _ in 0..400 {
            x /= norm(&x);
            let y = of(&x);
            (found, x) = (norm(&y), y);
        }
        found
    };
    let top = largest(&operator);
    top / (top - largest(&|x| x * top - operator(x)))
}

#[test]
fn the_condition_of_uneven_samplings_is_much_smaller_with_it() {
    const DEGREE: usize = 12;
    let size = basis_size(DEGREE);
    // The tested samplings are: samples that are five times as dense on one side, samples with a gap of fifteen
    // degrees, and random samples, six per coefficient.
    for (directions, gain) in [
        (kept(20_000, |i, [x, _, _]| x > 0.0 || i % 5 == 0), 3.0),
        (kept(8_000, |_, [_, y, _]| y < 0.97), 3.0),
        (scattered(9, 1000), 2.0),
    ] {
        let moments = moments(&directions, DEGREE);
        let operator = MomentOperator::new(DEGREE, &moments).unwrap();
        let inverse = InverseDensity::new(DEGREE, &moments).unwrap().unwrap();
        let without = spread(|x| operator.apply(x.view()).unwrap(), size);
        let with = spread(|x| inverse.apply(operator.apply(x.view()).unwrap().view()).unwrap(), size);
        assert!(with * gain < without, "{without} {with}");
    }
}

#[test]
fn symmetric_and_positive() {
    const DEGREE: usize = 15;
    let inverse = InverseDensity::new(DEGREE, &moments(&scattered(1, 900), DEGREE)).unwrap().unwrap();
    let x = numbers(7, basis_size(DEGREE), 4);
    let y = inverse.apply(x.view()).unwrap();
    for a in 0..4 {
        for b in 0..4 {
            let (left, right) = (dot(x.column(a), y.column(b)), dot(x.column(b), y.column(a)));
            assert!((left - right).abs() < 1e-13 * norm(&x) * norm(&y));
        }
        assert!(dot(x.column(a), y.column(a)) > 0.0);
    }
    // A column has the same bits alone and with other columns, on any number of threads.
    let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
    assert_eq!(pool.install(|| inverse.apply(x.view())).unwrap(), y);
    assert_eq!(inverse.apply(x.slice(s![.., ..3])).unwrap(), y.slice(s![.., ..3]));
}

#[test]
fn even_samplings_and_those_with_large_gaps_have_none() {
    let none = |directions: &Directions| InverseDensity::new(12, &moments(directions, 12)).unwrap().is_none();
    assert!(none(&Directions::fibonacci(1000).unwrap()));
    assert!(none(&scattered(2, 50_000)));
    assert!(none(&kept(8_000, |_, [_, _, z]| z < 0.7)));
    assert!(!none(&scattered(2, 1000)));
    // Weights whose sum isn't positive define no density.
    for sum in [0.0, -1.0] {
        let mut moments = sloping(4, 0.9);
        moments[0] = sum;
        assert!(InverseDensity::new(4, &moments).unwrap().is_none());
    }
    assert!(InverseDensity::new(0, &[1.0]).unwrap().is_none());
}

/// Whether a gap is large depends on the number of wavelengths that fit into it.
#[test]
fn the_same_gap_is_small_for_low_degrees_and_large_for_high_ones() {
    let directions = kept(60_000, |i, [x, _, z]| z < 0.96 && (x > 0.0 || i % 3 == 0));
    let there = |degree: usize| InverseDensity::new(degree, &moments(&directions, degree)).unwrap().is_some();
    assert!(there(30));
    assert!(!there(60));
}

/// The density `1 + 0.6 z` goes from 0.4 to 1.6.
#[test]
fn its_condition_is_that_of_the_density() {
    let condition = InverseDensity::new(60, &sloping(60, 0.6)).unwrap().unwrap().condition();
    assert!((condition - 4.0).abs() < 0.05, "{condition}");
}

#[test]
fn what_does_not_fit_is_refused() {
    assert!(matches!(InverseDensity::new(4, &[1.0; 80]), Err(TransformError::MomentCount { .. })));
    assert!(matches!(InverseDensity::new(1, &[f64::NAN; 9]), Err(TransformError::MomentNotFinite { .. })));
    let inverse = InverseDensity::new(8, &sloping(8, 0.9)).unwrap().unwrap();
    let found = inverse.apply(Array2::zeros((80, 1)).view());
    assert!(matches!(found, Err(TransformError::Shape { expected: 81, found: 80, .. })));
}
