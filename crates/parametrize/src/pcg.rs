//! Newton's systems by conjugate gradients, preconditioned by two grids.
//!
//! One cycle: two steps of Chebyshev's smoother, a correction in the coarse space (`coarse.rs`), two steps more. The smoother
//! works with the inverses D^-1 of the 2 x 2 diagonal blocks. Of D^-1 H no eigenvalue is above 3, since H is a sum of
//! semidefinite matrices of three corners each, whatever the triangulation.
//!
//! Memory and work per iteration are linear in the vertices. Some ten iterations take the error in the energy of the
//! quadratic model to a hundredth, for any number of vertices.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use crate::blocks::Pattern;
use crate::coarse::Coarse;
use crate::geometry::Vec3;
use crate::sparse_cholesky::Factor;

/// Two unknowns a vertex.
type Vector = Vec<[f64; 2]>;

/// Rows per task.
const ROWS: usize = 2048;

/// Smoothing steps before and after the coarse correction.
const SMOOTHING: usize = 2;

/// The largest eigenvalue of D^-1 H, and the least that the smoother is to damp.
const RANGE: [f64; 2] = [0.3, 3.0];

/// Most iterations.
const ITERATIONS: usize = 100;

/// The reduction of the residual, in the preconditioner's norm, at which to stop.
const REDUCTION: f64 = 0.05;

/// One linear system.
pub(crate) struct System<'a> {
    pub(crate) pattern: &'a Pattern,
    pub(crate) blocks: &'a [[f64; 4]],
    pub(crate) unit: &'a [Vec3],
    pub(crate) coarse: &'a Coarse,
}

impl System<'_> {
    /// Solves for minus the gradient, roughly. Returns `None` where the matrix isn't definite, by rounding or overflow.
    pub(crate) fn solve(&self, gradient: &[[f64; 2]], monitor: &dyn Monitor) -> Result<Option<Vector>, Interrupted> {
        let Some(factor) = self.coarse.factor(self.pattern, self.blocks, self.unit, monitor)? else { return Ok(None) };
        let inverses = self.inverses();
        let mut x = vec![[0.0; 2]; gradient.len()];
        let mut r: Vector = gradient.iter().map(|[a, b]| [-a, -b]).collect();
        let mut z = self.cycle(&factor, &inverses, &r);
        let mut p = z.clone();
        let mut product = dot(&r, &z);
        let enough = REDUCTION * REDUCTION * product;
        for _ in 0..ITERATIONS {
            monitor.check()?;
            if !(product > enough && product.is_finite()) {
                break;
            }
            let hp = self.times(&p);
            let curvature = dot(&p, &hp);
            if !(curvature > 0.0 && curvature.is_finite()) {
                break;
            }
            let step = product / curvature;
            add_scaled(&mut x, step, &p);
            add_scaled(&mut r, -step, &hp);
            z = self.cycle(&factor, &inverses, &r);
            let next = dot(&r, &z);
            let ratio = next / product;
            product = next;
            p.par_iter_mut().zip(&z).with_min_len(ROWS).for_each(|(p, z)| {
                *p = [z[0] + ratio * p[0], z[1] + ratio * p[1]];
            });
        }
        Ok(Some(x))
    }

    /// H x.
    fn times(&self, x: &[[f64; 2]]) -> Vector {
        let row = |v: usize| {
            let range = self.pattern.range(v);
            let mut sum = [0.0; 2];
            for (&w, [a, b, c, d]) in self.pattern.columns[range.clone()].iter().zip(&self.blocks[range]) {
                let [y, z] = x[w as usize];
                sum[0] += a * y + b * z;
                sum[1] += c * y + d * z;
            }
            sum
        };
        (0..x.len()).into_par_iter().with_min_len(ROWS).map(row).collect()
    }

    /// The inverses of the diagonal blocks.
    fn inverses(&self) -> Vec<[f64; 3]> {
        let inverse = |v: usize| {
            let [a, b, _, c] = self.blocks[self.pattern.range(v).start];
            // A vertex whose triangles all resist in one direction only still gets a definite block.
            let shift = 1e-9 * (a + c) + f64::MIN_POSITIVE;
            let (a, c) = (a + shift, c + shift);
            let determinant = a * c - b * b;
            [c / determinant, -b / determinant, a / determinant]
        };
        (0..self.unit.len()).into_par_iter().map(inverse).collect()
    }

    /// The preconditioner: symmetric and definite.
    fn cycle(&self, factor: &Factor, inverses: &[[f64; 3]], r: &[[f64; 2]]) -> Vector {
        let mut x = vec![[0.0; 2]; r.len()];
        self.smooth(inverses, r, &mut x, true);
        let rest = self.rest(r, &x);
        self.coarse.correct(factor, self.unit, &rest, &mut x);
        self.smooth(inverses, r, &mut x, false);
        x
    }

    /// r - H x.
    fn rest(&self, r: &[[f64; 2]], x: &[[f64; 2]]) -> Vector {
        let mut rest = self.times(x);
        rest.par_iter_mut().zip(r).with_min_len(ROWS).for_each(|(hx, r)| *hx = [r[0] - hx[0], r[1] - hx[1]]);
        rest
    }

    /// Chebyshev's iteration (Y. Saad, Iterative Methods for Sparse Linear Systems, 2003, algorithm 12.1).
    fn smooth(&self, inverses: &[[f64; 3]], r: &[[f64; 2]], x: &mut [[f64; 2]], is_zero: bool) {
        let [low, high] = RANGE;
        let (centre, half) = (0.5 * (high + low), 0.5 * (high - low));
        let mut rho = half / centre;
        let mut change: Vector = Vec::new();
        for step in 0..SMOOTHING {
            let rest = if is_zero && step == 0 { r.to_vec() } else { self.rest(r, x) };
            if step == 0 {
                change = vec![[0.0; 2]; r.len()];
            }
            let (keep, take) = if step == 0 {
                (0.0, 1.0 / centre)
            } else {
                let next = 1.0 / (2.0 * centre / half - rho);
                let both = (next * rho, 2.0 * next / half);
                rho = next;
                both
            };
            let update =
                |(((x, change), rest), [a, b, c]): (((&mut [f64; 2], &mut [f64; 2]), &[f64; 2]), &[f64; 3])| {
                    let z = [a * rest[0] + b * rest[1], b * rest[0] + c * rest[1]];
                    *change = [keep * change[0] + take * z[0], keep * change[1] + take * z[1]];
                    *x = [x[0] + change[0], x[1] + change[1]];
                };
            x.par_iter_mut().zip(&mut change).zip(&rest).zip(inverses).with_min_len(ROWS).for_each(update);
        }
    }
}

