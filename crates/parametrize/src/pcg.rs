//! Solves the linear systems of Newton steps by conjugate gradients with a two-grid preconditioner.
//!
//! A cycle of the preconditioner consists of two steps of Chebyshev's smoother, a correction in the coarse space
//! (`coarse.rs`), and two more smoothing steps. The smoother uses the inverses D^-1 of the 2 x 2 diagonal blocks of the
//! matrix H. For any triangulation the eigenvalues of D^-1 H are at most 3, since H is a sum of positive semidefinite
//! matrices, each of which couples only the three corners of a triangle.
//!
//! Memory and work per iteration are linear in the number of vertices. For any number of vertices, about ten iterations
//! reduce the error, measured in the energy of the quadratic model, to a hundredth.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use crate::blocks::Pattern;
use crate::coarse::Coarse;
use crate::geometry::Vec3;
use crate::sparse_cholesky::Factor;

/// A vector with two unknowns per vertex.
type Vector = Vec<[f64; 2]>;

/// Number of matrix rows per parallel task.
const ROWS: usize = 2048;

/// Number of smoothing steps before the coarse correction, and again after it.
const SMOOTHING: usize = 2;

/// Range of the eigenvalues of D^-1 H whose error components the smoother damps, with H the matrix and D its 2 x 2
/// diagonal blocks. No eigenvalue is above the range.
const RANGE: [f64; 2] = [0.3, 3.0];

/// Largest number of iterations of conjugate gradients.
const ITERATIONS: usize = 100;

/// The iterations end when the residual's norm, in the preconditioner's inner product, falls below this fraction of its
/// initial value.
const REDUCTION: f64 = 0.01;

/// Counts the matrix blocks that are multiplied. Used by tests.
#[cfg(test)]
fn multiplied(blocks: usize) {
    tests::MULTIPLIED.with(|count| count.set(count.get() + blocks));
}

/// Does nothing outside of tests.
#[cfg(not(test))]
fn multiplied(_: usize) {}

/// A linear system H x = -gradient, and its preconditioner.
pub(crate) struct System<'a> {
    pub(crate) pattern: &'a Pattern,
    /// The blocks of H in single precision, which is accurate enough for a search direction.
    pub(crate) blocks: Vec<[f32; 4]>,
    pub(crate) coarse: &'a Coarse,
    /// Cholesky factor of the coarse matrix, computed from the Hessian H of this Newton step or of an earlier one.
    pub(crate) factor: &'a Factor,
    /// For each vertex, the two rows that [`turns`](crate::coarse::turns) returns for its position.
    pub(crate) turns: &'a [[Vec3; 2]],
}

/// Memory reused by all cycles of the preconditioner.
struct Workspace {
    inverses: Vec<[f64; 3]>,
    rest: Vector,
    change: Vector,
}

