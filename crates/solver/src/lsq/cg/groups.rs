//! Groups of columns, each iterated to its own end, side by side.
//!
//! Where a product with all columns is but products with a few of them, one after another, a group's arrays stay in a
//! thread's cache from one step to the next, threads wait for each other once, and a group that has converged takes no more
//! products. Its iterates are those that it has by itself, bit for bit.

use ndarray::{ArrayViewMut2, Axis};
use rayon::prelude::*;
use spharm_monitor::Monitor;

use super::{Cg, CgParams, Stop};
use crate::SolverError;
use crate::lsq::preconditioner::Preconditioner;
use crate::lsq::problem::Problem;
use crate::lsq::progress::Progress;

impl Cg {
    /// Iterates `width` columns after the others; otherwise as [`steps`](Self::steps).
    pub(super) fn steps_of_groups(
        &mut self,
        width: usize,
        problem: &dyn Problem,
        preconditioner: &dyn Preconditioner,
        params: &CgParams,
        progress: Option<Progress>,
        monitor: &dyn Monitor,
    ) -> Result<Stop, SolverError> {
        let (before, condition, doubt) = (self.iterations, self.condition, self.doubt);
        let run = |((x, gradient), scale): ((ArrayViewMut2<'_, f64>, ArrayViewMut2<'_, f64>), &[f64])| {
            let (own_x, own_gradient, scale) = (x.to_owned(), gradient.to_owned(), scale.to_vec());
            let mut cg = Self {
                x: own_x,
                gradient: own_gradient,
                scale,
                iterations: 0,
                best_at: 0,
                condition,
                doubt,
                seconds: 0.0,
            };
            let stop = cg.steps(problem, preconditioner, params, progress, monitor)?;
            { x }.assign(&cg.x);
            { gradient }.assign(&cg.gradient);
            Ok(Group { stop, iterations: cg.iterations, best_at: cg.best_at, condition: cg.condition })
        };
        let xs = self.x.axis_chunks_iter_mut(Axis(1), width).into_par_iter();
        let gradients = self.gradient.axis_chunks_iter_mut(Axis(1), width).into_par_iter();
        let groups: Vec<Group> = xs
            .zip(gradients)
            .zip(self.scale.par_chunks(width))
            .with_max_len(1)
            .map(run)
            .collect::<Result<_, SolverError>>()?;
        self.iterations = before + groups.iter().map(|group| group.iterations).max().unwrap_or(0);
        self.condition = groups.iter().map(|group| group.condition).fold(condition, f64::max);
        // Of those that are not there: what they are to go back to.
        let left = groups.iter().filter(|group| group.stop != Stop::Converged);
        self.best_at = before + left.map(|group| group.best_at).min().unwrap_or(self.iterations - before);
        let any = |stop: Stop| groups.iter().any(|group| group.stop == stop);
        Ok(if any(Stop::IterationLimit) {
            Stop::IterationLimit
        } else if any(Stop::Stalled) {
            Stop::Stalled
        } else {
            Stop::Converged
        })
    }
}

/// How a group ended.
struct Group {
    stop: Stop,
    iterations: usize,
    best_at: usize,
    condition: f64,
}
