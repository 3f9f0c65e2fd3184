//! Computes directions of descent from the gradients of the last steps by the limited-memory BFGS method.
//!
//! The method stores pairs of a step s and the change y of the gradient along this step. Two loops over these pairs
//! apply an approximate inverse Hessian, whose initial value is `gamma P` (J. Nocedal, "Updating quasi-Newton matrices
//! with limited storage", Math. Comp. 35, 1980). P is a diagonal matrix given by the caller, and gamma is `s.y / y.P y`
//! for the last pair.
//!
//! A step composes a map with the exponential of a field, so the gradients before and after the step are covectors at
//! different maps. They are used without parallel transport, because fields on the fixed sphere form a single vector
//! space for all maps.
//!
//! Cost: `4 PAIRS` operations on whole vectors per direction of descent. The order of summation doesn't depend on the
//! number of threads.

use std::collections::VecDeque;

/// Maximum number of stored pairs of a step and a change of the gradient.
const PAIRS: usize = 12;

/// State of the method: the preconditioner, and triples of a step, the change of the gradient, and the inner product of
/// both.
pub(super) struct Lbfgs {
    preconditioner: Vec<f64>,
    pairs: VecDeque<(Vec<f64>, Vec<f64>, f64)>,
}

impl Lbfgs {
    /// Creates the state of L-BFGS before the first step, without stored pairs. `preconditioner` is the diagonal of the
    /// initial inverse Hessian, up to a factor.
    pub(super) fn new(preconditioner: Vec<f64>) -> Self {
        Self { preconditioner, pairs: VecDeque::new() }
    }

    /// Returns whether no pairs are stored.
    pub(super) fn is_fresh(&self) -> bool {
        self.pairs.is_empty()
    }

    pub(super) fn forget(&mut self) {
        self.pairs.clear();
    }

    /// Adds a step and the change of the gradient along it; pairs without positive curvature are ignored.
    pub(super) fn learn(&mut self, step: Vec<f64>, change: Vec<f64>) {
        let curvature = dot(&step, &change);
        if curvature > 1e-10 * (dot(&step, &step) * dot(&change, &change)).sqrt() {
            if self.pairs.len() == PAIRS {
                self.pairs.pop_front();
            }
            self.pairs.push_back((step, change, curvature));
        }
    }

    /// Returns the search direction: minus the approximate inverse Hessian times `gradient`.
    pub(super) fn direction(&self, gradient: &[f64]) -> Vec<f64> {
        let mut r = gradient.to_vec();
        let mut along = Vec::with_capacity(self.pairs.len());
        for (s, y, curvature) in self.pairs.iter().rev() {
            let a = dot(s, &r) / curvature;
            r.iter_mut().zip(y).for_each(|(r, y)| *r -= a * y);
            along.push(a);
        }
        let gamma = self.pairs.back().map_or(1.0, |(_, y, curvature)| {
            curvature / y.iter().zip(&self.preconditioner).map(|(y, p)| y * p * y).sum::<f64>()
        });
        r.iter_mut().zip(&self.preconditioner).for_each(|(r, p)| *r *= gamma * p);
        for ((s, y, curvature), a) in self.pairs.iter().zip(along.into_iter().rev()) {
            let b = dot(y, &r) / curvature;
            r.iter_mut().zip(s).for_each(|(r, s)| *r += (a - b) * s);
        }
        r.iter_mut().for_each(|r| *r = -*r);
        r
    }
}

/// Returns the inner product of two vectors.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The minimum of a quadratic function of n unknowns is reached after n exact line searches.
    #[test]
    fn a_quadratic_is_minimised_in_as_many_steps_as_it_has_unknowns() {
        let hessian = [1.0, 10.0, 100.0, 3.0];
        let gradient = |x: &[f64]| -> Vec<f64> { x.iter().zip(hessian).map(|(x, h)| x * h).collect() };
        let (mut x, mut method) = (vec![1.0, -2.0, 0.5, 4.0], Lbfgs::new(vec![1.0, 0.5, 0.1, 1.0]));
        for _ in 0..4 {
            let g = gradient(&x);
            let d = method.direction(&g);
            let t = -dot(&g, &d) / d.iter().zip(hessian).map(|(d, h)| d * d * h).sum::<f64>();
            let step: Vec<f64> = d.iter().map(|d| t * d).collect();
            x.iter_mut().zip(&step).for_each(|(x, s)| *x += s);
            method.learn(step, gradient(&x).iter().zip(&g).map(|(a, b)| a - b).collect());
        }
        assert!(x.iter().all(|x| x.abs() < 1e-10), "{x:?}");
    }
}
