//! Tests that cross-validation chooses a smoothness for each channel of a signal.

use ndarray::{Array2, s};
use spharm::generate::SplitMix64;
use spharm::moments::{Part, Samples, accumulate_samples};
use spharm::{FitParams, MomentsFit, Signal, Silent, Smoothness, Sphere, fit, fit_moments};

/// Returns the directions (n, 3) of a sphere.
fn places(sphere: &Sphere) -> Array2<f64> {
    Array2::from_shape_fn((sphere.directions.len(), 3), |(i, k)| sphere.directions.as_slice()[i][k])
}

/// Returns a loud channel with detail and little noise, and a quiet channel that is almost only noise.
fn values(places: &Array2<f64>) -> Array2<f64> {
    let mut random = SplitMix64::new(7);
    let mut values = Array2::<f64>::zeros((places.nrows(), 2));
    for (mut row, v) in values.rows_mut().into_iter().zip(places.rows()) {
        row[0] = 1000.0 * (6.0 * v[0]).sin() + random.between(-1.0, 1.0);
        row[1] = v[2] + 2.0 * random.between(-1.0, 1.0);
    }
    values
}

/// The channels of a signal are fitted as each would be alone, from samples and from moments.
#[test]
fn each_channel_of_a_signal_has_its_own_smoothness() {
    let sphere = Sphere::icosphere(3);
    let places = places(&sphere);
    let values = values(&places);
    let n = values.nrows();
    let params = FitParams::lsq(12).with_smoothness(Smoothness::Auto).with_standard_errors(true);
    let of_signal = |channels: std::ops::Range<usize>| {
        let columns = values.slice(s![.., channels.clone()]);
        fit(&sphere, &Signal::new(columns.iter().copied().collect(), n, channels.len()), &params).unwrap()
    };
    let of_sums = |channels: std::ops::Range<usize>| -> MomentsFit {
        let columns = values.slice(s![.., channels.clone()]);
        let names = channels.map(|channel| channel.to_string()).collect();
        let samples = Samples { directions: places.view(), values: columns, weights: None };
        let moments = accumulate_samples(&samples, names, 12, &Part::default(), &Silent).unwrap();
        fit_moments(&moments, &params, &Silent).unwrap()
    };
    let (both, sums) = (of_signal(0..2), of_sums(0..2));
    let by_channel = &both.report.smoothness_by_channel;
    assert!(by_channel.len() == 2 && by_channel[1] > 100.0 * by_channel[0], "{by_channel:?}");
    assert_eq!(both.report.smoothness, by_channel[1]);
    let gcv = sums.report.gcv.as_ref().unwrap();
    assert_eq!((gcv.by_channel.len(), gcv.smoothness), (2, sums.report.solver.smoothness));
    for channel in 0..2 {
        let (alone, by_sums) = (of_signal(channel..channel + 1), of_sums(channel..channel + 1));
        assert!(alone.report.smoothness_by_channel.is_empty());
        assert_eq!(alone.report.smoothness, by_channel[channel]);
        for (found, expected) in [
            (both.coefficients.values().column(channel), alone.coefficients.values().column(0)),
            (sums.coefficients.values().column(channel), by_sums.coefficients.values().column(0)),
        ] {
            let (off, size) = ((&found - &expected).mapv(f64::abs).sum(), expected.mapv(f64::abs).sum());
            assert!(off < 1e-7 * size, "{channel}: {off} of {size}");
        }
        let pair = [&both, &alone].map(|fit| fit.standard_errors.as_ref().unwrap());
        let off = pair[0][[5, channel]] / pair[1][[5, 0]] - 1.0;
        assert!(off.abs() < 1e-6, "{channel}: {off}");
        let rms = [sums.report.rms[channel], by_sums.report.rms[0]].map(Option::unwrap);
        assert!((rms[0] / rms[1] - 1.0).abs() < 1e-7, "{channel}: {rms:?}");
    }
}
