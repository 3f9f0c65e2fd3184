//! Defines the steps of a fit, and the data from which `strategy` chooses them.

use std::fmt;

use spharm_harmonics::basis_size;
use spharm_monitor::{Level, Monitor};

use super::limits::ROWS_PER_COLUMN_FOR_DENSITY;
use super::params::Strategy;
use super::why::Why;

/// Sizes of a least-squares problem.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    /// Number of rows (samples).
    pub(super) rows: usize,
    /// Number of rows with nonzero weight.
    pub(super) rows_with_weight: usize,
    pub(super) max_degree: usize,
    /// Number of columns of the targets.
    pub(super) columns: usize,
}

impl Sizes {
    /// Returns whether the inverse of the sampling density may serve as the preconditioner of iterations by moments.
    pub(super) fn allow_density(&self, request: &Request) -> bool {
        let enough = self.rows_with_weight >= ROWS_PER_COLUMN_FOR_DENSITY * basis_size(self.max_degree);
        matches!(request.strategy, Strategy::Auto | Strategy::DensityCg) && enough && !request.penalised
    }

    /// Returns whether the solution isn't unique, because there is no penalty and there are fewer rows with nonzero
    /// weight than basis functions. Iterations then tend to the solution of minimum norm. Refinement with a factor of
    /// the shifted normal matrix doesn't, because the inverse of that matrix magnifies the transforms' errors in the
    /// undetermined components.
    pub(super) fn are_underdetermined(&self, request: &Request) -> bool {
        !request.penalised && self.rows_with_weight < basis_size(self.max_degree)
    }
}

/// Availability of moments and of a factor to a solver.
#[derive(Debug, Clone, Copy)]
pub(super) struct Available {
    pub(super) moments: Moments,
    pub(super) factor: Factor,
}

/// Availability of moments of the samples.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Moments {
    /// There are no moments, and they can't be computed.
    None,
    /// Moments can be computed.
    Makeable,
    /// Moments have been computed, or were given in place of samples. If the samples are `uneven`, iterations can be
    /// preconditioned with the inverse of the sampling density.
    Made { uneven: bool },
}

/// Availability of a factor of the normal matrix.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Factor {
    /// There is no factor, and none can be computed.
    None,
    /// A factor can be computed from the Gram matrix.
    Makeable,
    /// A factor has been computed for an earlier batch.
    Made,
    /// A stored factor was passed to the solver; `reciprocal` is its reciprocal condition number.
    Stored { reciprocal: f64 },
}

/// The caller's settings, on which the choice of a fit's steps depends.
#[derive(Debug, Clone, Copy)]
pub(super) struct Request {
    pub(super) strategy: Strategy,
    pub(super) tolerance: f64,
    pub(super) max_iterations: usize,
    pub(super) penalised: bool,
}

/// The steps of a fit. A step that meets the tolerance, stops improving, or uses up all iterations ends the fit.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Plan {
    pub(super) steps: Vec<Step>,
    /// Reason for each step.
    pub(super) why: Vec<Why>,
}

/// A step of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    /// Computes moments of the samples.
    MakeMoments,
    /// Runs conjugate gradients until the fit has taken `at_most` iterations in total, or until a factor seems faster.
    Cg { by_moments: bool, precondition: Precondition, at_most: usize, leave_for_factor: Option<Leave> },
    /// Provides the factor, computing it if necessary, with a shifted diagonal if the matrix is singular. A factor that
    /// can't be computed is an error if it is `required`; otherwise refinement is skipped.
    Factor { from: Factor, required: bool },
    /// Refines the solution with the factor, and ends the fit.
    Refine,
}

/// The preconditioner of a step of conjugate gradients.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Precondition {
    /// The inverse of the diagonal that the normal matrix would have on an even sampling.
    Diagonal,
    /// The inverse of the sampling density if the samples are uneven, otherwise the same as `Diagonal`.
    Density,
}

/// The rule for switching from iterations to a factor. After `after` iterations, the number of remaining iterations is
/// predicted from the progress of the last `every` iterations. The iterations end if the predicted number exceeds
/// `most`, or `most_with_density` if the density is the preconditioner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Leave {
    pub(super) after: usize,
    pub(super) every: usize,
    pub(super) most: f64,
    pub(super) most_with_density: f64,
}

impl Plan {
    /// Adds a step and its reason.
    pub(super) fn push(&mut self, step: Step, why: Why) {
        self.steps.push(step);
        self.why.push(why);
    }

    /// Logs each step.
    pub(super) fn note(&self, monitor: &dyn Monitor) {
        for ((step, why), number) in self.steps.iter().zip(&self.why).zip(1..) {
            monitor.note(Level::Detail, format_args!("step {number}: {step} ({why})"));
        }
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MakeMoments => f.write_str("computation of the moments of the samples"),
            Self::Cg { by_moments, precondition, at_most, leave_for_factor } => {
                f.write_str(if *by_moments { "iterations by moments" } else { "iterations by samples" })?;
                if *precondition == Precondition::Density {
                    f.write_str(", preconditioned with the density of the samples")?;
                }
                write!(f, ", at most {at_most} in total")?;
                let Some(Leave { after, most, .. }) = leave_for_factor else { return Ok(()) };
                write!(
                    f,
                    "; after {after} iterations, switches to a factorisation if more than {most:.0} further \
                     iterations are predicted"
                )
            }
            Self::Factor { from: Factor::Stored { reciprocal }, .. } => {
                write!(f, "the stored Cholesky factor (reciprocal condition number {reciprocal:.1e})")
            }
            Self::Factor { from: Factor::Made, .. } => f.write_str("the Cholesky factor of an earlier batch"),
            Self::Factor { required: true, .. } => f.write_str("a Cholesky factorisation"),
            Self::Factor { .. } => f.write_str("a Cholesky factorisation, if it fits in memory"),
            Self::Refine => f.write_str("refinement with the Cholesky factor (last step)"),
        }
    }
}
