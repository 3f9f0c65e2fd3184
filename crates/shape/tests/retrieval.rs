//! Tests retrieval among many models, and descriptors of the same models in other poses.

use ndarray::Array2;
use spharm_harmonics::Coefficients;
use spharm_harmonics::index::{basis_size, column, degree_order};
use spharm_shape::{Descriptors, Library, Metric, descriptors};

/// Returns a number that is uniform in [-1, 1), by the finaliser of MurmurHash3.
fn uniform(seed: u64, k: u64) -> f64 {
    let mut x = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ k.wrapping_mul(0xbf58_476d_1ce4_e5b9);
    for factor in [0xff51_afd7_ed55_8ccd, 0xc4ce_b9fe_1a85_ec53u64] {
        x = (x ^ (x >> 33)).wrapping_mul(factor);
    }
    ((x ^ (x >> 33)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// Returns a generated shape: an ellipsoid with bumps, whose power decays with the degree as for smooth surfaces.
fn shape(max_degree: usize, seed: u64) -> Array2<f64> {
    let mut values = Array2::from_shape_fn((basis_size(max_degree), 3), |(k, c)| {
        let l = degree_order(k).0 as f64;
        uniform(seed, (3 * k + c) as u64) / (1.0 + l).powf(2.5)
    });
    for (c, (l, m)) in [(1, 1), (1, -1), (1, 0)].into_iter().enumerate() {
        values[[column(l, m), c]] += 2.0 + 0.3 * uniform(seed, 1_000_000 + c as u64);
    }
    values
}

/// Noise with a norm of 2 % of the shape's norm.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Noise {
    /// Noise of equal size in all coefficients.
    White,
    /// Noise in proportion to the root mean square of the coefficients of the same degree.
    ByDegree,
}

/// Returns a modified copy of the shape: the sphere is rotated about its axis, the shape is rotated, mirrored and
/// moved, and noise is added.
fn seen_otherwise(values: &Array2<f64>, seed: u64, noise: Noise) -> Coefficients {
    let mean_square = |first: usize, last: usize| {
        let squares = (first..=last).flat_map(|row| values.row(row).to_vec()).map(|value| value * value);
        squares.sum::<f64>() / (3 * (last + 1 - first)) as f64
    };
    let white = mean_square(1, values.nrows() - 1).sqrt();
    let by_degree: Vec<f64> =
        (0..=degree_order(values.nrows() - 1).0).map(|l| mean_square(l * l, l * l + 2 * l).sqrt()).collect();
    let noisy = Array2::from_shape_fn(values.dim(), |(k, c)| {
        let size = if noise == Noise::White { white } else { by_degree[degree_order(k).0] };
        values[[k, c]] + 0.02 * 3f64.sqrt() * size * uniform(seed ^ 0xabcd, (3 * k + c) as u64)
    });
    let angle = 3.0 * uniform(seed, 2_000_000);
    let turned = Array2::from_shape_fn(values.dim(), |(k, c)| {
        let (l, m) = degree_order(k);
        let (sin, cos) = (m as f64 * angle).sin_cos();
        cos * noisy[[k, c]] - sin * noisy[[column(l, -m), c]]
    });
    let (sin, cos) = (2.0 * uniform(seed, 3_000_000)).sin_cos();
    let q = [[cos, -sin, 0.0], [0.8 * sin, 0.8 * cos, 0.6], [0.6 * sin, 0.6 * cos, -0.8]];
    let mut values =
        Array2::from_shape_fn(turned.dim(), |(row, c)| (0..3).map(|k| turned[[row, k]] * q[c][k]).sum::<f64>());
    values.row_mut(0).mapv_inplace(|value| value + 100.0);
    Coefficients::new(values).expect("a degree")
}

/// Searches for all 10,000 shapes if SPHARM_SOAK is set, otherwise for every hundredth. With white noise, 9,987
/// shapes are ranked first, and all are among the first five, from which an alignment can choose the right one.
#[test]
fn each_of_ten_thousand_shapes_is_found() {
    const MODELS: u64 = 10_000;
    let shapes: Vec<Array2<f64>> = (0..MODELS).map(|seed| shape(10, seed)).collect();
    let rows: Vec<Descriptors> = shapes
        .iter()
        .map(|values| descriptors(&Coefficients::new(values.clone()).expect("a degree")).expect("finite"))
        .collect();
    let library = Library::new(&rows, false).expect("models");
    let step = if std::env::var_os("SPHARM_SOAK").is_some() { 1 } else { 100 };
    for (noise, metric, most) in [(Noise::White, Metric::Distance, 5), (Noise::ByDegree, Metric::Standardized, 1)] {
        for seed in (0..MODELS).step_by(step) {
            let query = descriptors(&seen_otherwise(&shapes[seed as usize], seed, noise)).expect("finite");
            let found = library.nearest(&query, most, metric).expect("the same degree");
            assert!(found.iter().any(|found| found.index == seed as usize), "{noise:?} {seed}: {found:?}");
        }
    }
}

/// Five hippocampi are still recognised after SPHARM-MAT has rotated them, both in space and in parameter space.
#[test]
fn hippocampi_are_known_after_another_package_turned_them() {
    let Some(folder) = spharm_testdata::shared("shape") else { return };
    let read = |subject: usize, stage: &str| {
        let path = folder.join(format!("hippo_a0{subject}_r.{stage}.npy"));
        let values = ndarray_npy::read_npy::<_, Array2<f64>>(&path).expect("coefficients");
        descriptors(&Coefficients::new(values).expect("degree 12")).expect("finite")
    };
    let of = |stage: &str| (1..=5).map(|subject| read(subject, stage)).collect::<Vec<Descriptors>>();
    let (before, after) = (of("foe"), of("shrec"));
    let library = Library::new(&before, false).expect("models");
    for (subject, query) in after.iter().enumerate() {
        let [first, second] = library.nearest(query, 2, Metric::Distance).expect("the same degree")[..] else {
            panic!("two")
        };
        println!("{subject}: {:.1e}, then {:.2}", first.bound, second.bound);
        assert_eq!(first.index, subject);
        assert!(first.bound < 1e-6 && second.bound > 0.5, "{first:?} {second:?}");
    }
}
