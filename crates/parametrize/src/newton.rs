//! Minimises an energy by projected Newton steps that move all vertices of a mesh at once.
//!
//! Each vertex has two unknowns, in a frame of its tangent plane. The negative eigenvalues of each triangle's Hessian
//! are raised to zero (J. Teran et al., SCA 2005), by a formula in closed form (`local.rs`). The linear system, summed
//! over triangles, is solved by conjugate gradients with a two-grid preconditioner (`pcg.rs`), or on small meshes by a
//! Cholesky factorisation. A step is halved until it flips no triangle and decreases the energy sufficiently (Armijo).
//! Newton steps quickly reduce low-frequency errors, even of stiff energies. Sweeps over single vertices would need
//! about as many rounds for this as there are edges on a path across the mesh.
//!
//! Sums are taken over chunks of fixed length in a fixed order, so the result has the same bits for any number of
//! threads.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use crate::batch::{BATCH, Batch, Numbers};
use crate::blocks::{KEPT, Pattern};
use crate::coarse::{Coarse, turns};
use crate::energy::{Energy, Shape, retract, set_areas};
use crate::geometry::{Vec3, add, norm, orientation, scale};
use crate::local::{NUMBERS, frame};
use crate::pcg::System;
use crate::sparse_cholesky::{Factor, Symbolic};

/// Number of triangles per chunk of a sum.
const CHUNK: usize = 4096;

/// A fixed triangulation, with the data needed to minimise energies over it repeatedly.
pub(crate) struct Newton {
    faces: Vec<[u32; 3]>,
    shapes: Vec<Shape>,
    pattern: Pattern,
    solver: Solver,
}

/// The solver of the linear systems: `Direct`, a Cholesky factorisation, for small meshes; `Iterative` for large ones.
enum Solver {
    Direct(Symbolic),
    /// Conjugate gradients. A factor of the coarse matrix is reused in later steps as long as few iterations suffice.
    Iterative {
        coarse: Coarse,
        factor: Option<Factor>,
    },
}

/// If solving a step's linear system takes at least this number of iterations, the coarse matrix is factored again for
/// the next step.
const SLOW: usize = 10;

/// If the mesh has at least this number of vertices, conjugate gradients are used, because they are then faster than a
/// factorisation.
const MANY: usize = 2000;

/// Relative shift of the diagonal before a factorisation. Without the shift the matrix could be singular, since
/// rotations of the entire sphere don't change the energy.
const SHIFT: f64 = 1e-8;

/// The result of a Newton step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Step {
    /// Energy before the step.
    pub(crate) before: f64,
    /// Energy after the step.
    pub(crate) after: f64,
    /// Fraction of the Newton step that was taken; 0 if no fraction tried decreased the energy.
    pub(crate) taken: f64,
    /// Decrease of the energy that the energy's quadratic approximation predicts for the step taken.
    promised: f64,
}

impl Step {
    /// Estimates how much another step would lower the energy, given that this step lowered it by `gain`.
    ///
    /// After a full step, the estimate is the difference between the actual and the predicted decrease, but at most
    /// `gain`. After a shorter step, the estimate is `gain`.
    pub(crate) fn left(&self, gain: f64) -> f64 {
        if self.taken < 1.0 { gain } else { gain.min((gain - self.promised).abs()) }
    }
}

