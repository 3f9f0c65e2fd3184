//! Detects zeros among a signal's values that may mark missing values, such as the values of the medial wall.

use spharm_surface::{Kind, Target};

use crate::FitWarning;

/// Smallest share of zeros that causes a warning. Smaller shares cause no warning, because single zeros may be
/// measurements.
const FEWEST: f64 = 0.01;
/// Largest share of zeros that causes a warning. If most values are zero, as in a map with a threshold, the zeros are
/// valid values.
const MOST: f64 = 0.5;
/// A warning is given only if the absolute value of every nonzero value is at least this fraction of the median of
/// these absolute values.
const APART: f64 = 0.05;

/// Returns a warning if a channel of a signal has zeros, and all its other values have one sign and are far from 0.
/// Vertices marked in `unread` are ignored.
pub(super) fn warning(target: &Target, unread: Option<&[bool]>) -> Option<FitWarning> {
    if target.kind != Kind::Signal {
        return None;
    }
    let is_read = |vertex: usize| unread.is_none_or(|unread| !unread.get(vertex).copied().unwrap_or(false));
    (0..target.channels).find_map(|channel| {
        let values = target.values.iter().skip(channel).step_by(target.channels).enumerate();
        of_channel(channel, values.filter(|(vertex, _)| is_read(*vertex)).map(|(_, value)| *value))
    })
}

fn of_channel(channel: usize, values: impl Iterator<Item = f64> + Clone) -> Option<FitWarning> {
    // Count the zeros first. Most signals have hardly any, and then no memory is needed for the absolute values.
    let (mut vertices, mut zeros, mut signs) = (0, 0, [false; 2]);
    for value in values.clone() {
        vertices += 1;
        zeros += usize::from(value == 0.0);
        signs[0] |= value < 0.0;
        signs[1] |= value > 0.0;
    }
    let share = zeros as f64 / vertices.max(1) as f64;
    if !(FEWEST..=MOST).contains(&share) || signs == [true; 2] {
        return None;
    }
    let mut sizes: Vec<f64> = values.filter(|value| *value != 0.0).map(f64::abs).collect();
    // If all values are whole numbers, the signal is probably a mask, a label map or counts, in which zeros are valid.
    if sizes.iter().all(|size| size.fract() == 0.0) {
        return None;
    }
    let least = sizes.iter().copied().fold(f64::INFINITY, f64::min);
    let middle = sizes.len() / 2;
    let (_, median, _) = sizes.select_nth_unstable_by(middle, f64::total_cmp);
    (least >= APART * *median).then_some(FitWarning::Zeros { channel, zeros, vertices })
}

#[cfg(test)]
mod tests {
    use spharm_surface::{Signal, Sphere};

    use super::*;
    use crate::{FitParams, Weights, fit};

    #[test]
    fn zeros_apart_from_other_values_are_noticed() {
        let thickness = |vertex: usize| 2.5 + 0.001 * vertex as f64;
        let of = |zeros: usize, value: &dyn Fn(usize) -> f64| {
            let values: Vec<f64> = (0..1000).map(|vertex| if vertex < zeros { 0.0 } else { value(vertex) }).collect();
            of_channel(1, values.into_iter())
        };
        let expected = FitWarning::Zeros { channel: 1, zeros: 50, vertices: 1000 };
        assert_eq!(of(50, &thickness), Some(expected.clone()));
        assert_eq!(of(50, &|vertex| -thickness(vertex)), Some(expected));
        let unnoticed: [(usize, &dyn Fn(usize) -> f64); 7] = [
            (0, &thickness),
            (9, &thickness),
            (600, &thickness),
            (1000, &thickness),
            (50, &|vertex| if vertex == 999 { -1.0 } else { 2.5 }),
            (50, &|vertex| if vertex == 999 { 0.1 } else { 2.5 }),
            (50, &|vertex| if vertex % 2 == 0 { 1.0 } else { 2.0 }),
        ];
        for (zeros, value) in unnoticed {
            assert_eq!(of(zeros, value), None, "{zeros}: {} {}", value(998), value(999));
        }
        assert_eq!(of_channel(0, std::iter::empty()), None);
    }

    #[test]
    fn zeros_that_are_read_are_a_warning_of_the_fit() {
        let sphere = Sphere::icosphere(2);
        let values = (0..162_usize).flat_map(|vertex| [vertex as f64, if vertex < 8 { 0.0 } else { 2.5e-12 }]);
        let signal = Signal::new(values.collect(), 162, 2);
        let warnings = |params: &FitParams| fit(&sphere, &signal, params).unwrap().report.warnings;
        let params = FitParams::lsq(2);
        let expected = FitWarning::Zeros { channel: 1, zeros: 8, vertices: 162 };
        assert!(warnings(&params).contains(&expected));
        let values = (0..162).map(|vertex| if vertex < 8 { 0.0 } else { 1.0 }).collect();
        let masked = params.with_weights(Weights::Values { name: "mask".to_owned(), values });
        assert!(!warnings(&masked).iter().any(|warning| matches!(warning, FitWarning::Zeros { .. })));
    }
}
