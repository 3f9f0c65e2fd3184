//! Decides whether iterations converge fast enough to continue without a factor.

#[cfg(feature = "dense")]
use super::plan::Leave;

/// Measures whether iterations converge fast enough to continue.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Progress {
    tolerance: f64,
    /// Number of iterations before which the iteration isn't abandoned.
    after: usize,
    /// Number of iterations over which progress is measured.
    every: usize,
    /// The iteration is abandoned if the predicted number of remaining iterations exceeds this number.
    most: f64,
    /// Optimality (relative gradient) at the last measurement.
    before: f64,
}

#[cfg(feature = "dense")]
impl Progress {
    /// Creates a measurement of progress for iterations that start at an optimality of `before`. `density` states
    /// whether the preconditioner is the inverse of the sampling density.
    pub(super) fn new(leave: &Leave, density: bool, tolerance: f64, before: f64) -> Self {
        let &Leave { after, every, most, most_with_density } = leave;
        Self { tolerance, after, every, most: if density { most_with_density } else { most }, before }
    }
}

impl Progress {
    /// Returns whether to continue after iteration `iteration` of a run, counted from 1.
    pub(super) fn may_go_on(&mut self, iteration: usize, optimality: f64) -> bool {
        if !iteration.is_multiple_of(self.every) {
            return true;
        }
        let gained = (self.before / optimality).ln();
        self.before = optimality;
        if iteration < self.after {
            return true;
        }
        let left = self.every as f64 * (optimality / self.tolerance).ln() / gained;
        gained > 0.0 && left <= self.most
    }
}

#[cfg(all(test, feature = "dense"))]
mod tests {
    use super::*;

    const BESIDE: Leave = Leave { after: 3, every: 3, most: 10.0, most_with_density: 4.0 };

    fn before(most: f64) -> Leave {
        Leave { after: 60, every: 30, most, most_with_density: 0.0 }
    }

    /// Returns the step, within the first 300, at which an iteration that gains a factor of `gain` per step is
    /// abandoned; `None` if it isn't abandoned.
    fn given_up(mut progress: Progress, gain: f64) -> Option<usize> {
        (1..300).find(|&iteration| !progress.may_go_on(iteration, gain.powi(-(iteration as i32))))
    }

    #[test]
    fn iterations_beside_a_factor_go_on_while_few_are_left() {
        let beside = Progress::new(&BESIDE, false, 1e-12, 1.0);
        // If each step gains a factor of ten, the iteration takes twelve steps. After three steps, the nine remaining
        // steps are few enough to continue.
        assert_eq!(given_up(beside, 10.0), None);
        // If each step gains a factor of two, the iteration takes forty steps. After three steps, the 37 remaining
        // steps are too many, so the iteration is abandoned.
        assert_eq!(given_up(beside, 2.0), Some(3));
        assert_eq!(given_up(beside, 1.0), Some(3));
        // Progress before the first step isn't counted. Starting at an optimality of 1e-2, three steps gain only one
        // digit.
        assert_eq!(given_up(Progress::new(&BESIDE, false, 1e-12, 1e-2), 10.0), Some(3));
        // Nine remaining steps are more than the four that are allowed if the density is the preconditioner.
        assert_eq!(given_up(Progress::new(&BESIDE, true, 1e-12, 1.0), 10.0), Some(3));
    }

    #[test]
    fn a_factor_is_made_where_many_are_left_after_sixty() {
        // At a gain of 1.05 per step, thirty steps gain 0.6 digits.
        assert_eq!(given_up(Progress::new(&before(100.0), false, 1e-10, 1.0), 1.05), Some(60));
        assert_eq!(given_up(Progress::new(&before(1000.0), false, 1e-10, 1.0), 1.05), None);
        assert_eq!(given_up(Progress::new(&before(1000.0), false, 1e-10, 1.0), 1.0), Some(60));
    }
}
