//! Solves the constrained optimisation problem of the equal-area map.
//!
//! > minimise  sum over edges w_ij |x_i - x_j|^2   over unit vectors x_i
//! > subject to  A_q = a_q for each of the Q quadrangles,
//! >             s >= S0 in each corner,
//!
//! where A_q is a quadrangle's solid angle, a_q its target area and w_ij the weights (`targets.rs`). For cubic voxels
//! a_q = 4 pi / Q and w_ij = 1. Each corner of a quadrangle has a value s: the determinant of the corner and its two
//! neighbours in the quadrangle, divided by a_q. s is 1 in a rectangle, and 0 if the angle at the corner is pi. Among
//! quadrangles of equal area the square has the shortest edges, so short edges mean little distortion of lengths and
//! angles. (Brechbuehler et al. maximise the sum of the cosines of the edges, which is equivalent.)
//!
//! # Method
//!
//! The method is an augmented Lagrangian (Nocedal and Wright, Numerical Optimization, 2006, section 17.3). Each round
//! minimises
//!
//! > L = sum w_ij |x_i - x_j|^2 / 2a + sum_q (m_q c_q + rho/2 c_q^2) + kappa/2 sum max(0, S0 - s)^2,
//!
//! where a is the mean target area, c_q = A_q / a_q - 1 the relative error of a quadrangle's area, m_q the multiplier
//! of its constraint, and rho and kappa are the weights of the penalties on areas and on angles. After the
//! minimisation, m_q is increased by rho c_q, and rho is doubled if the largest |c_q| hasn't halved. A round takes up
//! to five Gauss-Newton steps with Levenberg's damping in the tangent planes. A step solves a sparse positive definite
//! system with 2 unknowns per vertex and a pattern that is analysed once (Cholesky). A step is taken only if L
//! decreases. The penalty on angles is finite, so a map with folds has a finite L and can unfold.
//!
//! # Cost
//!
//! Linear in the number of vertices n, except for the Cholesky factor, which has O(n log n) entries. 2,400 vertices
//! take 0.6 s; 57,674 vertices take 20 s of processor time and 370 MB.

use rayon::prelude::*;
use spharm_linalg::{MatMut, SparseSum};
use spharm_monitor::{Interrupted, Monitor, Stage};

use super::targets::Targets;
use crate::background::abandonable;
use crate::error::ParametrizeError;
use crate::geometry::{Vec3, add, cross, dot, norm, orientation, scale, solid_angle, sub, unit};

/// A quadrangle's corner is penalised if its scaled determinant s is below this value.
const S0: f64 = 0.2;
/// The weight kappa of the penalty on angles: the initial value, and the maximum, reached only if folds persist.
const KAPPA: (f64, f64) = (20.0, 1e4);
/// The weight rho of the area constraints: the initial value and the maximum.
const RHO: (f64, f64) = (1.0, 1e3);
/// Largest number of Gauss-Newton steps per round.
const STEPS: usize = 5;
/// If the surface has at least this number of vertices, the factorisation runs on its own thread, so that it can be
/// interrupted.
const LONG: usize = 20_000;

/// Settings of [`equal_area`](crate::equal_area()).
#[derive(Clone, Debug, PartialEq)]
pub struct EqualAreaParams {
    /// The optimisation counts as converged only if the area of every quadrangle deviates from its target by at most
    /// this fraction. Default 1e-3.
    pub tolerance: f64,
    /// The optimisation counts as converged only if the sum of squared edge lengths changes by at most this fraction in
    /// a round. Default 1e-3.
    pub change: f64,
    /// Largest number of rounds, of up to five steps each. Default 100.
    pub rounds: usize,
}

impl Default for EqualAreaParams {
    fn default() -> Self {
        Self { tolerance: 1e-3, change: 1e-3, rounds: 100 }
    }
}

/// The optimised positions, the number of steps, and whether the tolerances were met.
pub(super) struct Found {
    pub(super) positions: Vec<Vec3>,
    pub(super) steps: usize,
    pub(super) converged: bool,
}

