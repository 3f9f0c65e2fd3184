//! Directions of descent from the gradients of the last steps: the limited-memory BFGS method.
//!
//! J. Nocedal, "Updating quasi-Newton matrices with limited storage", Math. Comp. 35 (1980): with steps s and changes
//! of the gradient y, the inverse Hessian that they show, over a first one `gamma P`, is applied by two loops; here P
//! is a diagonal of the caller's, and `gamma = s.y / y.P y` of the last pair.
//!
//! A step composes a map with the exponential of a field, so that gradients before and after it are covectors at
//! different maps. They are taken as they are: fields that are fixed on the sphere make up one vector space for all
//! maps.
//!
//! Cost: `4 PAIRS` products a direction. Sums are in one order, whatever the threads.

use std::collections::VecDeque;

/// Pairs that are kept.
const PAIRS: usize = 12;

/// Pairs of steps and changes of the gradient.
pub(super) struct Lbfgs {
    preconditioner: Vec<f64>,
    pairs: VecDeque<(Vec<f64>, Vec<f64>, f64)>,
}

impl Lbfgs {
    /// With the diagonal of the first inverse Hessian, up to scale.
    pub(super) fn new(preconditioner: Vec<f64>) -> Self {
        Self { preconditioner, pairs: VecDeque::new() }
    }

    /// Whether nothing but the preconditioner is known.
    pub(super) fn is_fresh(&self) -> bool {
        self.pairs.is_empty()
    }

    pub(super) fn forget(&mut self) {
        self.pairs.clear();
    }

    /// Takes a step and the change of the gradient along it; pairs without positive curvature are left out.
    pub(super) fn learn(&mut self, step: Vec<f64>, change: Vec<f64>) {
        let curvature = dot(&step, &change);
        if curvature > 1e-10 * (dot(&step, &step) * dot(&change, &change)).sqrt() {
            if self.pairs.len() == PAIRS {
                self.pairs.pop_front();
            }
            self.pairs.push_back((step, change, curvature));
        }
    }

    /// Minus the inverse Hessian times a gradient.
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

/// The inner product.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A quadratic of n unknowns is at its minimum after n exact line searches.
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
