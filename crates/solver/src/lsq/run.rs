//! Executes the steps of a plan, and reports on them.

use std::time::Instant;

use ndarray::Array2;
use spharm_monitor::{Level, Monitor};

use super::cg::{Cg, CgParams, Stop};
use super::columns::dots;
use super::cost::moment_accuracy;
use super::limits::ITERATIONS_WITHOUT_GAIN;
use super::plan::{Leave, Plan, Precondition, Step};
use super::problem::{Moments, Problem};
use super::progress::Progress;
use super::report::{LsqWarning, StepReport};
use super::solver::{Given, LsqSolver, Solution};
use crate::SolverError;

/// A finished step: its name, its preconditioner and the reason why it was chosen.
pub(super) struct Done<'a> {
    pub(super) name: &'static str,
    pub(super) preconditioner: &'static str,
    pub(super) why: &'a dyn std::fmt::Display,
}

impl<'a> Done<'a> {
    pub(super) fn new(name: &'static str, preconditioner: &'static str, why: &'a dyn std::fmt::Display) -> Self {
        Self { name, preconditioner, why }
    }
}

/// The steps taken so far, and the number of iterations and the time at the end of the last step.
pub(super) struct Taken {
    steps: Vec<StepReport>,
    iterations: usize,
    since: Instant,
}

impl Taken {
    fn new() -> Self {
        Self { steps: Vec::new(), iterations: 0, since: Instant::now() }
    }

    /// Adds a finished step. `left` is the reason why the step ended early, if it did.
    pub(super) fn add(&mut self, step: Done<'_>, cg: &Cg, left: Option<String>) {
        let iterations = cg.iterations.saturating_sub(self.iterations);
        self.add_of(step, iterations, cg, left);
    }

    /// Adds a finished step like [`add`](Self::add), but with a number of `iterations` that `cg` doesn't include, such
    /// as refinements.
    pub(super) fn add_of(&mut self, step: Done<'_>, iterations: usize, cg: &Cg, left: Option<String>) {
        let Done { name, preconditioner, why } = step;
        let (seconds, optimality, why) = (self.since.elapsed().as_secs_f64(), cg.optimality(), why.to_string());
        self.steps.push(StepReport { name, preconditioner, why, fits: 1, iterations, seconds, optimality, left });
        (self.iterations, self.since) = (cg.iterations, Instant::now());
    }
}

