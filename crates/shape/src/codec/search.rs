//! Searches for the quantisation step at which the file has a given size, or the compressed model has a given distance
//! from the original.

use super::error::CodecError;

/// Maximum number of trials in a search.
const TRIES: usize = 40;

/// Result of compressing with one step.
pub(super) struct Trial<T> {
    /// Excess of the size or distance over the wanted one, `ln(found / wanted)`: at most 0 if the step is acceptable.
    /// It may be infinite.
    pub(super) excess: f64,
    pub(super) result: T,
}

/// Returns the result of the best acceptable step among the steps tried. A step is acceptable if its excess (see
/// [`Trial`]) is at most 0. If the excess grows with the step (`rising`), the coarsest acceptable step is the best,
/// otherwise the finest is. Returns `None` if no acceptable step is found within the allowed range of steps and number
/// of trials.
///
/// The zero of the excess as a function of ln(step) is found by regula falsi with the Illinois rule, between an
/// acceptable and an unacceptable step. The search stops once an acceptable step has an excess of `-near` or more, or
/// the two steps are almost equal.
pub(super) fn search<T>(
    start: f64,
    rising: bool,
    near: f64,
    mut trial: impl FnMut(f64) -> Result<Trial<T>, CodecError>,
) -> Result<Option<T>, CodecError> {
    // Sign of the change of ln(step) that leads towards acceptable steps.
    let downhill = if rising { -1.0 } else { 1.0 };
    // The latest acceptable and the latest unacceptable step, each as `ln(step)` and the excess of its [`Trial`].
    let mut will: Option<(f64, f64)> = None;
    let mut wont: Option<(f64, f64)> = None;
    let mut best: Option<(f64, T)> = None;
    let (mut at, mut stride, mut side) = (start.ln(), 1.0, 0);
    for _ in 0..TRIES {
        if !(-700.0..700.0).contains(&at) {
            break;
        }
        let Trial { excess, result } = trial(at.exp())?;
        if excess <= 0.0 {
            // Of two acceptable steps, the one closer to the unacceptable steps is better. The steps are compared
            // rather than the sizes or distances that they lead to, because these may fluctuate slightly from step to
            // step.
            if best.as_ref().is_none_or(|(other, _)| (at - other) * downhill < 0.0) {
                best = Some((at, result));
            }
            if excess >= -near {
                break;
            }
            if side == 1 {
                wont = wont.map(|(at, excess)| (at, excess / 2.0));
            }
            (will, side) = (Some((at, excess)), 1);
        } else {
            if side == -1 {
                will = will.map(|(at, excess)| (at, excess / 2.0));
            }
            (wont, side) = (Some((at, excess)), -1);
        }
        at = match (will, wont) {
            (Some((will, below)), Some((wont, above))) => {
                if (will - wont).abs() < 1e-3 * near.max(0.1) {
                    break;
                }
                let part = if above.is_finite() { below / (below - above) } else { 0.5 };
                // The next trial is biased slightly towards acceptable steps, so that the search doesn't repeatedly
                // miss them by a tiny amount.
                will + (wont - will) * (part - 0.3 * near / (above - below)).clamp(0.02, 0.98)
            }
            (Some((at, excess)), None) => {
                stride *= 1.5;
                at - downhill * (-excess).max(0.05).min(stride)
            }
            (None, _) => {
                stride *= 1.5;
                at + downhill * excess.max(0.05).min(stride)
            }
        };
    }
    Ok(best.map(|(_, result)| result))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_finds_where_a_function_crosses() {
        for power in [0.5, 0.9, 2.0, -0.7, -1.5] {
            for start in [1e-6, 1.0, 300.0] {
                let mut tried = 0;
                let found = search(start, power > 0.0, 0.01, |step: f64| {
                    tried += 1;
                    // The excess crosses zero near 0.01.
                    Ok(Trial { excess: power * (step / 0.01).ln() + 0.002 * (1e3 * step).sin(), result: step })
                });
                let step = found.unwrap().unwrap();
                assert!((step / 0.01).ln().abs() < 0.05, "{power} {start} {step}");
                assert!(tried <= 25, "{tried}");
            }
        }
    }

    #[test]
    fn what_cant_be_had_is_none() {
        let never = search(1.0, false, 0.01, |_| Ok(Trial { excess: 1.0, result: () }));
        assert_eq!(never.unwrap(), None);
    }
}
