//! Runs conjugate gradients on groups of a few columns.
//!
//! If products with the normal matrix process a few columns at a time anyway, the iterations for each group of columns
//! run to their end separately. This has three advantages: a group's arrays stay in a thread's cache from one step to
//! the next, threads wait for each other only once, and a converged group needs no further products. If the iterations
//! start from zero, a group's iterates are bit-identical to the iterates of a separate solve for this group.

use ndarray::{ArrayViewMut2, Axis};
use rayon::prelude::*;
use spharm_monitor::{Level, Monitor, OnlyCancel};

use super::{Cg, CgParams, Stop};
use crate::SolverError;
use crate::lsq::preconditioner::Preconditioner;
use crate::lsq::problem::Problem;
use crate::lsq::progress::Progress;

impl Cg {
    /// Iterates like [`steps`](Self::steps), but on `width` columns at a time. If the first group converges too slowly,
    /// the other groups are left unchanged.
    ///
    /// Reports the steps of a group to the monitor when the group's iterations have ended.
    pub(super) fn steps_of_groups(
        &mut self,
        width: usize,
        problem: &dyn Problem,
        preconditioner: &dyn Preconditioner,
        params: &CgParams,
        progress: Option<Progress>,
        monitor: &dyn Monitor,
    ) -> Result<Stop, SolverError> {
        let &mut Self { condition, doubt, .. } = self;
        let run = |mut group: Group<'_>| {
            let (x, gradient, scale) = (group.x.to_owned(), group.gradient.to_owned(), group.scale.to_vec());
            let mut cg = Self { x, gradient, scale, iterations: 0, best_at: 0, condition, doubt, seconds: 0.0 };
            let stop = cg.steps(problem, preconditioner, params, progress, &OnlyCancel(monitor))?;
            group.x.assign(&cg.x);
            group.gradient.assign(&cg.gradient);
            monitor.step(cg.iterations as u64);
            let optimality = cg.optimality();
            monitor.note(Level::Status, format_args!("{} iterations, optimality {optimality:.1e}", cg.iterations));
            Ok(Ended { stop, iterations: cg.iterations, best_at: cg.best_at, condition: cg.condition })
        };
        let columns =
            self.x.axis_chunks_iter_mut(Axis(1), width).zip(self.gradient.axis_chunks_iter_mut(Axis(1), width));
        let groups = columns.zip(self.scale.chunks(width));
        let mut groups: Vec<Group<'_>> = groups.map(|((x, gradient), scale)| Group { x, gradient, scale }).collect();
        let mut ended = Vec::with_capacity(groups.len());
        if progress.is_some() {
            // All groups have the same matrix, so the convergence of the first group shows whether to switch to a
            // factor for all groups.
            ended.push(run(groups.remove(0))?);
        }
        let given_up = |first: &Ended| first.stop == Stop::IterationLimit && first.iterations < params.max_iterations;
        if !ended.iter().any(given_up) {
            let others = groups.into_par_iter().with_max_len(1).map(run);
            ended.extend(others.collect::<Result<Vec<_>, SolverError>>()?);
        }
        // Each group that hasn't converged has an iteration at which its optimality was best. Keep the earliest of
        // these iterations, because a restarted run may have to end there.
        let before = self.iterations;
        let left = ended.iter().filter(|group| group.stop != Stop::Converged && group.best_at > 0);
        if let Some(best_at) = left.map(|group| before + group.best_at).min() {
            self.best_at = best_at;
        }
        self.iterations += ended.iter().map(|group| group.iterations).max().unwrap_or(0);
        self.condition = ended.iter().map(|group| group.condition).fold(condition, f64::max);
        let any = |stop: Stop| ended.iter().any(|group| group.stop == stop);
        Ok(match (any(Stop::IterationLimit), any(Stop::Stalled)) {
            (true, _) => Stop::IterationLimit,
            (false, true) => Stop::Stalled,
            (false, false) => Stop::Converged,
        })
    }
}

/// Arrays of a group of columns.
struct Group<'a> {
    x: ArrayViewMut2<'a, f64>,
    gradient: ArrayViewMut2<'a, f64>,
    scale: &'a [f64],
}

/// Result of the iterations for a group.
struct Ended {
    stop: Stop,
    iterations: usize,
    best_at: usize,
    condition: f64,
}
