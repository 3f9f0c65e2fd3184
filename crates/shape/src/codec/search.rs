//! The step for which a file has a size, or a model a distance.

use super::error::CodecError;

/// Tried at most.
const TRIES: usize = 40;

/// What a step gives.
pub(super) struct Trial<T> {
    /// `ln(found / wanted)`; at most 0 where the step will do. It may be infinite.
    pub(super) excess: f64,
    pub(super) result: T,
}

/// Returns the best of the steps tried that will do: the coarsest where the excess grows with the step (`rising`), else
/// the finest. `None` where none does before the excess is infinite or the range of steps is left.
///
/// The excess is taken as a function of ln(step), between a step that will do and one that won't, by regula falsi with
/// the Illinois rule; it ends at `near` below the limit, and where the two steps are next to each other.
pub(super) fn search<T>(
    start: f64,
    rising: bool,
    near: f64,
    mut trial: impl FnMut(f64) -> Result<Trial<T>, CodecError>,
) -> Result<Option<T>, CodecError> {
    // Towards steps that will do.
    let downhill = if rising { -1.0 } else { 1.0 };
    // ln(step) and excess.
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
            // A step nearer to those that won't do is better, though excesses may go up and down a little.
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
                // A little towards what will do, so that it isn't missed again and again by next to nothing.
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
                    // Crosses at 0.01.
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
