//! Generates surfaces and poses for the tests.

use ndarray::Array2;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::Silent;

use crate::rotation::Rotation;
use crate::transform::{Similarity, Transform};

/// Returns five hippocampi of degree 12, as they are after a step of SPHARM-MAT: its first alignment or its
/// registration. Returns `None` if the files aren't available.
pub(crate) fn hippocampi(step: &str) -> Option<Vec<Coefficients>> {
    let folder = spharm_testdata::shared("shape")?;
    let read = |n: usize| {
        let values: Array2<f64> = ndarray_npy::read_npy(folder.join(format!("hippo_a0{n}_r.{step}.npy"))).unwrap();
        Coefficients::new(values).unwrap()
    };
    Some((1..=5).map(read).collect())
}

/// Returns an asymmetric surface with a size of a few units, not centred at the origin.
pub(crate) fn blob(degree: usize, seed: u32) -> Coefficients {
    let value = |(k, c): (usize, usize)| {
        let l = k.isqrt() as f64;
        ((k * 7 + c * 31) as f64 * 0.37 + f64::from(seed) * 1.7).sin() * 2.0 / (1.0 + l * l)
    };
    let mut values = Array2::from_shape_fn((basis_size(degree), 3), value);
    (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (9.0, 5.0, 3.0);
    Coefficients::new(values).unwrap()
}

/// Returns the ellipsoid with the given semi-axes.
pub(crate) fn ellipsoid(axes: [f64; 3]) -> Coefficients {
    let mut values = Array2::zeros((4, 3));
    let unit = (4.0 * std::f64::consts::PI / 3.0).sqrt();
    (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (axes[0] * unit, axes[1] * unit, axes[2] * unit);
    Coefficients::new(values).unwrap()
}

/// Returns a pose computed from six numbers in [0, 1).
pub(crate) fn pose(numbers: [f64; 6]) -> Transform {
    let [a, b, c, d, e, f] = numbers;
    let similarity =
        Similarity { translation: [a * 50.0, -b, c], ..Similarity::rotation(&Rotation::uniform([d, e, f])) };
    Transform { rotation: Rotation::uniform([a, b, c]), antipodal: false, similarity }
}

/// Returns the n-th of a fixed sequence of poses.
pub(crate) fn some_pose(n: usize) -> Transform {
    pose([0.618, 0.755, 0.570, 0.819, 0.671, 0.549].map(|step: f64| ((n + 1) as f64 * step).fract()))
}

pub(crate) fn posed(coefficients: &Coefficients, transform: &Transform) -> Coefficients {
    transform.apply(coefficients, &Silent).unwrap()
}

pub(crate) fn reflected(coefficients: &Coefficients) -> Coefficients {
    let mut values = coefficients.values().clone();
    values.column_mut(0).mapv_inplace(|v| -v);
    Coefficients::new(values).unwrap()
}

/// Returns the largest difference between two surfaces' coefficients, relative to the largest coefficient.
pub(crate) fn apart(a: &Coefficients, b: &Coefficients) -> f64 {
    let largest = |values: &Array2<f64>| values.iter().fold(0.0_f64, |largest, v| largest.max(v.abs()));
    largest(&(a.values() - b.values())) / largest(a.values())
}