impl System<'_> {
    /// Solves H x = -gradient approximately. Returns x and the number of iterations.
    pub(crate) fn solve(&self, gradient: &[[f64; 2]], monitor: &dyn Monitor) -> Result<(Vector, usize), Interrupted> {
        let n = gradient.len();
        let zero = || vec![[0.0; 2]; n];
        let mut work = Workspace { inverses: self.inverses(), rest: zero(), change: zero() };
        let mut x = zero();
        let mut r: Vector = gradient.iter().map(|[a, b]| [-a, -b]).collect();
        let mut z = zero();
        self.cycle(&mut work, &r, &mut z);
        let mut p = z.clone();
        let mut hp = zero();
        let mut product = dot(&r, &z);
        let enough = REDUCTION * REDUCTION * product;
        for iteration in 0..ITERATIONS {
            monitor.check()?;
            if !(product > enough && product.is_finite()) {
                return Ok((x, iteration));
            }
            self.times(&p, &mut hp, |product, _| product);
            let curvature = dot(&p, &hp);
            if !(curvature > 0.0 && curvature.is_finite()) {
                return Ok((x, iteration));
            }
            let step = product / curvature;
            add_scaled(&mut x, step, &p);
            add_scaled(&mut r, -step, &hp);
            self.cycle(&mut work, &r, &mut z);
            let next = dot(&r, &z);
            let ratio = next / product;
            product = next;
            p.par_iter_mut().zip(&z).with_min_len(ROWS).for_each(|(p, z)| {
                *p = [z[0] + ratio * p[0], z[1] + ratio * p[1]];
            });
        }
        Ok((x, ITERATIONS))
    }

    /// Computes H x, and stores `then((H x)[row], row)` in each row of `out`.
    fn times(&self, x: &[[f64; 2]], out: &mut [[f64; 2]], then: impl Fn([f64; 2], usize) -> [f64; 2] + Sync) {
        multiplied(self.blocks.len());
        out.par_chunks_mut(ROWS).enumerate().for_each(|(chunk, out)| {
            for (v, out) in (chunk * ROWS..).zip(out) {
                let range = self.pattern.range(v);
                let mut sum = [0.0; 2];
                for (&w, block) in self.pattern.columns[range.clone()].iter().zip(&self.blocks[range]) {
                    let ([a, b, c, d], [y, z]) = (block.map(f64::from), x[w as usize]);
                    sum[0] += a * y + b * z;
                    sum[1] += c * y + d * z;
                }
                *out = then(sum, v);
            }
        });
    }

    /// Returns the inverse of each diagonal block of H, as the entries 00, 01 and 11 of the symmetric inverse.
    fn inverses(&self) -> Vec<[f64; 3]> {
        let inverse = |v: usize| {
            let [a, b, _, c] = self.blocks[self.pattern.range(v).start].map(f64::from);
            // A shift keeps the block positive definite even if all triangles of a vertex resist motion in one
            // direction only.
            let shift = 1e-6 * (a + c) + f64::MIN_POSITIVE;
            let (a, c) = (a + shift, c + shift);
            let determinant = a * c - b * b;
            [c / determinant, -b / determinant, a / determinant]
        };
        (0..self.turns.len()).into_par_iter().map(inverse).collect()
    }

    /// Applies the preconditioner to r and stores the result in x. The preconditioner is symmetric and positive
    /// definite.
    fn cycle(&self, work: &mut Workspace, r: &[[f64; 2]], x: &mut [[f64; 2]]) {
        x.fill([0.0; 2]);
        self.smooth(work, r, x, true);
        self.times(x, &mut work.rest, |hx, v| [r[v][0] - hx[0], r[v][1] - hx[1]]);
        self.coarse.correct(self.factor, self.turns, &work.rest, x);
        self.smooth(work, r, x, false);
    }

    /// Improves x by Chebyshev's iteration (Y. Saad, Iterative Methods for Sparse Linear Systems, 2003, algorithm
    /// 12.1).
    fn smooth(&self, work: &mut Workspace, r: &[[f64; 2]], x: &mut [[f64; 2]], is_zero: bool) {
        let [low, high] = RANGE;
        let (centre, half) = (0.5 * (high + low), 0.5 * (high - low));
        let mut rho = half / centre;
        let (mut keep, mut take) = (0.0, 1.0 / centre);
        for step in 0..SMOOTHING {
            if step > 0 {
                let next = 1.0 / (2.0 * centre / half - rho);
                (keep, take) = (next * rho, 2.0 * next / half);
                rho = next;
            }
            let rest: &[[f64; 2]] = if is_zero && step == 0 {
                r
            } else {
                self.times(x, &mut work.rest, |hx, v| [r[v][0] - hx[0], r[v][1] - hx[1]]);
                &work.rest
            };
            x.par_iter_mut().zip(&mut work.change).zip(rest).zip(&work.inverses).with_min_len(ROWS).for_each(
                |(((x, change), rest), [a, b, c])| {
                    let z = [a * rest[0] + b * rest[1], b * rest[0] + c * rest[1]];
                    // In the first step `change` still contains the values of the previous cycle. These values must not
                    // be used, because 0 times NaN would be NaN.
                    let kept = if keep == 0.0 { [0.0; 2] } else { [keep * change[0], keep * change[1]] };
                    *change = [kept[0] + take * z[0], kept[1] + take * z[1]];
                    *x = [x[0] + change[0], x[1] + change[1]];
                },
            );
        }
    }
}

