//! Whether iterations get on fast enough to go on without a factor.

/// Iterations after which a factor is made, where one can be, unless few more are expected to be needed: on samplings
/// that need more, many more are needed.
#[cfg(feature = "dense")]
pub(super) const BEFORE_FACTOR: usize = 60;
/// Iterations over which progress is measured.
#[cfg(feature = "dense")]
const STRETCH: usize = 30;

/// The same beside a factor that is there already.
#[cfg(feature = "dense")]
pub(super) const STRETCH_BESIDE: usize = 3;

/// How fast an iteration gets on.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Progress {
    tolerance: f64,
    /// Iterations that may seem to be left when a factor could be used instead.
    allowed: f64,
    stretch: usize,
    at_least: usize,
    before: f64,
}

#[cfg(feature = "dense")]
impl Progress {
    /// Of iterations without a factor, which takes long to make.
    pub(super) fn new(tolerance: f64, allowed: f64) -> Self {
        Self { tolerance, allowed, stretch: STRETCH, at_least: BEFORE_FACTOR, before: f64::INFINITY }
    }

    /// Of iterations beside a factor, from an optimality of `before` on.
    pub(super) fn beside_factor(tolerance: f64, allowed: f64, before: f64) -> Self {
        Self { tolerance, allowed, stretch: STRETCH_BESIDE, at_least: STRETCH_BESIDE, before }
    }
}

impl Progress {
    /// Whether to go on after so many iterations of a run.
    pub(super) fn may_go_on(&mut self, iteration: usize, optimality: f64) -> bool {
        if !iteration.is_multiple_of(self.stretch) {
            return true;
        }
        let gained = (self.before / optimality).ln();
        self.before = optimality;
        if iteration < self.at_least {
            return true;
        }
        let left = self.stretch as f64 * (optimality / self.tolerance).ln() / gained;
        gained > 0.0 && left <= self.allowed
    }
}

#[cfg(all(test, feature = "dense"))]
mod tests {
    use super::*;

    /// The iteration at which an iteration that gains so much at each step is given up, of the first 300.
    fn given_up(mut progress: Progress, gain: f64) -> Option<usize> {
        (1..300).find(|&iteration| !progress.may_go_on(iteration, gain.powi(-(iteration as i32))))
    }

    #[test]
    fn iterations_beside_a_factor_go_on_while_few_are_left() {
        let beside = Progress::beside_factor(1e-12, 10.0, 1.0);
        // Twelve at ten each; three are made.
        assert_eq!(given_up(beside, 10.0), None);
        // Forty.
        assert_eq!(given_up(beside, 2.0), Some(STRETCH_BESIDE));
        assert_eq!(given_up(beside, 1.0), Some(STRETCH_BESIDE));
        // What was gained before counts.
        assert_eq!(given_up(Progress::beside_factor(1e-12, 10.0, 1e-2), 10.0), Some(STRETCH_BESIDE));
    }

    #[test]
    fn a_factor_is_made_where_many_are_left_after_sixty() {
        // 0.7 digits in a stretch.
        assert_eq!(given_up(Progress::new(1e-10, 100.0), 1.05), Some(BEFORE_FACTOR));
        assert_eq!(given_up(Progress::new(1e-10, 1000.0), 1.05), None);
        assert_eq!(given_up(Progress::new(1e-10, 1000.0), 1.0), Some(BEFORE_FACTOR));
    }
}
