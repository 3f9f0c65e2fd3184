//! Refines an alignment, starting from a rotation near the best one.
//!
//! Let f and g be the coefficients of two surfaces, with norm 1 and without row 0. The refinement maximises `<g, Q (R
//! f)>` over the rotations R of the parameters and Q of space. Q follows from R in closed form
//! ([`kabsch`](spharm_surface::kabsch)). Around (R, Q), for rotation vectors w and v,
//!
//! ```text
//! phi(w, v) = -<g, exp(v x) Q exp(-w.L) R f>
//! ```
//!
//! has gradient and second derivatives that are sums of 3 x 3 products of g, R f and their [infinitesimal
//! rotations](crate::derivatives), at a cost of `O(K)`. In the formula, `v x` is the cross product with v, and `w.L` is
//! the sum of w_k L_k.
//!
//! The steps are Newton steps with Levenberg's damping, which keeps steps short far from the optimum. The metric of the
//! damping consists of the squared norms of the derivatives of R f and Q R f with respect to the six rotation angles.
//! The matrix of second derivatives is used instead of the Gauss-Newton matrix, so convergence is quadratic even if the
//! surfaces differ. If g = Q R f, the two matrices are equal. If the pose is known ([`Space::Fixed`]), only R varies.

use spharm_monitor::Monitor;

use crate::derivatives::generators;
use crate::half_turn::Workspace;
use crate::matrix3::{IDENTITY, Matrix3, determinant, dot, product, transposed};
use crate::rotate::Rotator;
use crate::rotation::Rotation;
use spharm_surface::kabsch::{kabsch, svd};

/// A surface to which other surfaces are aligned.
#[derive(Debug)]
pub(crate) struct Target {
    /// Coefficients (K, 3) of norm 1, with row 0 set to zero.
    pub(crate) rows: Vec<[f64; 3]>,
    generators: [Vec<[f64; 3]>; 3],
}

impl Target {
    pub(crate) fn new(rows: Vec<[f64; 3]>) -> Self {
        Self { generators: generators(&rows), rows }
    }
}

/// Result of a refinement.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Fit {
    /// Rotation R of the parameters.
    pub(crate) rotation: Rotation,
    /// Rotation Q of space; a reflection only if allowed.
    pub(crate) orthogonal: Matrix3,
    /// Distance |Q R f - g| after the refinement.
    pub(crate) distance: f64,
    /// Smallest second derivative of the distance along any direction in the space of rotations, divided by the squared
    /// length of the direction. It is about zero if some rotation leaves the distance unchanged.
    pub(crate) stiffness: f64,
    /// Singular values of the 3 x 3 matrix `sum g (R f)^T`, a sum over the coefficients of f and g. The last singular
    /// value has the sign of the determinant.
    pub(crate) singular_values: [f64; 3],
}

/// Maximum number of steps; about a dozen are typical.
const STEPS: usize = 60;
/// The refinement ends after a step shorter than this length, in radians, because the length of the next step would be
/// of the order of the square of this length.
const LAST: f64 = 1e-9;

/// State of a refinement: a rotation R, the rotated coefficients R f, and their distance from the target.
struct State {
    rotation: Rotation,
    rows: Vec<[f64; 3]>,
    correlation: Matrix3,
    orthogonal: Matrix3,
    distance: f64,
}

/// Matrices allowed for the rotation Q of space.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Space {
    /// All rotations.
    Turned,
    /// All rotations and reflections.
    Mirrored,
    /// The identity only: the pose is known.
    Fixed,
}

impl Space {
    /// Returns [`Self::Mirrored`] if `mirror` is set, otherwise [`Self::Turned`].
    pub(crate) fn free(mirror: bool) -> Self {
        if mirror { Self::Mirrored } else { Self::Turned }
    }

    /// Returns the best allowed matrix Q for a correlation matrix.
    pub(crate) fn best(self, correlation: &Matrix3) -> Matrix3 {
        match self {
            Self::Fixed => IDENTITY,
            _ => kabsch(correlation, self == Self::Mirrored),
        }
    }
}

