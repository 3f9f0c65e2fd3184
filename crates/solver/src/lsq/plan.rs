//! The steps of a fit, and the data by which `strategy` chooses them.

use std::fmt;

use spharm_monitor::{Level, Monitor};

use super::params::Strategy;

/// Sizes of a problem: `rows_with_weight` of the rows (samples) have a nonzero weight; `columns` is the number of
/// columns of the targets.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sizes {
    pub(super) rows: usize,
    pub(super) rows_with_weight: usize,
    pub(super) max_degree: usize,
    pub(super) columns: usize,
}

/// Data that a solver has or can compute.
#[derive(Debug, Clone, Copy)]
pub(super) struct Available {
    pub(super) moments: Moments,
    pub(super) factor: Factor,
}

/// Moments of the samples: unavailable, computable or computed. Problems without samples already have them. If the
/// samples are `uneven`, iterations can be preconditioned with the inverse of their density.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Moments {
    None,
    Makeable,
    Made { uneven: bool },
}

/// A factor of the normal matrix: unavailable, computable from the Gram matrix, computed, or stored with its reciprocal
/// condition number.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Factor {
    None,
    Makeable,
    Made,
    Stored { reciprocal: f64 },
}

/// Settings of the caller that determine the steps.
#[derive(Debug, Clone, Copy)]
pub(super) struct Request {
    pub(super) strategy: Strategy,
    pub(super) tolerance: f64,
    pub(super) max_iterations: usize,
    pub(super) penalised: bool,
}

/// The steps of a fit. A step that meets the tolerance, stops improving, or uses up all iterations ends the fit.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Plan {
    pub(super) steps: Vec<Step>,
}

/// A step of a fit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Step {
    /// Computes moments of the samples.
    MakeMoments,
    /// Runs conjugate gradients up to a total of `at_most` iterations, or until a factor seems faster.
    Cg { by_moments: bool, precondition: Precondition, at_most: usize, leave_for_factor: Option<Leave> },
    /// Provides the factor, computing it if necessary, with a shifted diagonal if the matrix is singular. A factor that
    /// can't be computed is an error if it is `required`; otherwise refinement is skipped.
    Factor { from: Factor, required: bool },
    /// Refines with the factor, and ends the fit.
    Refine,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Precondition {
    Diagonal,
    /// Preconditions with the inverse of the density, if the samples are uneven.
    Density,
}

/// The rule for switching from iterations to a factor. After `after` iterations, the remaining number is predicted from
/// the progress of the last `every` iterations. Iterations end if it exceeds `most`, or `most_with_density` if the
/// density preconditions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Leave {
    pub(super) after: usize,
    pub(super) every: usize,
    pub(super) most: f64,
    pub(super) most_with_density: f64,
}

impl Plan {
    /// Logs each step.
    pub(super) fn note(&self, monitor: &dyn Monitor) {
        for (step, number) in self.steps.iter().zip(1..) {
            monitor.note(Level::Detail, format_args!("step {number}: {step}"));
        }
    }
}

impl fmt::Display for Step {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MakeMoments => f.write_str("moments of the samples"),
            Self::Cg { by_moments, precondition, at_most, leave_for_factor } => {
                f.write_str(if *by_moments { "iterations by moments" } else { "iterations by samples" })?;
                if *precondition == Precondition::Density {
                    f.write_str(", with the density of uneven samples")?;
                }
                write!(f, ", at most {at_most} in total")?;
                let Some(Leave { after, most, .. }) = leave_for_factor else { return Ok(()) };
                write!(
                    f,
                    "; after {after} iterations, switches to a factor if more than {most:.0} are predicted to remain"
                )
            }
            Self::Factor { from: Factor::Stored { reciprocal }, .. } => {
                write!(f, "the stored factor, of a reciprocal condition number of {reciprocal:.1e}")
            }
            Self::Factor { from: Factor::Made, .. } => f.write_str("the factor of an earlier batch"),
            Self::Factor { required: true, .. } => f.write_str("a factor"),
            Self::Factor { .. } => f.write_str("a factor, if there is memory for it"),
            Self::Refine => f.write_str("refinement with the factor, which ends the fit"),
        }
    }
}
