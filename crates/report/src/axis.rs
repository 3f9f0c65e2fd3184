//! Computes the vertical axes of charts: their ranges and ticks.

use crate::text::number;

/// Number of decades below the largest value that a logarithmic axis shows. Smaller values are rounding errors.
const DECADES: f64 = 18.0;

/// Scale of an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Scale {
    /// Logarithmic scale, for values above 0.
    Logarithmic,
    /// Linear scale from 0, for non-negative values.
    Linear,
}

impl Scale {
    /// Returns whether a value can be shown on the scale.
    pub(crate) fn has(self, y: f64) -> bool {
        y.is_finite() && if self == Self::Logarithmic { y > 0.0 } else { y >= 0.0 }
    }

    fn of(self, y: f64) -> f64 {
        if self == Self::Logarithmic { y.log10() } else { y }
    }
}

/// An axis that covers a set of values.
pub(crate) struct Axis {
    scale: Scale,
    /// Smallest value shown.
    floor: f64,
    /// Lower end of the axis, in the units of the scale: the value, or its logarithm.
    bottom: f64,
    /// Upper end of the axis, in the units of the scale.
    upper: f64,
}

impl Axis {
    /// Returns the axis for values that can be shown on the scale; `None` if no value is above 0.
    pub(crate) fn new<I: Iterator<Item = f64>>(scale: Scale, values: impl Fn() -> I) -> Option<Self> {
        let top = values().fold(0.0_f64, f64::max);
        if top <= 0.0 {
            return None;
        }
        let floor = if scale == Scale::Logarithmic { top * 10f64.powf(-DECADES) } else { 0.0 };
        let (bottom, upper) = match scale {
            Scale::Linear => (0.0, step(top) * (top / step(top) * (1.0 - 1e-9)).ceil()),
            Scale::Logarithmic => {
                let low = values().filter(|y| *y >= floor).fold(top, f64::min);
                (low.log10().floor(), top.log10().ceil().max(low.log10().floor() + 1.0))
            }
        };
        Some(Self { scale, floor, bottom, upper })
    }

    /// Returns the position of a value on the axis, from 0 at the lower end to 1 at the upper end; `None` for values
    /// that aren't shown. Values above the upper end are clamped.
    pub(crate) fn share(&self, y: f64) -> Option<f64> {
        let shown = self.scale.has(y) && y >= self.floor;
        shown.then(|| ((self.scale.of(y) - self.bottom) / (self.upper - self.bottom)).min(1.0))
    }

    /// Returns at most seven ticks at round values: their positions from 0 to 1, and their labels as SVG.
    pub(crate) fn ticks(&self) -> Vec<(f64, String)> {
        let span = self.upper - self.bottom;
        let step = if self.scale == Scale::Logarithmic { (span / 6.0).ceil().max(1.0) } else { step(self.upper) };
        let count = (span / step * (1.0 + 1e-9)).floor() as usize;
        let label = |at: f64| match self.scale {
            Scale::Logarithmic => format!("10<tspan class=\"power\" dy=\"-5\">{at}</tspan>"),
            Scale::Linear => number(at),
        };
        (0..=count).map(|k| k as f64 * step).map(|from| (from / span, label(self.bottom + from))).collect()
    }
}

/// Returns a round number as the step between ticks, such that three to six steps reach from 0 to `top`.
fn step(top: f64) -> f64 {
    let power = 10f64.powf((top / 6.0).log10().floor());
    [1.0, 2.0, 5.0, 10.0]
        .map(|factor| factor * power)
        .into_iter()
        .find(|step| top / step <= 6.0)
        .unwrap_or(10.0 * power)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn linear_axes_begin_at_0_and_end_at_a_round_value() {
        for (top, labels) in [
            (1.0, &["0", "0.2", "0.4", "0.6", "0.8", "1"][..]),
            (2.37, &["0", "0.5", "1", "1.5", "2", "2.5"]),
            (0.013, &["0", "0.005", "0.01", "0.015"]),
            (550.0, &["0", "100", "200", "300", "400", "500", "600"]),
        ] {
            let axis = Axis::new(Scale::Linear, || [0.0, top].into_iter()).unwrap();
            let ticks = axis.ticks();
            assert_eq!(ticks.iter().map(|tick| tick.1.as_str()).collect::<Vec<_>>(), labels, "{top}");
            assert!((ticks[ticks.len() - 1].0 - 1.0).abs() < 1e-9 && axis.share(0.0) == Some(0.0));
            assert!(axis.share(f64::NAN).is_none() && axis.share(-1.0).is_none() && axis.share(2.0 * top) == Some(1.0));
        }
        assert!(Axis::new(Scale::Linear, || [0.0].into_iter()).is_none());
    }
}