impl LsqSolver<'_> {
    /// Executes the steps of a plan.
    pub(super) fn run(
        &mut self,
        plan: &Plan,
        given: Given<'_>,
        monitor: &dyn Monitor,
    ) -> Result<(Cg, Solution, Vec<StepReport>), SolverError> {
        let mut taken = Taken::new();
        let mut steps = plan.steps.iter().zip(&plan.why);
        let mut cg = match (plan.steps.first(), given) {
            // Computing the moments may also yield the right-hand sides.
            (Some(Step::MakeMoments), Given::Targets(_, targets)) => {
                let right_sides = self.take_moments_of_fit(Some(targets), monitor)?;
                let cg = right_sides.map_or_else(|| Cg::new(&*self.problem(given)), |b| Ok(Cg::from_right_sides(b)))?;
                let (_, why) = steps.next().expect("the plan has a first step");
                taken.add(Done::new("moments", "none", why), &cg, None);
                cg
            }
            _ => Cg::new(&*self.problem(given))?,
        };
        let mut ended = (Stop::IterationLimit, Precondition::Diagonal);
        let mut has_factor = false;
        for (step, why) in steps {
            match step {
                Step::MakeMoments => {
                    self.take_moments_of_fit(None, monitor)?;
                    taken.add(Done::new("moments", "none", why), &cg, None);
                }
                &Step::Cg { precondition, at_most, leave_for_factor, .. } => {
                    let stop = self.iterate(&mut cg, precondition, at_most, leave_for_factor, given, monitor)?;
                    ended = (stop, precondition);
                    // The user's limit on iterations applies to the entire fit: if it is reached, the fit doesn't
                    // switch to a factor.
                    let over = stop != Stop::IterationLimit || cg.iterations >= self.params.max_iterations;
                    let left = match (stop, over) {
                        (Stop::Converged, _) => None,
                        (Stop::Stalled, _) => Some("the optimality stopped improving"),
                        (Stop::IterationLimit, true) => Some("the maximum number of iterations was reached"),
                        (Stop::IterationLimit, false) if leave_for_factor.is_some() => {
                            Some("a factorisation seems faster")
                        }
                        (Stop::IterationLimit, false) => Some("moments are faster from here on"),
                    };
                    let name = self.preconditioner(precondition).name();
                    taken.add(Done::new(self.name_of_iterations(given), name, why), &cg, left.map(str::to_owned));
                    if over {
                        break;
                    }
                }
                Step::Factor { required, .. } => {
                    has_factor = self.make_factor(*required, monitor)?;
                    let refused = self.warnings.last().filter(|_| !has_factor).map(ToString::to_string);
                    taken.add(Done::new("factor", "none", why), &cg, refused);
                }
                Step::Refine if has_factor => {
                    let solution = self.refine(&mut cg, &*self.problem(given), &mut taken, monitor)?;
                    return Ok((cg, solution, taken.steps));
                }
                Step::Refine => {}
            }
        }
        let (stop, precondition) = ended;
        let solution = self.confirm(&mut cg, stop, precondition, given, &mut taken, monitor)?;
        Ok((cg, solution, taken.steps))
    }

    fn iterate(
        &self,
        cg: &mut Cg,
        precondition: Precondition,
        at_most: usize,
        leave_for_factor: Option<Leave>,
        given: Given<'_>,
        monitor: &dyn Monitor,
    ) -> Result<Stop, SolverError> {
        let params = CgParams { max_iterations: at_most.saturating_sub(cg.iterations), ..self.cg_params() };
        let density = precondition == Precondition::Density && self.inverse_density().is_some();
        let progress = leave_for_factor.map(|leave| Progress::new(&leave, density, params.tolerance, cg.optimality()));
        cg.run_while(&*self.problem(given), &*self.preconditioner(precondition), &params, progress, monitor)
    }

    /// Confirms the result of iterations: recomputes the gradient if necessary, and corrects errors that the gradient
    /// reveals.
    fn confirm(
        &mut self,
        cg: &mut Cg,
        stop: Stop,
        precondition: Precondition,
        given: Given<'_>,
        taken: &mut Taken,
        monitor: &dyn Monitor,
    ) -> Result<Solution, SolverError> {
        let params = self.cg_params();
        let preconditioner = self.preconditioner(precondition);
        let (mut stop, mut residual) = cg.confirm(stop, &*self.problem(given), &*preconditioner, &params, monitor)?;
        let mut name = preconditioner.name();
        let too_far = stop != Stop::Converged && further_than_zero(cg, &*self.problem(given))?;
        let digits_lost = stop == Stop::Converged && cg.optimality() > 1.5 * params.tolerance && self.moments.is_some();
        let wrong = match (too_far, digits_lost) {
            (true, _) => Some("rounding errors made the solution diverge"),
            (false, true) => Some("rounding errors in the moments limit the accuracy"),
            (false, false) => None,
        };
        let why = "checks the gradient for accumulated rounding errors";
        taken.add(Done::new("confirmation", name, &why), cg, wrong.map(str::to_owned));
        if too_far {
            // Rounding errors have dominated: repeat the iterations, but only up to the iteration with the best
            // optimality.
            let before = cg.iterations;
            let first = CgParams { max_iterations: cg.best_at, ..params };
            *cg = Cg::new(&*self.problem(given))?;
            cg.run(&*self.problem(given), &*preconditioner, &first, monitor)?;
            (_, residual) = cg.confirm(Stop::Stalled, &*self.problem(given), &*preconditioner, &params, monitor)?;
            if further_than_zero(cg, &*self.problem(given))? {
                *cg = Cg::new(&*self.problem(given))?;
                (_, residual) = cg.confirm(Stop::Stalled, &*self.problem(given), &*preconditioner, &params, monitor)?;
            }
            cg.iterations += before;
            taken.add(Done::new("iterations from zero", name, &"rounding errors made the solution diverge"), cg, None);
        }
        drop(preconditioner);
        if digits_lost {
            self.warnings.push(LsqWarning::MomentsLoseDigits { optimality: cg.optimality() });
            (self.moments, self.make_moments) = (None, None);
            let preconditioner = self.preconditioner(Precondition::Diagonal);
            let left = CgParams { max_iterations: params.max_iterations - cg.iterations, ..params };
            stop = cg.run(&*self.problem(given), &*preconditioner, &left, monitor)?;
            (stop, residual) = cg.confirm(stop, &*self.problem(given), &*preconditioner, &params, monitor)?;
            name = preconditioner.name();
            let why = "rounding errors in the moments limit the accuracy";
            taken.add(Done::new(self.name_of_iterations(given), name, &why), cg, None);
        }
        Ok(Solution { stop, preconditioner: name, refinements: None, residual })
    }

    fn name_of_iterations(&self, given: Given<'_>) -> &'static str {
        match given {
            Given::Targets(..) if self.moments.is_none() => "iterations by samples",
            _ => "iterations by moments",
        }
    }

    pub(super) fn cg_params(&self) -> CgParams {
        let (tolerance, max_iterations) = (self.params.tolerance, self.params.max_iterations);
        CgParams { tolerance, max_iterations, patience: ITERATIONS_WITHOUT_GAIN }
    }

    /// Computes the moments of a fit, and the inverse of the density if the fit needs it. Returns the right-hand sides
    /// (K, c) of the targets if they were computed together with the moments.
    fn take_moments_of_fit(
        &mut self,
        targets: Option<&Array2<f64>>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Array2<f64>>, SolverError> {
        let started = Instant::now();
        let right_sides = self.take_moments(moment_accuracy(self.params.tolerance), targets, monitor)?;
        // Compute the inverse of the density now, if it is needed, so that its time is included in `moment_seconds`.
        let _ = self.inverse_density();
        self.moment_seconds = started.elapsed().as_secs_f64();
        Ok(right_sides)
    }

    /// Computes moments of at least the given accuracy. Returns the right-hand sides (K, c) of the targets if they were
    /// computed together with the moments.
    pub(super) fn take_moments(
        &mut self,
        accuracy: f64,
        targets: Option<&Array2<f64>>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Array2<f64>>, SolverError> {
        let Some(make) = self.make_moments else { return Ok(None) };
        monitor.note(Level::Status, format_args!("computing moments"));
        let (normal, right_sides) = make(accuracy, targets)?;
        self.moments = Some(Moments { normal, accuracy });
        Ok(right_sides)
    }
}

/// Returns whether the squared residual of a column, including the penalty, is larger for x than for x = 0. The
/// difference is `|W^(1/2) (f - A x)|^2 + x^T P x - |W^(1/2) f|^2 = -x^T (b + r)`, with the right-hand side b and the
/// gradient `r = b - N x`.
fn further_than_zero(cg: &Cg, problem: &dyn Problem) -> Result<bool, SolverError> {
    let sum = problem.right_sides()? + &cg.gradient;
    Ok(dots(&cg.x, &sum).iter().any(|gain| *gain < 0.0))
}
