//! Chooses the steps of a least-squares fit: [`choose`] only returns a list of steps, and doesn't execute them. The
//! solver executes the steps one after another (`run`) and reports on them.
//!
//! | request | available | steps |
//! |---|---|---|
//! | factor | at least as many rows as basis functions, or a penalty | factor, refinement |
//! | auto | factor, except as below | factor, refinement |
//! | any | moments, or no samples | iterations by moments |
//! | any | moments that pay off at once (`cost`) or that a requested density needs | moments, iterations by moments |
//! | any | moments that pay off later | iterations by samples until then, moments, iterations by moments |
//! | any | no moments that pay off | iterations by samples |
//!
//! There is one exception to the table. A stored factor of a well-conditioned matrix isn't used for few columns, or if
//! moments and a few iterations cost less than using the factor. Iterations by moments are preconditioned with the
//! density if the density is requested or the choice is left to the solver, provided that there is no penalty and there
//! are enough rows. With auto, iterations end early if a factor seems faster, provided that there are at most as many
//! basis functions as rows, and that there is a factor or a Gram matrix. The iterations are then followed by factor and
//! refinement, or by further iterations if the factor can't be computed. Rows of weight 0 are counted only for the cost
//! of products and, with a penalty, for the number of rows that a factor requires. The constants are in `limits`.

#[cfg(test)]
mod tests;

use spharm_harmonics::basis_size;

use super::cost::Cost;
use super::limits::{
    BEGUN_PER_SOLVE_COST, FEW_COLUMNS, ITERATIONS_BEFORE_FACTOR, ITERATIONS_BESIDE_FACTOR, ITERATIONS_OF_PROGRESS,
    LEFT_PER_FACTOR_COST, WELL_CONDITIONED_RECIPROCAL,
};
use super::params::Strategy;
use super::plan::{Available, Factor, Leave, Moments, Plan, Precondition, Request, Sizes, Step};
use super::why::Why;

/// Chooses the steps of a fit.
pub(super) fn choose(sizes: &Sizes, available: &Available, request: &Request) -> Plan {
    let &Request { strategy, max_iterations, .. } = request;
    let &Available { moments, factor } = available;
    let &Sizes { rows, rows_with_weight, max_degree, columns: channels } = sizes;
    let cost = Cost { rows, rows_with_weight, max_degree, channels };
    let before_moments = iterations_before_moments(&cost, moments, request);
    let at_hand = matches!(factor, Factor::Made | Factor::Stored { .. });
    let well = matches!(factor, Factor::Stored { reciprocal } if reciprocal > WELL_CONDITIONED_RECIPROCAL);
    let left_alone = well && (sizes.columns <= FEW_COLUMNS || pays_beside_factor(&cost, moments, before_moments));
    let mut plan = Plan::default();
    let by_factor = |plan: &mut Plan, why: Why| {
        plan.push(Step::Factor { from: factor, required: strategy == Strategy::Cholesky }, why);
        plan.push(Step::Refine, Why::AfterFactor);
    };
    let by_factor_at_once = strategy == Strategy::Cholesky || (strategy == Strategy::Auto && at_hand && !left_alone);
    let undetermined = sizes.are_underdetermined(request);
    if by_factor_at_once && !undetermined {
        by_factor(&mut plan, why_at_once(strategy, factor));
        return plan;
    }
    let density = sizes.allow_density(request);
    let iterate = |by_moments: bool, at_most: usize, leave_for_factor: Option<Leave>| {
        let precondition = if by_moments && density { Precondition::Density } else { Precondition::Diagonal };
        Step::Cg { by_moments, precondition, at_most, leave_for_factor }
    };
    let mut by_moments = matches!(moments, Moments::Made { .. });
    if let Some(first) = before_moments {
        if first > 0 {
            plan.push(
                iterate(false, first.min(max_iterations), None),
                Why::UntilMomentsPay { after: cost.paid_after() },
            );
        }
        if first >= max_iterations.max(1) {
            return plan;
        }
        plan.push(Step::MakeMoments, why_moments(&cost, first, request));
        by_moments = true;
    }
    let has_factor = factor != Factor::None && basis_size(max_degree) <= rows && !undetermined;
    let may_leave = strategy == Strategy::Auto && has_factor;
    let why = match (by_moments, moments) {
        (true, _) => Why::MomentsExist,
        (false, Moments::None) => Why::NoMoments,
        (false, _) => Why::MomentsPayLate { after: cost.paid_after() },
    };
    plan.push(iterate(by_moments, max_iterations, may_leave.then(|| leave(&cost, by_moments, factor))), why);
    if may_leave {
        by_factor(&mut plan, Why::SlowIterations);
        if factor == Factor::Makeable {
            plan.push(iterate(by_moments, max_iterations, None), Why::NoFactor);
        }
    }
    plan
}