/// Adds s y to x.
fn add_scaled(x: &mut [[f64; 2]], s: f64, y: &[[f64; 2]]) {
    x.par_iter_mut().zip(y).with_min_len(ROWS).for_each(|(x, y)| *x = [x[0] + s * y[0], x[1] + s * y[1]]);
}

/// Returns the inner product of two vectors, summed in chunks of fixed length and in a fixed order.
fn dot(x: &[[f64; 2]], y: &[[f64; 2]]) -> f64 {
    let chunk = |(x, y): (&[[f64; 2]], &[[f64; 2]])| x.iter().zip(y).map(|(x, y)| x[0] * y[0] + x[1] * y[1]).sum();
    let sums: Vec<f64> = x.par_chunks(ROWS).zip(y.par_chunks(ROWS)).map(chunk).collect();
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;
    use crate::cald::{CaldParams, cald};
    use crate::coarse::turns;
    use crate::local::frame;
    use crate::sparse_cholesky::Symbolic;
    use spharm_monitor::Silent;
    use spharm_surface::generate::{bipyramid, icosphere};

    std::thread_local! {
        pub(crate) static MULTIPLIED: Cell<usize> = const { Cell::new(0) };
    }

    #[test]
    fn a_fan_takes_as_much_work_for_each_of_its_sides_however_many_there_are() {
        let work = |sides: u32| {
            MULTIPLIED.with(|count| count.set(0));
            let found =
                cald(&bipyramid(sides), &CaldParams { degree: Some(0), ..CaldParams::default() }, &Silent).unwrap();
            assert!(found.quality().is_bijective() && found.quality().area_rms < 0.1);
            MULTIPLIED.with(|count| count.get()) as f64 / f64::from(sides)
        };
        let (few, many) = (work(2500), work(10_000));
        // If the work grew with the square of the number of vertices, `many` would be four times `few`.
        assert!(many < 2.0 * few && many < 20_000.0, "{few} {many}");
    }

    /// Returns the ill-conditioned matrix of uneven springs on an icosphere, which are a hundred times stiffer along
    /// the edges than across them.
    fn springs(unit: &[Vec3], pattern: &Pattern) -> Vec<[f64; 4]> {
        let mut blocks = vec![[0.0; 4]; pattern.columns.len()];
        for v in 0..unit.len() {
            let own = pattern.range(v).start;
            for at in pattern.range(v).skip(1) {
                let w = pattern.columns[at] as usize;
                let edge = crate::geometry::unit(crate::geometry::sub(unit[w], unit[v]));
                let strength = if (v + w).is_multiple_of(3) { 5.0 } else { 1.0 };
                let side = |p: Vec3| frame(p).map(|axis| crate::geometry::dot(axis, edge));
                let (here, there) = (side(unit[v]), side(unit[w]));
                for i in 0..2 {
                    for j in 0..2 {
                        blocks[own][2 * i + j] += strength * here[i] * here[j] + if i == j { 0.01 } else { 0.0 };
                        blocks[at][2 * i + j] = -strength * here[i] * there[j];
                    }
                }
            }
        }
        blocks
    }

    /// Returns the solution of a test system by conjugate gradients, the exact solution, and a function that computes
    /// the squared energy norm of a vector.
    fn both(level: u32) -> (Vector, Vector, impl Fn(&Vector) -> f64) {
        let mesh = icosphere(level);
        let pattern = Pattern::new(mesh.vertices.len(), &mesh.faces);
        let blocks = springs(&mesh.vertices, &pattern);
        let gradient: Vector = (0..mesh.vertices.len()).map(|v| [(v as f64).sin(), (0.3 * v as f64).cos()]).collect();
        let coarse = Coarse::new(&pattern, &Silent).unwrap().unwrap();
        let turns: Vec<[Vec3; 2]> = mesh.vertices.iter().map(|&p| turns(p)).collect();
        let factor = coarse.factor(&pattern, &blocks, &turns, &Silent).unwrap().unwrap();
        let light = blocks.iter().map(|block| block.map(|x| x as f32)).collect();
        let system = System { pattern: &pattern, blocks: light, coarse: &coarse, factor: &factor, turns: &turns };
        let (found, iterations) = system.solve(&gradient, &Silent).unwrap();
        assert!(iterations < 15, "{iterations}");
        let symbolic = Symbolic::new(2, &pattern.starts, &pattern.columns, &Silent).unwrap().unwrap();
        let factor = symbolic.factor(&pattern.starts, &pattern.columns, blocks.clone(), &Silent).unwrap().unwrap();
        let mut exact: Vector = gradient.iter().map(|[a, b]| [-a, -b]).collect();
        factor.solve(exact.as_flattened_mut());
        let size = move |x: &Vector| {
            let mut sum = 0.0;
            for v in 0..x.len() {
                for at in pattern.range(v) {
                    let ([a, b, c, d], y) = (blocks[at], x[pattern.columns[at] as usize]);
                    sum += x[v][0] * (a * y[0] + b * y[1]) + x[v][1] * (c * y[0] + d * y[1]);
                }
            }
            sum
        };
        (found, exact, size)
    }

    #[test]
    fn iterations_end_near_the_solution_of_the_factor() {
        for level in [3, 5] {
            let (found, exact, size) = both(level);
            let error: Vector = found.iter().zip(&exact).map(|(a, b)| [a[0] - b[0], a[1] - b[1]]).collect();
            // The stopping criterion bounds the error in the energy norm.
            assert!(size(&error) < 0.01 * size(&exact), "{level}: {} {}", size(&error), size(&exact));
        }
    }

    #[test]
    fn the_cycle_is_symmetric_and_definite() {
        let mesh = icosphere(3);
        let pattern = Pattern::new(mesh.vertices.len(), &mesh.faces);
        let blocks = springs(&mesh.vertices, &pattern);
        let coarse = Coarse::new(&pattern, &Silent).unwrap().unwrap();
        let turns: Vec<[Vec3; 2]> = mesh.vertices.iter().map(|&p| turns(p)).collect();
        let factor = coarse.factor(&pattern, &blocks, &turns, &Silent).unwrap().unwrap();
        let light = blocks.iter().map(|block| block.map(|x| x as f32)).collect();
        let system = System { pattern: &pattern, blocks: light, coarse: &coarse, factor: &factor, turns: &turns };
        let zero = vec![[0.0; 2]; 642];
        let mut work = Workspace { inverses: system.inverses(), rest: zero.clone(), change: zero.clone() };
        let vector =
            |k: f64| -> Vector { (0..642).map(|v| [(k * f64::from(v)).sin(), (k + f64::from(v)).cos()]).collect() };
        for k in [0.7, 2.3] {
            let (x, y) = (vector(k), vector(k * 1.7));
            let (mut cx, mut cy) = (zero.clone(), zero.clone());
            system.cycle(&mut work, &x, &mut cx);
            system.cycle(&mut work, &y, &mut cy);
            let (a, b) = (dot(&y, &cx), dot(&x, &cy));
            // The matrix was rounded to f32 entry by entry, which preserves its symmetry.
            assert!((a - b).abs() < 1e-10 * dot(&x, &cx), "{a} {b}");
            assert!(dot(&x, &cx) > 0.0);
        }
    }
}