/// Refines the alignment of the surface `f` to a target, starting from the rotation `start`. `f` is (K, 3) and has norm
/// 1, with row 0 set to zero. Stops early if the monitor cancels. The caller has to check whether the monitor
/// cancelled.
pub(crate) fn refine(
    rotator: &Rotator,
    f: &[[f64; 3]],
    target: &Target,
    start: Rotation,
    space: Space,
    workspace: &mut Workspace,
    monitor: &dyn Monitor,
) -> Fit {
    let mut at = |rotation: Rotation| {
        let mut rows = vec![[0.0; 3]; f.len()];
        rotator.rotate(f, &rotation, &mut rows, workspace);
        let correlation = outer(&target.rows, &rows);
        let orthogonal = space.best(&correlation);
        let distance = distance(&rows, &orthogonal, &target.rows);
        State { rotation, rows, correlation, orthogonal, distance }
    };
    let mut state = at(start);
    let mut damping = 0.0;
    let mut model = Model::of(&state, target, space);
    for _ in 0..STEPS {
        if monitor.cancelled() {
            break;
        }
        let mut next = None;
        let mut size = 0.0;
        for _ in 0..16 {
            if let Some(step) = model.step(damping) {
                size = step.iter().map(|v| v * v).sum::<f64>().sqrt();
                let trial = at(Rotation::exponential([step[0], step[1], step[2]]) * state.rotation);
                // Near the optimum, differences between distances are rounding errors. A tiny step is therefore not
                // damped further, even if the distance doesn't decrease.
                if trial.distance < state.distance || size < LAST {
                    next = Some(trial);
                    break;
                }
            }
            damping = (damping * 8.0_f64).max(1e-4);
        }
        let Some(next) = next else { break };
        let better = next.distance <= state.distance;
        if better {
            state = next;
        }
        if !better || size < LAST {
            break;
        }
        damping = if damping > 1e-6 { damping / 10.0 } else { 0.0 };
        model = Model::of(&state, target, space);
    }
    let values = svd(&state.correlation).values;
    let sign = if determinant(&state.correlation) < 0.0 { -1.0 } else { 1.0 };
    Fit {
        rotation: state.rotation,
        orthogonal: state.orthogonal,
        distance: state.distance,
        stiffness: Model::of(&state, target, space).stiffness(),
        singular_values: [values[0], values[1], sign * values[2]],
    }
}

/// Returns the distance |Q f - g|.
pub(crate) fn distance(f: &[[f64; 3]], orthogonal: &Matrix3, g: &[[f64; 3]]) -> f64 {
    let square = |(f, g): (&[f64; 3], &[f64; 3])| -> f64 {
        (0..3).map(|i| dot(&orthogonal[i], f) - g[i]).map(|difference| difference * difference).sum()
    };
    f.iter().zip(g).map(square).sum::<f64>().sqrt()
}

/// Returns the sum of g f^T over all rows.
pub(crate) fn outer(g: &[[f64; 3]], f: &[[f64; 3]]) -> Matrix3 {
    let mut sum = [[0.0; 3]; 3];
    for (g, f) in g.iter().zip(f) {
        for i in 0..3 {
            for j in 0..3 {
                sum[i][j] += g[i] * f[j];
            }
        }
    }
    sum
}

/// Quadratic model of the objective phi in the rotation vectors (w, v), which are defined in the [module](self).
#[derive(Debug)]
struct Model {
    gradient: [f64; 6],
    hessian: [[f64; 6]; 6],
    /// Squared norms of the derivatives of the surface's coefficients with respect to the six rotation angles: three of
    /// the parameters, then three of space.
    metric: [f64; 6],
}