pub(super) fn optimise(
    quads: &[[u32; 4]],
    targets: &Targets,
    start: Vec<Vec3>,
    params: &EqualAreaParams,
    monitor: &dyn Monitor,
) -> Result<Found, ParametrizeError> {
    monitor.begin(Stage::counted("equal areas", "rounds"), 0);
    let system = System::new(quads, start.len())?;
    let mut positions = start;
    let mut lagrangian = Lagrangian::new(quads, targets);
    let mut damping = 1e-2;
    let (mut steps, mut worst, mut length) = (0, f64::INFINITY, f64::INFINITY);
    for round in 0..params.rounds {
        let mut value = lagrangian.value(&positions);
        for _ in 0..STEPS {
            steps += 1;
            let quads = lagrangian.derivatives(&positions);
            let taken = loop {
                let step = system.step(&quads, &positions, damping / lagrangian.area, monitor)?;
                let tried = step.map(|step| moved(&positions, &step));
                let new = tried.as_ref().map_or(f64::INFINITY, |tried| lagrangian.value(tried));
                if let Some(tried) = tried.filter(|_| new < value) {
                    damping = (damping / 4.0_f64).max(1e-9);
                    let gained = value - new;
                    (positions, value) = (tried, new);
                    break gained > 1e-6 * value.abs();
                }
                damping *= 8.0;
                if damping > 1e6 {
                    damping = 1e-2;
                    break false;
                }
            };
            if !taken {
                break;
            }
        }
        monitor.step(1);
        let state = lagrangian.state(&positions);
        let settled = (length - state.length).abs() <= params.change * state.length;
        if state.worst <= params.tolerance && state.folded == 0 && settled {
            monitor.end();
            return Ok(Found { positions, steps, converged: true });
        }
        lagrangian.update(&positions);
        if state.worst > 0.5 * worst {
            lagrangian.rho = (2.0 * lagrangian.rho).min(RHO.1);
        }
        if state.folded > 0 && round > 2 {
            lagrangian.kappa = (2.0 * lagrangian.kappa).min(KAPPA.1);
        }
        (worst, length) = (state.worst, state.length);
    }
    monitor.end();
    Ok(Found { positions, steps, converged: false })
}

/// Returns the positions after each vertex has been moved along its step and projected back onto the sphere.
fn moved(positions: &[Vec3], step: &[Vec3]) -> Vec<Vec3> {
    positions.iter().zip(step).map(|(&x, &d)| unit(add(x, d))).collect()
}

/// Quantities used by the convergence test.
#[derive(Debug)]
struct State {
    /// Largest relative deviation of a quadrangle's area from its target.
    worst: f64,
    /// Number of quadrangles that neither diagonal cuts into two positively oriented triangles.
    folded: usize,
    /// Sum of weighted squared edge lengths.
    length: f64,
}

struct Lagrangian<'a> {
    quads: &'a [[u32; 4]],
    targets: &'a Targets,
    multipliers: Vec<f64>,
    rho: f64,
    kappa: f64,
    /// The mean target area of a quadrangle, a.
    area: f64,
}

/// A quadrangle's contribution to the Lagrangian: the gradient, and the lower half of the Gauss-Newton matrix, over the
/// two tangent coordinates of each of its four vertices.
struct Part {
    gradient: [f64; 8],
    matrix: [f64; 36],
}

impl<'a> Lagrangian<'a> {
    fn new(quads: &'a [[u32; 4]], targets: &'a Targets) -> Self {
        let area = 4.0 * std::f64::consts::PI / quads.len() as f64;
        Self { quads, targets, multipliers: vec![0.0; quads.len()], rho: RHO.0, kappa: KAPPA.0, area }
    }

    fn corners(&self, positions: &[Vec3], q: usize) -> [Vec3; 4] {
        self.quads[q].map(|v| positions[v as usize])
    }

    fn constraint(&self, q: usize, p: [Vec3; 4]) -> f64 {
        (solid_angle([p[0], p[1], p[2]]) + solid_angle([p[0], p[2], p[3]])) / self.targets.areas[q] - 1.0
    }

    /// Returns the weighted sum of the squares of a quadrangle's sides.
    fn length(&self, q: usize, p: [Vec3; 4]) -> f64 {
        (0..4).map(|k| self.targets.weights[q][k] * square(sub(p[k], p[(k + 1) % 4]))).sum()
    }

    fn value(&self, positions: &[Vec3]) -> f64 {
        let of = |q: usize| {
            let p = self.corners(positions, q);
            let c = self.constraint(q, p);
            let edges = self.length(q, p);
            let short = |k: usize| (S0 - self.sine(q, &p, k)).max(0.0);
            let angles: f64 = (0..4).map(|k| short(k).powi(2)).sum();
            // Every edge belongs to two quadrangles, so each quadrangle contributes half of the edge's term.
            edges / (4.0 * self.area) + self.multipliers[q] * c + 0.5 * self.rho * c * c + 0.5 * self.kappa * angles
        };
        // The sum is taken in the order of the quadrangles, so that it doesn't depend on the number of threads.
        (0..self.quads.len()).into_par_iter().with_min_len(512).map(of).collect::<Vec<f64>>().iter().sum()
    }

