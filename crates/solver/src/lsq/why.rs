//! The reasons for the steps of a fit, for its report.

use std::fmt;

/// The reason why a step was chosen. Numbers of iterations are those predicted by the cost model (`cost`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Why {
    /// The caller requested the step.
    Requested,
    /// A factor has been computed for an earlier batch.
    FactorMade,
    /// A stored factor exists.
    FactorStored,
    /// The factor gives a first solution, which the step refines.
    AfterFactor,
    /// Moments are computed first. They save time after fewer iterations (`after`) than are expected (`expected`).
    MomentsPay { after: f64, expected: f64 },
    /// The requested preconditioner is the density of the samples, which is computed from the moments.
    DensityRequested,
    /// The first iterations use the samples, because moments pay off only if more than `after` iterations are needed.
    UntilMomentsPay { after: f64 },
    /// Moments would have saved time in the previous iterations, so they may also save time in the remaining
    /// iterations.
    MomentsPaidOff,
    /// The moments exist or were computed in the previous step.
    MomentsExist,
    /// Moments would pay off too late, or never.
    MomentsPayLate { after: f64 },
    /// There are no moments, and they can't be computed or don't fit in memory.
    NoMoments,
    /// The iterations before the step didn't converge, and were predicted to take longer than a factor.
    SlowIterations,
    /// The previous step couldn't compute a factor.
    NoFactor,
}

impl fmt::Display for Why {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Requested => f.write_str("requested"),
            Self::FactorMade => f.write_str("a Cholesky factor was computed for an earlier batch"),
            Self::FactorStored => {
                f.write_str("a Cholesky factor is stored, and iterations aren't expected to be faster")
            }
            Self::AfterFactor => f.write_str("refines the solution to the tolerance"),
            Self::MomentsPay { after, expected } => {
                write!(
                    f,
                    "moments save time after {after:.0} iterations, and {} iterations are expected",
                    number(*expected)
                )
            }
            Self::DensityRequested => f.write_str("the requested preconditioner, density, needs the moments"),
            Self::UntilMomentsPay { after } => write!(f, "moments save time only after {after:.0} iterations"),
            Self::MomentsPaidOff => f.write_str("moments would have saved time by now"),
            Self::MomentsExist => f.write_str("with moments, an iteration costs the same for any number of samples"),
            Self::MomentsPayLate { after } if after.is_finite() => {
                write!(f, "moments would save time only after {after:.0} iterations")
            }
            Self::MomentsPayLate { .. } => f.write_str("iterations by moments wouldn't be faster"),
            Self::NoMoments => f.write_str("moments aren't available, or don't fit in memory"),
            Self::SlowIterations => f.write_str("the previous iterations converged too slowly"),
            Self::NoFactor => f.write_str("no Cholesky factor could be computed"),
        }
    }
}

/// Formats an expected number of iterations. The number is infinite if there are no more rows than columns.
fn number(iterations: f64) -> String {
    if iterations.is_finite() { format!("about {iterations:.0}") } else { "many".to_owned() }
}