impl Model {
    fn of(state: &State, target: &Target, space: Space) -> Self {
        let q = &state.orthogonal;
        let trace = |m: &Matrix3| -> f64 { (0..3).map(|i| dot(&q[i], &m[i])).sum() };
        let own = generators(&state.rows);
        let mut model = Self { gradient: [0.0; 6], hessian: [[0.0; 6]; 6], metric: [0.0; 6] };
        // The matrix N = sum g (Q R f)^T, over the rows g of the target and R f of the rotated surface, is symmetric
        // because Q is the best rotation.
        let n = product(&state.correlation, &transposed(q));
        let total = n[0][0] + n[1][1] + n[2][2];
        let norms: [f64; 3] = std::array::from_fn(|c| state.rows.iter().map(|row| dot(&q[c], row).powi(2)).sum());
        for i in 0..3 {
            let along = outer(&target.rows, &own[i]);
            model.gradient[i] = trace(&along);
            model.metric[i] = own[i].iter().map(|row| dot(row, row)).sum();
            model.metric[3 + i] = norms.iter().sum::<f64>() - norms[i];
            let p = product(&along, &transposed(q));
            for j in 0..3 {
                let both = trace(&outer(&target.generators[i], &own[j])) / 2.0;
                model.hessian[i][j] += both;
                model.hessian[j][i] += both;
                model.hessian[3 + i][3 + j] = if i == j { total } else { 0.0 } - (n[i][j] + n[j][i]) / 2.0;
                // The mixed derivatives use <g, e_j x y> = g_k y_i - g_i y_k for vectors g and y, with i and k the two
                // axes after j.
                let (next, last) = ((j + 1) % 3, (j + 2) % 3);
                let mixed = p[last][next] - p[next][last];
                (model.hessian[i][3 + j], model.hessian[3 + j][i]) = (mixed, mixed);
            }
        }
        for j in 0..3 {
            let (next, last) = ((j + 1) % 3, (j + 2) % 3);
            model.gradient[3 + j] = -(n[last][next] - n[next][last]);
        }
        if space == Space::Fixed {
            model.hold_space();
        }
        model
    }

    /// Holds the rotation Q of space fixed: removes its coupling with the rotation R of the parameters, and sets its
    /// part of the gradient to zero.
    fn hold_space(&mut self) {
        for j in 3..6 {
            self.gradient[j] = 0.0;
            for i in 0..6 {
                (self.hessian[i][j], self.hessian[j][i]) = (0.0, 0.0);
            }
            self.hessian[j][j] = self.metric[j];
        }
    }

    /// Returns the damped step to the minimum of this quadratic model of the objective, or `None` if the model has no
    /// minimum.
    fn step(&self, damping: f64) -> Option<[f64; 6]> {
        // The floor makes the matrix positive definite even if the distance is constant along some direction.
        let floor = 1e-14 * self.metric.iter().sum::<f64>() + f64::MIN_POSITIVE;
        let mut l = self.hessian;
        for (i, row) in l.iter_mut().enumerate() {
            row[i] += (damping + 1e-12) * self.metric[i] + floor;
        }
        for j in 0..6 {
            for k in 0..j {
                for i in j..6 {
                    l[i][j] -= l[i][k] * l[j][k];
                }
            }
            if l[j][j] <= 0.0 {
                return None;
            }
            let root = l[j][j].sqrt();
            for row in &mut l[j..] {
                row[j] /= root;
            }
        }
        let mut x = self.gradient.map(|v| -v);
        for i in 0..6 {
            x[i] = (x[i] - (0..i).map(|k| l[i][k] * x[k]).sum::<f64>()) / l[i][i];
        }
        for i in (0..6).rev() {
            x[i] = (x[i] - (i + 1..6).map(|k| l[k][i] * x[k]).sum::<f64>()) / l[i][i];
        }
        Some(x)
    }

    /// Returns the smallest eigenvalue of the matrix of second derivatives, relative to the metric, computed by Jacobi
    /// rotations.
    fn stiffness(&self) -> f64 {
        let largest = self.metric.iter().fold(0.0_f64, |largest, &v| largest.max(v));
        if largest == 0.0 {
            return 0.0;
        }
        let unit = self.metric.map(|v| v.max(1e-12 * largest).sqrt());
        let mut a: [[f64; 6]; 6] =
            std::array::from_fn(|i| std::array::from_fn(|j| self.hessian[i][j] / (unit[i] * unit[j])));
        for _ in 0..30 {
            for p in 0..5 {
                for q in p + 1..6 {
                    if a[p][q].abs() < 1e-300 {
                        continue;
                    }
                    let zeta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                    let t = zeta.signum() / (zeta.abs() + (1.0 + zeta * zeta).sqrt());
                    let c = 1.0 / (1.0 + t * t).sqrt();
                    let s = t * c;
                    for row in &mut a {
                        (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
                    }
                    let (x, y) = (a[p], a[q]);
                    a[p] = std::array::from_fn(|k| c * x[k] - s * y[k]);
                    a[q] = std::array::from_fn(|k| s * x[k] + c * y[k]);
                }
            }
        }
        (0..6).map(|i| a[i][i]).fold(f64::INFINITY, f64::min)
    }
}
