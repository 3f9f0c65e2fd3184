//! Tests warnings of fits whose sampling or weights don't determine the coefficients well.

use ndarray::{Array2, ArrayView1};
use spharm::generate::SplitMix64;
use spharm::moments::{Part, Samples, accumulate_samples};
use spharm::{
    Directions, FitParams, FitWarning, Moments, MomentsFit, Signal, Silent, Sphere, Weights, fit, fit_moments,
};

/// Returns the directions (n, 3) of an even sampling whose z is above `least`.
fn places(least: f64) -> Array2<f64> {
    let all = Directions::fibonacci(1500).unwrap();
    let kept: Vec<f64> = all.as_slice().iter().filter(|v| v[2] > least).flatten().copied().collect();
    Array2::from_shape_vec((kept.len() / 3, 3), kept).unwrap()
}

/// Returns the vertices (n, 3) of a sphere.
fn vertices(sphere: &Sphere) -> Array2<f64> {
    Array2::from_shape_fn((sphere.directions.len(), 3), |(i, k)| sphere.directions.as_slice()[i][k])
}

/// Returns values (n, 1) of degree 1 with uniform noise.
fn values(places: &Array2<f64>, noise: f64) -> Array2<f64> {
    let mut random = SplitMix64::new(5);
    Array2::from_shape_fn((places.nrows(), 1), |(i, _)| 3.0 + 2.0 * places[[i, 2]] + noise * random.between(-1.0, 1.0))
}

fn moments(places: &Array2<f64>, values: &Array2<f64>, weights: Option<&[f64]>, max_degree: usize) -> Moments {
    let weights = weights.map(ArrayView1::from);
    let samples = Samples { directions: places.view(), values: values.view(), weights };
    accumulate_samples(&samples, vec!["f".to_owned()], max_degree, &Part::default(), &Silent).unwrap()
}

fn fitted(places: &Array2<f64>, values: &Array2<f64>, params: &FitParams) -> MomentsFit {
    fit_moments(&moments(places, values, None, params.max_degree), params, &Silent).unwrap()
}

/// A gap amplifies noise: the fit from moments warns like the fit of the samples.
#[test]
fn a_gap_that_amplifies_noise_is_warned_of_in_moments() {
    let amplified = |fit: &MomentsFit| fit.report.warnings.iter().any(|w| matches!(w, FitWarning::Amplified { .. }));
    let (whole, part) = (places(-2.0), places(-0.7));
    assert!(amplified(&fitted(&part, &values(&part, 3.0), &FitParams::lsq(10))));
    // Neither values without noise, nor an even sampling, nor a sampling of pure noise give the warning.
    assert!(!amplified(&fitted(&part, &values(&part, 0.0), &FitParams::lsq(10))));
    assert!(!amplified(&fitted(&whole, &values(&whole, 3.0), &FitParams::lsq(10))));
    assert!(!amplified(&fitted(&whole, &values(&whole, 1e4), &FitParams::lsq(1))));
}

/// Denoising removes amplified noise, so only the plain fit warns of it.
#[test]
fn amplified_noise_is_not_warned_of_after_denoising() {
    let amplified = |warnings: &[FitWarning]| warnings.iter().any(|w| matches!(w, FitWarning::Amplified { .. }));
    let part = places(-0.7);
    let sphere = Sphere::icosphere(3);
    let places = vertices(&sphere);
    let weights = Weights::Values {
        name: "w".to_owned(),
        values: places.column(2).iter().map(|z| f64::from(*z > -0.7)).collect(),
    };
    let signal = Signal::new(values(&places, 3.0).iter().copied().collect(), places.nrows(), 1);
    for denoise in [false, true] {
        let params = FitParams::lsq(10).with_denoise(denoise);
        let of_moments = fitted(&part, &values(&part, 3.0), &params).report.warnings;
        assert_eq!(amplified(&of_moments), !denoise, "{of_moments:?}");
        let of_samples = fit(&sphere, &signal, &params.with_weights(weights.clone())).unwrap().report.warnings;
        assert_eq!(amplified(&of_samples), !denoise, "{of_samples:?}");
    }
}

/// Samples at few places may all have the same weight.
#[test]
fn few_places_are_named_as_a_cause_of_undetermined_coefficients() {
    let gap =
        |largest_gap| FitWarning::Gap { max_degree: 10, samples: 10_000, functions: 121, largest_gap, resolved: 18.0 };
    let text = gap(15.0).to_string();
    assert!(text.contains("the positions of the 10000 samples"), "{text}");
    assert!(text.contains("samples at more positions"), "{text}");
    assert!(gap(40.0).to_string().contains("40.0 degrees wide"));
}

/// If the noise in a gap hides the signal of all degrees, denoising warns.
#[test]
fn denoising_warns_if_a_gap_hides_the_signal() {
    let params = FitParams::lsq(10).with_denoise(true);
    let hidden = |fit: &MomentsFit| fit.report.warnings.iter().any(|w| matches!(w, FitWarning::NoiseOfGaps { .. }));
    let (whole, part) = (places(-2.0), places(-0.7));
    let found = fitted(&part, &values(&part, 3.0), &params);
    assert!(hidden(&found), "{:?}", found.report.denoise);
    assert!(!hidden(&fitted(&whole, &values(&whole, 3.0), &params)));
    // A fit of the samples warns as well; a weight of 0 makes the gap.
    let sphere = Sphere::icosphere(3);
    let n = sphere.directions.len();
    let places = vertices(&sphere);
    let signal = Signal::new(values(&places, 3.0).iter().copied().collect(), n, 1);
    for (least, expected) in [(-0.75, true), (-2.0, false)] {
        let weights = places.column(2).iter().map(|z| f64::from(*z > least)).collect();
        let weights = Weights::Values { name: "w".to_owned(), values: weights };
        let found = fit(&sphere, &signal, &params.clone().with_weights(weights)).unwrap();
        let hidden = found.report.warnings.iter().any(|w| matches!(w, FitWarning::NoiseOfGaps { .. }));
        assert_eq!(hidden, expected, "{:?}", found.report.denoise);
    }
}

/// The loss of values by rounding is warned of if one weight exceeds the sum of the others.
#[test]
fn very_uneven_weights_are_warned_of() {
    let sphere = Sphere::icosphere(3);
    let n = sphere.directions.len();
    let places = vertices(&sphere);
    let f = values(&places, 0.0);
    let target = Signal::new(f.iter().copied().collect(), n, 1);
    for (largest, warned) in [(1e6, false), (1e13, true), (1e16, true), (1e30, true), (1e308, true)] {
        let mut weights = vec![1.0; n];
        weights[5] = largest;
        let values = Weights::Values { name: "w".to_owned(), values: weights };
        let found = fit(&sphere, &target, &FitParams::lsq(2).with_weights(values)).unwrap();
        let uneven = found.report.warnings.iter().find(|w| matches!(w, FitWarning::UnevenWeights { .. }));
        assert_eq!(uneven.is_some(), warned, "{largest}: {:?}", found.report.warnings);
    }
    for (largest, warned) in [(1e6, false), (1e14, true)] {
        let mut weights = vec![1.0; n];
        weights[5] = largest;
        let moments = moments(&places, &f, Some(&weights), 2);
        let found = fit_moments(&moments, &FitParams::lsq(2), &Silent).unwrap();
        let gap = found.report.warnings.iter().find(|w| matches!(w, FitWarning::Gap { .. }));
        assert_eq!(gap.is_some(), warned, "{largest}: {:?}", found.report.warnings);
    }
}
