//! Tests of the plans for given sizes, available data and requests.

use super::*;

const AUTO: Request = Request { strategy: Strategy::Auto, tolerance: 1e-10, max_iterations: 3000, penalised: false };
/// Problem sizes of a cortex that is fitted up to degree 100.
const CORTEX: Sizes = Sizes { rows: 40_962, rows_with_weight: 40_962, max_degree: 100, columns: 3 };
const STORED: Factor = Factor::Stored { reciprocal: 0.1 };
const EVEN: Moments = Moments::Made { uneven: false };

fn sizes(rows: usize, max_degree: usize, columns: usize) -> Sizes {
    Sizes { rows, rows_with_weight: rows, max_degree, columns }
}

fn by(strategy: Strategy) -> Request {
    Request { strategy, ..AUTO }
}

/// Returns a plan's steps in a few words.
fn words(sizes: Sizes, moments: Moments, factor: Factor, request: Request) -> String {
    let word = |step: &Step| match *step {
        Step::MakeMoments => "make moments".to_owned(),
        Step::Cg { by_moments, precondition, at_most, leave_for_factor } => format!(
            "{}{} to {at_most}{}",
            if by_moments { "moments" } else { "samples" },
            if precondition == Precondition::Density { " with density" } else { "" },
            leave_for_factor.map_or_else(String::new, |leave| format!(" or slow after {}", leave.after)),
        ),
        Step::Factor { required, .. } => (if required { "required factor" } else { "factor" }).to_owned(),
        Step::Refine => "refine".to_owned(),
    };
    let plan = choose(&sizes, &Available { moments, factor }, &request);
    assert_eq!(plan.steps.len(), plan.why.len(), "each step has a reason");
    plan.steps.iter().map(word).collect::<Vec<_>>().join("; ")
}

#[test]
fn plans_are_as_expected() {
    let by_samples = "samples to 3000 or slow after 60; factor; refine; samples to 3000";
    let by_moments =
        "moments with density to 3000 or slow after 60; factor; refine; moments with density to 3000".to_owned();
    let at_once = format!("make moments; {by_moments}");
    let rough = Request { tolerance: 1e-6, ..AUTO };
    let penalised = Request { penalised: true, ..AUTO };
    let many = sizes(1_000_000, 30, 1);
    let dense = sizes(100_000, 1000, 1);
    let masked = Sizes { rows_with_weight: 20_401, ..CORTEX };
    let undetermined = Sizes { rows_with_weight: 10_200, ..CORTEX };
    for (sizes, moments, factor, request, expected) in [
        // Plans for a surface that is given by sums over its samples.
        (CORTEX, EVEN, Factor::Makeable, AUTO, &by_moments[..]),
        (
            CORTEX,
            EVEN,
            Factor::Makeable,
            penalised,
            "moments to 3000 or slow after 60; factor; refine; moments to 3000",
        ),
        (masked, EVEN, Factor::None, AUTO, "moments to 3000"),
        (CORTEX, EVEN, Factor::Makeable, by(Strategy::Cg), "moments to 3000"),
        (CORTEX, EVEN, Factor::Makeable, by(Strategy::DensityCg), "moments with density to 3000"),
        (CORTEX, EVEN, Factor::Makeable, by(Strategy::Cholesky), "required factor; refine"),
        // Plans for a surface that is given by its vertices.
        (CORTEX, Moments::None, Factor::Makeable, AUTO, by_samples),
        (CORTEX, Moments::None, Factor::None, AUTO, "samples to 3000"),
        (CORTEX, Moments::None, Factor::None, by(Strategy::Cholesky), "required factor; refine"),
        (CORTEX, Moments::Makeable, Factor::Makeable, AUTO, &at_once),
        (CORTEX, Moments::Makeable, Factor::None, by(Strategy::Cg), "make moments; moments to 3000"),
        // Plans for samples whose moments pay off after four iterations, with five iterations expected.
        (many, Moments::Makeable, Factor::None, AUTO, "make moments; moments with density to 3000"),
        (many, Moments::Makeable, Factor::None, rough, "samples to 4; make moments; moments with density to 3000"),
        (many, Moments::Makeable, Factor::Makeable, Request { max_iterations: 4, ..rough }, "samples to 4"),
        (many, Moments::Makeable, Factor::Makeable, Request { max_iterations: 2, ..rough }, "samples to 2"),
        // Plans for a basis with more columns than samples. Moments never pay off, and are only used if requested.
        (dense, Moments::Makeable, Factor::Makeable, AUTO, "samples to 3000"),
        (dense, Moments::Makeable, Factor::None, by(Strategy::DensityCg), "make moments; moments to 3000"),
        (CORTEX, Moments::None, Factor::None, by(Strategy::DensityCg), "samples to 3000"),
        // Plans for a mask that selects fewer vertices than there are coefficients. Only a penalty makes the solution
        // unique, so a factor is used only with a penalty.
        (undetermined, EVEN, Factor::Makeable, AUTO, "moments to 3000"),
        (undetermined, Moments::None, Factor::Makeable, AUTO, "samples to 3000"),
        (undetermined, Moments::None, STORED, AUTO, "samples to 3000"),
        (undetermined, Moments::None, Factor::Makeable, by(Strategy::Cholesky), "samples to 3000"),
        (undetermined, Moments::None, Factor::Makeable, penalised, by_samples),
        // Plans with an existing factor.
        (CORTEX, Moments::Makeable, Factor::Made, AUTO, "factor; refine"),
        (CORTEX, EVEN, Factor::Stored { reciprocal: 1e-6 }, AUTO, "factor; refine"),
        (CORTEX, EVEN, Factor::Stored { reciprocal: 1e-6 }, by(Strategy::Cg), "moments to 3000"),
        (CORTEX, Moments::None, STORED, AUTO, "samples to 3000 or slow after 60; factor; refine"),
        (sizes(40_962, 100, 96), Moments::None, STORED, AUTO, "factor; refine"),
        (sizes(40_962, 100, 96), EVEN, STORED, AUTO, "moments with density to 3000 or slow after 3; factor; refine"),
        (sizes(900, 12, 48), EVEN, STORED, AUTO, "factor; refine"),
    ] {
        assert_eq!(words(sizes, moments, factor, request), expected, "{sizes:?} {moments:?} {factor:?} {request:?}");
    }
}