/// x += s y.
fn add_scaled(x: &mut [[f64; 2]], s: f64, y: &[[f64; 2]]) {
    x.par_iter_mut().zip(y).with_min_len(ROWS).for_each(|(x, y)| *x = [x[0] + s * y[0], x[1] + s * y[1]]);
}

/// The inner product, in chunks of fixed length and order.
fn dot(x: &[[f64; 2]], y: &[[f64; 2]]) -> f64 {
    let chunk = |(x, y): (&[[f64; 2]], &[[f64; 2]])| x.iter().zip(y).map(|(x, y)| x[0] * y[0] + x[1] * y[1]).sum();
    let sums: Vec<f64> = x.par_chunks(ROWS).zip(y.par_chunks(ROWS)).map(chunk).collect();
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::local::frame;
    use crate::sparse_cholesky::Symbolic;
    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;

    /// A stiff, soft and uneven system on an icosphere: springs along edges, a hundred times stiffer than across.
    fn springs(unit: &[Vec3], pattern: &Pattern) -> Vec<[f64; 4]> {
        let mut blocks = vec![[0.0; 4]; pattern.columns.len()];
        for v in 0..unit.len() {
            let own = pattern.range(v).start;
            for at in pattern.range(v).skip(1) {
                let w = pattern.columns[at] as usize;
                let edge = crate::geometry::unit(crate::geometry::sub(unit[w], unit[v]));
                let strength = if (v + w) % 3 == 0 { 5.0 } else { 1.0 };
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

    #[test]
    fn iterations_end_near_the_solution_of_the_factor() {
        for level in [3, 5] {
            let mesh = icosphere(level);
            let pattern = Pattern::new(mesh.vertices.len(), &mesh.faces);
            let blocks = springs(&mesh.vertices, &pattern);
            let gradient: Vector =
                (0..mesh.vertices.len()).map(|v| [(v as f64).sin(), (0.3 * v as f64).cos()]).collect();
            let coarse = Coarse::new(&pattern, &Silent).unwrap().unwrap();
            let system = System { pattern: &pattern, blocks: &blocks, unit: &mesh.vertices, coarse: &coarse };
            let found = system.solve(&gradient, &Silent).unwrap().unwrap();
            let symbolic = Symbolic::new(2, &pattern.starts, &pattern.columns, &Silent).unwrap().unwrap();
            let factor = symbolic.factor(&pattern.starts, &pattern.columns, blocks.clone(), &Silent).unwrap().unwrap();
            let mut exact: Vector = gradient.iter().map(|[a, b]| [-a, -b]).collect();
            factor.solve(exact.as_flattened_mut());
            // The error in the norm of the energy, which the reduction is about.
            let error: Vector = found.iter().zip(&exact).map(|(a, b)| [a[0] - b[0], a[1] - b[1]]).collect();
            let size = |x: &Vector| dot(x, &system.times(x));
            assert!(size(&error) < 0.01 * size(&exact), "{level}: {} {}", size(&error), size(&exact));
            // The factor's own residual vanishes, so the products agree.
            let rest = system.rest(&gradient.iter().map(|[a, b]| [-a, -b]).collect::<Vector>(), &exact);
            assert!(dot(&rest, &rest) < 1e-20 * dot(&gradient, &gradient));
        }
    }

    #[test]
    fn the_cycle_is_symmetric_and_definite() {
        let mesh = icosphere(3);
        let pattern = Pattern::new(mesh.vertices.len(), &mesh.faces);
        let blocks = springs(&mesh.vertices, &pattern);
        let coarse = Coarse::new(&pattern, &Silent).unwrap().unwrap();
        let system = System { pattern: &pattern, blocks: &blocks, unit: &mesh.vertices, coarse: &coarse };
        let factor = coarse.factor(&pattern, &blocks, &mesh.vertices, &Silent).unwrap().unwrap();
        let inverses = system.inverses();
        let vector =
            |k: f64| -> Vector { (0..642).map(|v| [(k * f64::from(v)).sin(), (k + f64::from(v)).cos()]).collect() };
        for k in [0.7, 2.3] {
            let (x, y) = (vector(k), vector(k * 1.7));
            let (cx, cy) = (system.cycle(&factor, &inverses, &x), system.cycle(&factor, &inverses, &y));
            let (a, b) = (dot(&y, &cx), dot(&x, &cy));
            assert!((a - b).abs() < 1e-10 * dot(&x, &cx), "{a} {b}");
            assert!(dot(&x, &cx) > 0.0);
        }
    }
}