    /// Returns s, the scaled determinant at corner k of quadrangle q (see the module's documentation).
    fn sine(&self, q: usize, p: &[Vec3; 4], k: usize) -> f64 {
        let (before, at, after) = (p[(k + 3) % 4], p[k], p[(k + 1) % 4]);
        dot(at, cross(sub(after, at), sub(before, at))) / self.targets.areas[q]
    }

    fn update(&mut self, positions: &[Vec3]) {
        for q in 0..self.quads.len() {
            let c = self.constraint(q, self.corners(positions, q));
            self.multipliers[q] += self.rho * c;
        }
    }

    fn state(&self, positions: &[Vec3]) -> State {
        let mut state = State { worst: 0.0, folded: 0, length: 0.0 };
        for q in 0..self.quads.len() {
            let p = self.corners(positions, q);
            state.worst = state.worst.max(self.constraint(q, p).abs());
            state.length += self.length(q, p) / 2.0;
            let good = |i: usize, j: usize, k: usize| orientation([p[i], p[j], p[k]]) > 0.0;
            let cut = (good(0, 1, 2) && good(0, 2, 3)) || (good(0, 1, 3) && good(1, 2, 3));
            state.folded += usize::from(!cut);
        }
        state
    }

    fn derivatives(&self, positions: &[Vec3]) -> Vec<Part> {
        (0..self.quads.len()).into_par_iter().with_min_len(256).map(|q| self.part(positions, q)).collect()
    }

    fn part(&self, positions: &[Vec3], q: usize) -> Part {
        let p = self.corners(positions, q);
        let bases = p.map(basis);
        let tangent = |g: [Vec3; 4]| -> [f64; 8] { std::array::from_fn(|i| dot(bases[i / 2][i % 2], g[i / 2])) };
        let mut part = Part { gradient: [0.0; 8], matrix: [0.0; 36] };

        // Adds half of each edge's term, because an edge belongs to two quadrangles. With edge weights w and mean area
        // a, the gradient at corner k is ((w_k + w_{k-1}) p_k - w_k p_{k+1} - w_{k-1} p_{k-1}) / 2a.
        let weight = 1.0 / (2.0 * self.area);
        let sides = self.targets.weights[q];
        let both = |k: usize| sides[k] + sides[(k + 3) % 4];
        let pull = |k: usize| {
            let (next, before) = ((k + 1) % 4, (k + 3) % 4);
            let neighbours = add(scale(p[next], sides[k]), scale(p[before], sides[before]));
            scale(sub(scale(p[k], both(k)), neighbours), weight)
        };
        part.add_gradient(1.0, &tangent([0, 1, 2, 3].map(pull)));
        for i in 0..8 {
            part.matrix[lower(i, i)] += both(i / 2) * weight;
        }
        for k in 0..4 {
            let next = (k + 1) % 4;
            for i in 0..2 {
                for j in 0..2 {
                    part.matrix[lower(2 * k + i, 2 * next + j)] -= weight * sides[k] * dot(bases[k][i], bases[next][j]);
                }
            }
        }

        // Adds the terms of the area constraint.
        let target = self.targets.areas[q];
        let c = self.constraint(q, p);
        let (one, two) = (solid_angle_gradient([p[0], p[1], p[2]]), solid_angle_gradient([p[0], p[2], p[3]]));
        let area = [add(one[0], two[0]), one[1], add(one[2], two[1]), two[2]];
        let area = tangent(area.map(|g| scale(g, 1.0 / target)));
        part.add_gradient(self.multipliers[q] + self.rho * c, &area);
        part.add_square(self.rho, &area);

        // Adds the penalty on angles.
        for k in 0..4 {
            let short = S0 - self.sine(q, &p, k);
            if short > 0.0 {
                let (before, after) = ((k + 3) % 4, (k + 1) % 4);
                let mut g = [[0.0; 3]; 4];
                g[before] = scale(cross(p[k], p[after]), 1.0 / target);
                g[k] = scale(cross(p[after], p[before]), 1.0 / target);
                g[after] = scale(cross(p[before], p[k]), 1.0 / target);
                let g = tangent(g);
                part.add_gradient(-self.kappa * short, &g);
                part.add_square(self.kappa, &g);
            }
        }
        part
    }
}

impl Part {
    fn add_gradient(&mut self, weight: f64, g: &[f64; 8]) {
        self.gradient.iter_mut().zip(g).for_each(|(sum, g)| *sum += weight * g);
    }