#[test]
fn reasons_are_as_expected() {
    let rough = Request { tolerance: 1e-6, ..AUTO };
    let many = sizes(1_000_000, 30, 1);
    let slow = "the previous iterations converged too slowly";
    let (after_factor, no_factor) = ("refines the solution to the tolerance", "no Cholesky factor could be computed");
    let exist = "with moments, an iteration costs the same for any number of samples";
    for (sizes, moments, factor, request, expected) in [
        (CORTEX, EVEN, Factor::Makeable, AUTO, &[exist, slow, after_factor, no_factor][..]),
        (CORTEX, EVEN, Factor::Makeable, by(Strategy::Cholesky), &["requested", after_factor]),
        (CORTEX, Moments::None, Factor::None, AUTO, &["moments aren't available, or don't fit in memory"]),
        (
            many,
            Moments::Makeable,
            Factor::None,
            rough,
            &["moments save time only after 4 iterations", "moments would have saved time by now", exist],
        ),
        (
            many,
            Moments::Makeable,
            Factor::None,
            AUTO,
            &["moments save time after 4 iterations, and about 7 iterations are expected", exist],
        ),
        (CORTEX, EVEN, Factor::Made, AUTO, &["a Cholesky factor was computed for an earlier batch", after_factor]),
        (
            CORTEX,
            EVEN,
            Factor::Stored { reciprocal: 1e-6 },
            AUTO,
            &["a Cholesky factor is stored, and iterations aren't expected to be faster", after_factor],
        ),
    ] {
        let plan = choose(&sizes, &Available { moments, factor }, &request);
        let found: Vec<String> = plan.why.iter().map(ToString::to_string).collect();
        assert_eq!(found, expected, "{sizes:?} {moments:?} {factor:?} {request:?}");
    }
}

/// Tests the largest predicted number of remaining iterations for which the solver doesn't switch to a factor.
#[test]
fn the_more_a_factor_costs_the_more_iterations_may_be_left() {
    let most = |moments: Moments, factor: Factor| {
        let plan = choose(&CORTEX, &Available { moments, factor }, &AUTO);
        let Some(Step::Cg { leave_for_factor: Some(leave), .. }) = plan.steps.first() else { panic!("{plan:?}") };
        let beside = if matches!(factor, STORED) && moments == EVEN { [3, 3] } else { [60, 30] };
        assert_eq!([leave.after, leave.every], beside);
        assert!((leave.most - 1.5 * leave.most_with_density).abs() <= 1e-12 * leave.most);
        leave.most
    };
    // The factor of 10,201 columns costs 8.8 s. A fifth of that allows 541 products of 3.3 ms.
    assert!((most(EVEN, Factor::Makeable) - 541.6).abs() < 1.0);
    // Using a stored factor takes 0.19 s, as long as 58 products.
    assert!((most(EVEN, STORED) - 57.8).abs() < 3.0);
    assert_eq!(most(Moments::None, Factor::Makeable), 0.0);
    assert_eq!(most(Moments::None, STORED), 0.0);
}