impl Newton {
    /// Prepares the sparsity patterns and the solver for a triangulation over the vertices 0..n.
    ///
    /// Returns `None` if faer runs out of memory.
    pub(crate) fn new(
        n: usize,
        faces: Vec<[u32; 3]>,
        shapes: Vec<Shape>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Self>, Interrupted> {
        let pattern = Pattern::new(n, &faces);
        let solver = if n < MANY {
            Symbolic::new(2, &pattern.starts, &pattern.columns, monitor)?.map(Solver::Direct)
        } else {
            Coarse::new(&pattern, monitor)?.map(|coarse| Solver::Iterative { coarse, factor: None })
        };
        Ok(solver.map(|solver| Self { faces, shapes, pattern, solver }))
    }

    /// Sets the target area of each triangle; the areas must sum to 4 pi.
    pub(crate) fn set_areas(&mut self, areas: &[f64]) {
        set_areas(&mut self.shapes, areas);
    }

    /// Loads up to [`BATCH`] triangles into a batch, starting at index `first` and stopping before index `end`. Returns
    /// the number of triangles loaded.
    fn fill(&self, batch: &mut Batch, unit: &[Vec3], first: usize, end: usize) -> usize {
        let last = (first + BATCH).min(end);
        for f in first..last {
            batch.set(f - first, self.faces[f].map(|v| unit[v as usize]), &self.shapes[f]);
        }
        last - first
    }

    /// Returns the energy of a map; infinite if a triangle is flipped.
    pub(crate) fn value(&self, energy: Energy, unit: &[Vec3]) -> f64 {
        let sums: Vec<f64> = (0..self.faces.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let end = ((chunk + 1) * CHUNK).min(self.faces.len());
                let (mut batch, mut values) = (Batch::new(), [0.0; BATCH]);
                let mut sum = 0.0;
                for first in (chunk * CHUNK..end).step_by(BATCH) {
                    let count = self.fill(&mut batch, unit, first, end);
                    batch.values(energy, count, &mut values);
                    sum += values[..count].iter().sum::<f64>();
                }
                sum
            })
            .collect();
        sums.iter().sum()
    }

    fn is_positive(&self, unit: &[Vec3]) -> bool {
        self.faces.par_iter().all(|face| orientation(face.map(|v| unit[v as usize])) > 0.0)
    }