    fn add_square(&mut self, weight: f64, g: &[f64; 8]) {
        for i in 0..8 {
            for j in 0..=i {
                self.matrix[lower(i, j)] += weight * g[i] * g[j];
            }
        }
    }
}

/// Returns the index of entry (i, j) among the 36 entries in the lower half of a symmetric 8 x 8 matrix.
fn lower(i: usize, j: usize) -> usize {
    let (row, column) = (i.max(j), i.min(j));
    row * (row + 1) / 2 + column
}

fn square(a: Vec3) -> f64 {
    dot(a, a)
}

/// Returns two unit vectors perpendicular to a unit vector and to each other (T. Duff et al., "Building an orthonormal
/// basis, revisited", JCGT 6, 2017).
fn basis([x, y, z]: Vec3) -> [Vec3; 2] {
    let sign = 1.0_f64.copysign(z);
    let a = -1.0 / (sign + z);
    let b = x * y * a;
    [[1.0 + sign * x * x * a, sign * b, -sign * x], [b, sign + y * y * a, -y]]
}

/// Returns the derivative of a triangle's solid angle with respect to its corners, which lie on the unit sphere. The
/// solid angle is 2 atan (N / D), with N = det (a, b, c) and D = 1 + a . b + b . c + c . a.
fn solid_angle_gradient([a, b, c]: [Vec3; 3]) -> [Vec3; 3] {
    let n = dot(a, cross(sub(b, a), sub(c, a)));
    let d = 1.0 + dot(a, b) + dot(b, c) + dot(c, a);
    let weight = 2.0 / (n * n + d * d);
    let of = |u: Vec3, v: Vec3| scale(sub(scale(cross(u, v), d), scale(add(u, v), n)), weight);
    [of(b, c), of(c, a), of(a, b)]
}

/// The linear system of a Gauss-Newton step; its sparsity pattern is analysed once.
struct System<'a> {
    quads: &'a [[u32; 4]],
    pattern: SparseSum,
}

impl<'a> System<'a> {
    fn new(quads: &'a [[u32; 4]], vertices: usize) -> Result<Self, ParametrizeError> {
        let mut entries = Vec::with_capacity(36 * quads.len() + 2 * vertices);
        for quad in quads {
            let unknown = |i: usize| 2 * quad[i / 2] as usize + i % 2;
            for i in 0..8 {
                for j in 0..=i {
                    let (a, b) = (unknown(i), unknown(j));
                    entries.push([a.max(b), a.min(b)]);
                }
            }
        }
        entries.extend((0..2 * vertices).map(|i| [i, i]));
        let pattern = SparseSum::new(2 * vertices, &entries).ok_or_else(|| ParametrizeError::Argument {
            what: "linear system of the equal-area method",
            expected: "enough memory for its Cholesky factorisation",
            found: format!("too little memory for {vertices} vertices"),
        })?;
        Ok(Self { quads, pattern })
    }

    /// Returns the damped Gauss-Newton step of each vertex as a vector in space; `None` if the matrix isn't numerically
    /// positive definite.
    fn step(
        &self,
        parts: &[Part],
        positions: &[Vec3],
        damping: f64,
        monitor: &dyn Monitor,
    ) -> Result<Option<Vec<Vec3>>, Interrupted> {
        let n = 2 * positions.len();
        let mut values = Vec::with_capacity(36 * parts.len() + n);
        values.extend(parts.iter().flat_map(|part| part.matrix));
        values.extend(std::iter::repeat_n(damping, n));
        let mut solution = vec![0.0; n];
        for (quad, part) in self.quads.iter().zip(parts) {
            for (i, g) in part.gradient.iter().enumerate() {
                solution[2 * quad[i / 2] as usize + i % 2] -= g;
            }
        }
        let pattern = self.pattern.clone();
        let factor = abandonable(positions.len() >= LONG, monitor, move || pattern.factor(&values))?;
        let Some(factor) = factor else { return Ok(None) };
        factor.solve(MatMut::from_column_major_slice_mut(&mut solution, n, 1));
        let step = positions.iter().enumerate().map(|(v, &x)| {
            let [e, f] = basis(x);
            add(scale(e, solution[2 * v]), scale(f, solution[2 * v + 1]))
        });
        let step: Vec<Vec3> = step.collect();
        // For steps longer than about 0.5, the tangent planes don't approximate the sphere, so steps are shortened.
        let longest = step.iter().map(|&d| norm(d)).fold(0.0, f64::max);
        let shrink = (0.5 / longest).min(1.0);
        Ok(longest.is_finite().then(|| step.into_iter().map(|d| scale(d, shrink)).collect()))
    }
}
