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

    /// Of iterations from x = 0 beside a factor.
    pub(super) fn beside_factor(tolerance: f64, allowed: f64) -> Self {
        Self { tolerance, allowed, stretch: STRETCH_BESIDE, at_least: STRETCH_BESIDE, before: 1.0 }
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