    /// Returns the gradients and Hessians of all triangles.
    fn derivatives(&self, energy: Energy, unit: &[Vec3]) -> Vec<[f64; KEPT]> {
        let mut local = vec![[0.0; KEPT]; self.faces.len()];
        local.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, local)| {
            let end = chunk * CHUNK + local.len();
            let mut batch = Batch::new();
            let mut numbers: Box<Numbers> = Box::new([[0.0; BATCH]; NUMBERS]);
            for (part, out) in local.chunks_mut(BATCH).enumerate() {
                let count = self.fill(&mut batch, unit, chunk * CHUNK + part * BATCH, end);
                batch.derivatives(energy, count, &mut numbers);
                for (k, row) in numbers[1..].iter().enumerate() {
                    out.iter_mut().zip(row).for_each(|(out, number)| out[k] = *number);
                }
            }
        });
        local
    }

    /// Returns the Newton direction: minus the inverse of the Hessian times the gradient. `None` if a factorisation
    /// fails.
    fn solve(
        &mut self,
        unit: &[Vec3],
        mut blocks: Vec<[f64; 4]>,
        gradient: &[[f64; 2]],
        monitor: &dyn Monitor,
    ) -> Result<Option<Vec<[f64; 2]>>, Interrupted> {
        let pattern = &self.pattern;
        match &mut self.solver {
            Solver::Direct(symbolic) => {
                for v in 0..unit.len() {
                    let diagonal = &mut blocks[pattern.range(v).start];
                    [0, 3].into_iter().for_each(|i| diagonal[i] = diagonal[i] * (1.0 + SHIFT) + f64::MIN_POSITIVE);
                }
                let factor = symbolic.factor(&pattern.starts, &pattern.columns, blocks, monitor)?;
                Ok(factor.map(|factor| {
                    let mut solution: Vec<[f64; 2]> = gradient.iter().map(|[a, b]| [-a, -b]).collect();
                    factor.solve(solution.as_flattened_mut());
                    solution
                }))
            }
            Solver::Iterative { coarse, factor: last } => {
                let turns: Vec<[Vec3; 2]> = unit.par_iter().map(|&p| turns(p)).collect();
                let factor = match last.take() {
                    Some(factor) => factor,
                    None => match coarse.factor(pattern, &blocks, &turns, monitor)? {
                        Some(factor) => factor,
                        None => return Ok(None),
                    },
                };
                let light = blocks.par_iter().map(|block| block.map(|x| x as f32)).collect();
                drop(blocks);
                let system = System { pattern, blocks: light, coarse, factor: &factor, turns: &turns };
                let (solution, iterations) = system.solve(gradient, monitor)?;
                *last = (iterations < SLOW).then_some(factor);
                Ok(Some(solution))
            }
        }
    }

    /// Takes one Newton step, which moves the vertices `unit` on the unit sphere.
    pub(crate) fn step(
        &mut self,
        energy: Energy,
        unit: &mut [Vec3],
        monitor: &dyn Monitor,
    ) -> Result<Step, Interrupted> {
        let before = self.value(energy, unit);
        monitor.check()?;
        let nothing = Step { before, after: before, taken: 0.0, promised: 0.0 };
        let mut gradient = vec![[0.0; 2]; unit.len()];
        let mut blocks = vec![[0.0; 4]; self.pattern.columns.len()];
        let local = self.derivatives(energy, unit);
        monitor.check()?;
        self.pattern.sum(&local, &mut gradient, &mut blocks);
        drop(local);
        let Some(solution) = self.solve(unit, blocks, &gradient, monitor)? else {
            return Ok(nothing);
        };
        let along = |(&p, [x, y]): (&Vec3, &[f64; 2])| {
            let [u, w] = frame(p);
            add(scale(u, *x), scale(w, *y))
        };
        let direction: Vec<Vec3> = unit.par_iter().zip(&solution).map(along).collect();
        let slope: f64 = gradient.iter().zip(&solution).map(|(g, x)| g[0] * x[0] + g[1] * x[1]).sum();
        let longest = direction.iter().map(|d| norm(*d)).fold(0.0, f64::max);
        if !(slope < 0.0 && longest.is_finite()) {
            return Ok(nothing);
        }

        // Moves are limited to half a radian, beyond which a second-order model isn't valid on the sphere.
        let mut t = (0.5 / longest).min(1.0);
        for _ in 0..16 {
            monitor.check()?;
            let moved: Vec<Vec3> = unit.par_iter().zip(&direction).map(|(&p, &d)| retract(p, scale(d, t))).collect();
            let after = self.value(energy, &moved);
            if after <= before + 1e-4 * t * slope && self.is_positive(&moved) {
                unit.copy_from_slice(&moved);
                // The quadratic model predicts this decrease, because d^T H d = -slope for the Newton direction d.
                let promised = -slope * t * (1.0 - 0.5 * t);
                return Ok(Step { before, after, taken: t, promised });
            }
            t *= 0.5;
        }
        Ok(nothing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;
    use spharm_surface::generate::{Cortex, cortex};

    /// Returns a folded surface of 2,562 vertices and, as its initial map, the sphere that it was generated from, which
    /// is far from the optimal map.
    fn start() -> (Vec<Vec3>, Vec<[u32; 3]>, Vec<Shape>) {
        let (surface, sphere) = cortex(&Cortex { subdivisions: 4, variant: 0 });
        let corners = |face: &[u32; 3]| face.map(|v| surface.vertices[v as usize]);
        let total: f64 = surface.faces.iter().map(|face| crate::geometry::area(corners(face))).sum();
        let factor = 4.0 * std::f64::consts::PI / total;
        let shape = |face: &[u32; 3]| Shape::new(corners(face), factor * crate::geometry::area(corners(face)));
        (sphere.vertices, surface.faces.clone(), surface.faces.iter().map(shape).collect())
    }

    #[test]
    fn iterations_descend_like_the_factor() {
        let (map, faces, shapes) = start();
        let energy = Energy::bounded(1.0, 0.1, 0.002);
        let pattern = Pattern::new(map.len(), &faces);
        let symbolic = Symbolic::new(2, &pattern.starts, &pattern.columns, &Silent).unwrap().unwrap();
        let coarse = Coarse::new(&pattern, &Silent).unwrap().unwrap();
        let solvers = [Solver::Direct(symbolic), Solver::Iterative { coarse, factor: None }];
        let [direct, iterative] = solvers.map(|solver| {
            let pattern = Pattern::new(map.len(), &faces);
            let mut newton = Newton { faces: faces.clone(), shapes: shapes.clone(), pattern, solver };
            let mut map = map.clone();
            let mut last = newton.step(energy, &mut map, &Silent).unwrap();
            for _ in 0..14 {
                let step = newton.step(energy, &mut map, &Silent).unwrap();
                assert!(step.after <= step.before && step.before == last.after, "{step:?}");
                last = step;
            }
            // Near the minimum, another step would hardly lower the energy, so the estimated decrease is nearly 0.
            assert!(last.left(last.before - last.after) < 1e-6 * last.after, "{last:?}");
            newton.value(energy, &map)
        });
        assert!((direct / iterative - 1.0).abs() < 1e-5, "{direct} {iterative}");
    }
}
