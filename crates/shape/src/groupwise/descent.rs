//! Runs one stage of the refinement: moves the maps of all members along tangent fields that decrease the objective.
//!
//! ```text
//! phi_i <- exp(t w_i) o phi_i,    w from the gradient by L-BFGS, preconditioned by (l (l + 1))^-1.5
//! ```
//!
//! Here phi_i is the map of member i, w_i is its tangent field, and t is the step length, which must satisfy two
//! limits. No direction moves by more than [`FARTHEST`], or by more than [`FIRST`] if L-BFGS has no stored pairs. The
//! displacements of two neighbours differ by at most [`STRETCH`] times the neighbours' distance. If displacements
//! differ by less than the distance, the step is one-to-one and can be inverted by a fixed-point iteration. The first t
//! tried is 1 or the largest allowed length, whichever is smaller. If L-BFGS has no stored pairs, it is the largest
//! allowed length. t is then reduced until the objective satisfies Armijo's rule and no triangle is inverted. Each
//! reduction halves t or sets it to the minimum of the parabola through the costs.
//!
//! Cost: typically two evaluations of the objective per step.

use ndarray::Array2;
use spharm_harmonics::index::{basis_size, degree_order};
use spharm_monitor::Monitor;
use spharm_surface::geometry::{Vec3, dot as inner, sub};

use crate::error::ShapeError;
use crate::groupwise::field::step;
use crate::groupwise::flow::Flow;
use crate::groupwise::lbfgs::{Lbfgs, dot};
use crate::groupwise::params::{GroupwiseParams, StageParams};
use crate::groupwise::report::{Distortion, StageReport};
use crate::groupwise::state::{Group, State};

/// Largest angle, in radians, by which a step moves a direction while L-BFGS has no stored pairs, for example at the
/// start of a stage.
const FIRST: f64 = 0.03;
/// Largest angle, in radians, by which a step moves a direction if L-BFGS has stored pairs.
const FARTHEST: f64 = 0.15;
/// Maximum difference between the displacements of neighbouring vertices, as a fraction of the vertices' distance.
/// Steps that would exceed it are shortened.
const STRETCH: f64 = 0.5;
/// Fraction of the decrease predicted by the slope that a step must achieve (Armijo's rule).
const ARMIJO: f64 = 1e-4;
/// Maximum number of step lengths that are tried in a step.
const TRIALS: usize = 12;
/// Number of consecutive steps that barely decrease the objective, after which a stage ends.
const IDLE: usize = 3;

/// Runs a stage that starts from the directions `at`. Updates the directions, and appends the stage's steps to the
/// flows.
pub(super) fn descend(
    group: &Group<'_>,
    stage: StageParams,
    params: &GroupwiseParams,
    at: &mut Vec<Vec<Vec3>>,
    flows: &mut [Flow],
    monitor: &dyn Monitor,
) -> Result<StageReport, ShapeError> {
    let mut delta = 0.0;
    let start = group.state(
        std::mem::take(at),
        |covariance| {
            delta = covariance.delta(params.delta);
            delta
        },
        &Vec::new(),
    )?;
    let mut state = start.ok_or(ShapeError::NoDecomposition)?;
    let first = (state.cost, state.variance());
    let mut method = Lbfgs::new(preconditioner(stage.field_degree, flows.len()));
    let mut gradient = group.gradient(&state)?;
    let (mut steps, mut evaluations, mut idle) = (0, 1, 0);
    while steps < stage.rounds && idle < IDLE {
        monitor.check()?;
        let mut direction = method.direction(&gradient);
        let mut slope = dot(&direction, &gradient);
        if slope >= 0.0 {
            method.forget();
            direction = method.direction(&gradient);
            slope = dot(&direction, &gradient);
        }
        if slope >= 0.0 {
            idle = IDLE;
            break;
        }
        let potentials = split(&direction, stage.field_degree);
        let fields = group.fields(&state, &potentials)?;
        let most = if method.is_fresh() { FIRST } else { FARTHEST };
        let mut t = cap(group, &state, &fields, most, method.is_fresh());
        let mut next = None;
        for _ in 0..TRIALS {
            let moved = state.at.iter().zip(&fields).map(|(at, field)| step(at, field, t)).collect();
            evaluations += 1;
            let found = group.state(moved, |_| delta, state.turns())?;
            match found {
                Some(found) if found.cost <= state.cost + ARMIJO * t * slope => {
                    next = Some(found);
                    break;
                }
                Some(found) => {
                    // Minimum of the parabola through the costs at 0 and t that has the initial slope.
                    let parabola = -0.5 * slope * t * t / (found.cost - state.cost - slope * t);
                    t = parabola.clamp(0.1 * t, 0.5 * t);
                }
                None => t *= 0.5,
            }
        }
        let Some(next) = next else {
            if method.is_fresh() {
                idle = IDLE;
                break;
            }
            method.forget();
            continue;
        };
        for (flow, potentials) in flows.iter_mut().zip(&potentials) {
            flow.push(potentials * t);
        }
        let after = group.gradient(&next)?;
        let change = after.iter().zip(&gradient).map(|(a, b)| a - b).collect();
        method.learn(direction.iter().map(|d| d * t).collect(), change);
        idle = if state.cost - next.cost < params.tolerance * flows.len() as f64 { idle + 1 } else { 0 };
        (state, gradient) = (next, after);
        steps += 1;
        monitor.step(1);
    }
    let report = StageReport {
        stage,
        steps,
        evaluations,
        cost: [first.0, state.cost],
        variance: [first.1, state.variance()],
        distortion: Distortion::of(&state, &group.elastic),
        converged: idle >= IDLE,
    };
    *at = state.at;
    Ok(report)
}

/// Returns the preconditioner's factor for each coefficient: `(l (l + 1))^-1.5` for degree l, and 0 for degree 0.
fn preconditioner(field_degree: usize, members: usize) -> Vec<f64> {
    let of_one: Vec<f64> = (0..basis_size(field_degree))
        .flat_map(|row| {
            let l = degree_order(row).0;
            let factor = if l == 0 { 0.0 } else { ((l * (l + 1)) as f64).powf(-1.5) };
            [factor; 2]
        })
        .collect();
    of_one.repeat(members)
}

/// Splits a vector of all members' coefficients into one array (K, 2) of potentials per member.
fn split(all: &[f64], field_degree: usize) -> Vec<Array2<f64>> {
    let rows = basis_size(field_degree);
    all.chunks_exact(2 * rows).map(|of_one| Array2::from_shape_fn((rows, 2), |(k, c)| of_one[2 * k + c])).collect()
}

/// Returns the largest allowed step length t, limited to 1 unless `to_the_full` is true. `most` is the largest angle by
/// which a direction may move.
fn cap(group: &Group<'_>, state: &State, fields: &[Vec<Vec3>], most: f64, to_the_full: bool) -> f64 {
    let (mut farthest, mut stretch) = (0.0_f64, 0.0_f64);
    for (at, field) in state.at.iter().zip(fields) {
        farthest = field.iter().fold(farthest, |farthest, w| farthest.max(inner(*w, *w)));
        for [a, b] in group.elastic.edges().filter(|[a, b]| a < b) {
            let (a, b) = (a as usize, b as usize);
            let (by, apart) = (sub(field[a], field[b]), sub(at[a], at[b]));
            stretch = stretch.max(inner(by, by) / inner(apart, apart));
        }
    }
    let longest = (most / farthest.sqrt()).min(STRETCH / stretch.sqrt());
    if to_the_full { longest } else { longest.min(1.0) }
}