/// Returns the reason why a fit uses a factor from the start, without iterations before it.
fn why_at_once(strategy: Strategy, factor: Factor) -> Why {
    match factor {
        _ if strategy == Strategy::Cholesky => Why::Requested,
        Factor::Stored { .. } => Why::FactorStored,
        _ => Why::FactorMade,
    }
}

/// Returns why moments are computed after `first` iterations.
fn why_moments(cost: &Cost, first: usize, request: &Request) -> Why {
    match first {
        _ if request.strategy == Strategy::DensityCg => Why::DensityRequested,
        0 => Why::MomentsPay { after: cost.paid_after(), expected: cost.expected_iterations(request.tolerance) },
        _ => Why::MomentsPaidOff,
    }
}

/// Returns the number of iterations by samples before moments are computed. The number is zero if moments save time
/// within the expected iterations. Otherwise it is the number of iterations after which moments would have saved time.
/// Returns `None` if moments aren't to be computed.
fn iterations_before_moments(cost: &Cost, moments: Moments, request: &Request) -> Option<usize> {
    let paid_after = cost.paid_after();
    match moments {
        Moments::Makeable if request.strategy == Strategy::DensityCg => Some(0),
        Moments::Makeable if paid_after > ITERATIONS_BEFORE_FACTOR as f64 => None,
        Moments::Makeable if cost.at_once(request.tolerance) => Some(0),
        Moments::Makeable => Some(paid_after.ceil() as usize),
        Moments::None | Moments::Made { .. } => None,
    }
}

/// Returns whether it saves time to begin with iterations by moments, although a stored factor of a well-conditioned
/// matrix exists.
fn pays_beside_factor(cost: &Cost, moments: Moments, before_moments: Option<usize>) -> bool {
    let (making, each) = match (moments, before_moments) {
        (Moments::Made { uneven: true }, _) => (0.0, cost.preconditioned()),
        (Moments::Made { uneven: false }, _) => (0.0, cost.by_moments()),
        (_, Some(0)) => (cost.making(), cost.by_moments()),
        _ => return false,
    };
    making + ITERATIONS_BESIDE_FACTOR as f64 * each < BEGUN_PER_SOLVE_COST * cost.with_factor()
}

/// Returns the rule for switching from iterations to a factor.
fn leave(cost: &Cost, by_moments: bool, factor: Factor) -> Leave {
    let (after, every) = (ITERATIONS_BEFORE_FACTOR, ITERATIONS_OF_PROGRESS);
    let most_by = |all: f64| (all / cost.by_moments(), all / cost.preconditioned());
    let ((after, every), (most, most_with_density)) = match (by_moments, factor) {
        (true, Factor::Stored { .. }) => {
            ((ITERATIONS_BESIDE_FACTOR, ITERATIONS_BESIDE_FACTOR), most_by(cost.with_factor()))
        }
        (true, _) => ((after, every), most_by(LEFT_PER_FACTOR_COST * cost.factor())),
        (false, _) => ((after, every), (0.0, 0.0)),
    };
    Leave { after, every, most, most_with_density }
}
