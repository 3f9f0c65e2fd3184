//! All vertices at once: projected Newton over the whole mesh.
//!
//! Unknowns are two per vertex, in a frame of the tangent plane. Each triangle's 6 x 6 Hessian is made of differences of
//! its analytic gradient, its negative eigenvalues are raised to zero (J. Teran et al., SCA 2005), and the sum goes to
//! faer's sparse Cholesky, whose symbolic part serves all steps. Steps are halved until no triangle is flipped and the
//! energy has gone down (Armijo). Newton's steps are what low-frequency errors of stiff energies need: sweeps over
//! single vertices take as many rounds as the mesh is wide.
//!
//! A step at n vertices costs one factorisation, O(n^1.5) flops and O(n log n) numbers on a surface, and about 15
//! evaluations of the energy. Sums run over chunks of fixed length in fixed order, so that the number of threads
//! changes no bit.

use std::sync::Arc;

use faer::linalg::solvers::Solve;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMatRef, SymbolicSparseColMat};
use faer::{Mat, Side};
use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use crate::background::abandonable;
use crate::energy::{Energy, Shape, frame, retract, set_areas};
use crate::geometry::{Vec3, add, dot, norm, orientation, scale, sub};

/// Triangles per chunk of a sum.
const CHUNK: usize = 4096;

/// Vertices from which on a factorisation takes long.
const LONG: usize = 20_000;

/// A fixed triangulation and what is needed to minimise energies over it again and again.
pub(crate) struct Newton {
    faces: Vec<[u32; 3]>,
    shapes: Vec<Shape>,
    pattern: Arc<SymbolicSparseColMat<usize>>,
    symbolic: SymbolicLlt<usize>,
    /// Where each triangle's 6 x 6 numbers go in the matrix: 36 places, `NOWHERE` above the diagonal.
    slots: Vec<[u32; 36]>,
    diagonal: Vec<usize>,
}

const NOWHERE: u32 = u32::MAX;

/// The result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Step {
    /// Energy before.
    pub(crate) before: f64,
    /// Energy after.
    pub(crate) after: f64,
    /// The fraction of Newton's step that was taken; 0 where none lowered the energy.
    pub(crate) taken: f64,
}

impl Newton {
    /// Prepares for triangles over vertices 0..n.
    ///
    /// Returns `None` where faer can't, which is for want of memory.
    pub(crate) fn new(
        n: usize,
        faces: Vec<[u32; 3]>,
        shapes: Vec<Shape>,
        monitor: &dyn Monitor,
    ) -> Result<Option<Self>, Interrupted> {
        let mut neighbours: Vec<Vec<u32>> = (0..n as u32).map(|v| vec![v]).collect();
        for face in &faces {
            for (i, j) in [(0, 1), (1, 2), (2, 0)] {
                let (low, high) = (face[i].min(face[j]), face[i].max(face[j]));
                neighbours[low as usize].push(high);
            }
        }
        let mut columns = Vec::with_capacity(2 * n + 1);
        let mut rows = Vec::new();
        columns.push(0);
        for list in &mut neighbours {
            list.sort_unstable();
            list.dedup();
            for k in 0..2 {
                // The second column of a vertex begins at its own second row.
                rows.extend(list.iter().flat_map(|&w| [2 * w as usize, 2 * w as usize + 1]).skip(k));
                columns.push(rows.len());
            }
        }
        let diagonal = columns[..2 * n].to_vec();
        let place = |row: (u32, usize), column: (u32, usize)| -> u32 {
            let (i, j) = (2 * row.0 as usize + row.1, 2 * column.0 as usize + column.1);
            if i < j {
                return NOWHERE;
            }
            let at = neighbours[column.0 as usize].binary_search(&row.0).unwrap_or(0);
            (columns[j] + 2 * at + row.1 - column.1) as u32
        };
        let slots = faces
            .iter()
            .map(|face| {
                let mut slots = [NOWHERE; 36];
                for i in 0..6 {
                    for j in 0..6 {
                        slots[6 * i + j] = place((face[i / 2], i % 2), (face[j / 2], j % 2));
                    }
                }
                slots
            })
            .collect();
        let pattern = SymbolicSparseColMat::new_checked(2 * n, 2 * n, columns, None, rows);
        let pattern = Arc::new(pattern);
        let theirs = Arc::clone(&pattern);
        let symbolic =
            abandonable(n >= LONG, monitor, move || SymbolicLlt::try_new(theirs.as_ref().as_ref(), Side::Lower))?;
        Ok(symbolic.ok().map(|symbolic| Self { faces, shapes, pattern, symbolic, slots, diagonal }))
    }

    /// Sets the target area of each triangle (sum 4 pi).
    pub(crate) fn set_areas(&mut self, areas: &[f64]) {
        set_areas(&mut self.shapes, areas);
    }

    fn corners(&self, unit: &[Vec3], f: usize) -> [Vec3; 3] {
        self.faces[f].map(|v| unit[v as usize])
    }

    /// The energy of a map; infinite where a triangle is flipped.
    pub(crate) fn value(&self, energy: Energy, unit: &[Vec3]) -> f64 {
        let sums: Vec<f64> = (0..self.faces.len().div_ceil(CHUNK))
            .into_par_iter()
            .map(|chunk| {
                let range = chunk * CHUNK..((chunk + 1) * CHUNK).min(self.faces.len());
                range.map(|f| energy.value(&self.shapes[f], self.corners(unit, f))).sum()
            })
            .collect();
        sums.iter().sum()
    }

    fn is_positive(&self, unit: &[Vec3]) -> bool {
        (0..self.faces.len()).into_par_iter().all(|f| orientation(self.corners(unit, f)) > 0.0)
    }

    /// One step.
    pub(crate) fn step(&self, energy: Energy, unit: &mut [Vec3], monitor: &dyn Monitor) -> Result<Step, Interrupted> {
        let before = self.value(energy, unit);
        monitor.check()?;
        let nothing = Step { before, after: before, taken: 0.0 };
        let frames: Vec<[Vec3; 2]> = unit.par_iter().map(|&p| frame(p)).collect();
        let mut gradient = vec![0.0; 2 * unit.len()];
        let mut values = vec![0.0; self.pattern.row_idx().len()];
        for start in (0..self.faces.len()).step_by(CHUNK) {
            monitor.check()?;
            let range = start..(start + CHUNK).min(self.faces.len());
            let of = |f: usize| {
                let frames = self.faces[f].map(|v| frames[v as usize]);
                Local::of(energy, &self.shapes[f], self.corners(unit, f), frames)
            };
            let local: Vec<Local> = range.clone().into_par_iter().map(of).collect();
            for (f, local) in range.zip(&local) {
                for (i, g) in local.gradient.iter().enumerate() {
                    gradient[2 * self.faces[f][i / 2] as usize + i % 2] += g;
                }
                for (slot, h) in self.slots[f].iter().zip(&local.hessian) {
                    if *slot != NOWHERE {
                        values[*slot as usize] += h;
                    }
                }
            }
        }
        // Turning the whole sphere costs nothing; a little of the diagonal makes the matrix definite.
        for &at in &self.diagonal {
            values[at] = values[at] * (1.0 + 1e-8) + f64::MIN_POSITIVE;
        }
        let (pattern, symbolic) = (Arc::clone(&self.pattern), self.symbolic.clone());
        let mut solution = Mat::from_fn(gradient.len(), 1, |i, _| -gradient[i]);
        let solved = abandonable(unit.len() >= LONG, monitor, move || {
            let matrix = SparseColMatRef::new(pattern.as_ref().as_ref(), &values);
            let factor = Llt::try_new_with_symbolic(symbolic, matrix, Side::Lower).ok()?;
            factor.solve_in_place(solution.as_mut());
            Some(solution)
        })?;
        let Some(solution) = solved else { return Ok(nothing) };
        let direction: Vec<Vec3> = frames
            .iter()
            .enumerate()
            .map(|(v, [u, w])| add(scale(*u, solution[(2 * v, 0)]), scale(*w, solution[(2 * v + 1, 0)])))
            .collect();
        let slope: f64 = (0..gradient.len()).map(|i| gradient[i] * solution[(i, 0)]).sum();
        let longest = direction.iter().map(|d| norm(*d)).fold(0.0, f64::max);
        if !(slope < 0.0 && longest.is_finite()) {
            return Ok(nothing);
        }

        // Half a radian is further than a second-order model of the sphere sees.
        let mut t = (0.5 / longest).min(1.0);
        for _ in 0..16 {
            monitor.check()?;
            let moved: Vec<Vec3> = unit.par_iter().zip(&direction).map(|(&p, &d)| retract(p, scale(d, t))).collect();
            let after = self.value(energy, &moved);
            if after <= before + 1e-4 * t * slope && self.is_positive(&moved) {
                unit.copy_from_slice(&moved);
                return Ok(Step { before, after, taken: t });
            }
            t *= 0.5;
        }
        Ok(nothing)
    }
}

/// One triangle's gradient and Hessian in the frames of its corners.
struct Local {
    gradient: [f64; 6],
    /// Row by row; positive semidefinite.
    hessian: [f64; 36],
}

impl Local {
    fn of(energy: Energy, shape: &Shape, p: [Vec3; 3], frames: [[Vec3; 2]; 3]) -> Self {
        // In the frame's coordinates x, p(x) = (p + x1 u + x2 w) / |.|, whose derivative along u is (u - p (p . u)) / |.|.
        let slope = |at: [Vec3; 3], lengths: [f64; 3]| -> [f64; 6] {
            let (_, g) = energy.gradient(shape, at);
            let mut slope = [0.0; 6];
            for i in 0..3 {
                let across = sub(g[i], scale(at[i], dot(g[i], at[i])));
                for k in 0..2 {
                    slope[2 * i + k] = dot(across, frames[i][k]) / lengths[i];
                }
            }
            slope
        };
        let gradient = slope(p, [1.0; 3]);
        let longest = (0..3).map(|i| norm(sub(p[i], p[(i + 1) % 3]))).fold(0.0, f64::max);
        let height = 2.0 * crate::geometry::area(p) / longest;
        let h = 1e-5 * height;
        let mut hessian = [0.0; 36];
        for i in 0..6 {
            let (corner, k) = (i / 2, i % 2);
            let mut at = p;
            let moved = add(p[corner], scale(frames[corner][k], h));
            let mut lengths = [1.0; 3];
            lengths[corner] = norm(moved);
            at[corner] = scale(moved, 1.0 / lengths[corner]);
            let there = slope(at, lengths);
            for j in 0..6 {
                hessian[6 * i + j] = (there[j] - gradient[j]) / h;
            }
        }
        for i in 0..6 {
            for j in 0..i {
                let mean = 0.5 * (hessian[6 * i + j] + hessian[6 * j + i]);
                hessian[6 * i + j] = mean;
                hessian[6 * j + i] = mean;
            }
        }
        if hessian.iter().all(|h| h.is_finite()) {
            make_semidefinite(&mut hessian);
        } else {
            hessian = [0.0; 36];
        }
        Self { gradient, hessian }
    }
}

/// Raises negative eigenvalues to 0, by Jacobi's rotations.
fn make_semidefinite(m: &mut [f64; 36]) {
    let mut a = *m;
    let mut v = [0.0; 36];
    (0..6).for_each(|i| v[7 * i] = 1.0);
    let size: f64 = a.iter().map(|x| x * x).sum();
    for _ in 0..12 {
        let off: f64 = (0..6).flat_map(|i| (0..i).map(move |j| (i, j))).map(|(i, j)| a[6 * i + j].powi(2)).sum();
        if off <= 1e-20 * size {
            break;
        }
        for i in 1..6 {
            for j in 0..i {
                let x = a[6 * i + j];
                if x == 0.0 {
                    continue;
                }
                let theta = (a[7 * j] - a[7 * i]) / (2.0 * x);
                let t = if theta == 0.0 { 1.0 } else { theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt()) };
                let c = 1.0 / (t * t + 1.0).sqrt();
                let s = t * c;
                // Rotates the plane of i and j so that a[i][j] vanishes.
                for k in 0..6 {
                    let (x, y) = (a[6 * k + i], a[6 * k + j]);
                    a[6 * k + i] = c * x - s * y;
                    a[6 * k + j] = s * x + c * y;
                }
                for k in 0..6 {
                    let (x, y) = (a[6 * i + k], a[6 * j + k]);
                    a[6 * i + k] = c * x - s * y;
                    a[6 * j + k] = s * x + c * y;
                }
                for k in 0..6 {
                    let (x, y) = (v[6 * k + i], v[6 * k + j]);
                    v[6 * k + i] = c * x - s * y;
                    v[6 * k + j] = s * x + c * y;
                }
            }
        }
    }
    if (0..6).all(|k| a[7 * k] >= 0.0) {
        return;
    }
    for i in 0..6 {
        for j in 0..6 {
            m[6 * i + j] = (0..6).map(|k| a[7 * k].max(0.0) * v[6 * i + k] * v[6 * j + k]).sum();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eigenvalues_below_zero_are_raised_and_others_kept() {
        let mut m = [0.0; 36];
        for i in 0..6 {
            for j in 0..6 {
                m[6 * i + j] = 1.0 / (1.0 + i as f64 + j as f64) - if i == j { 0.1 } else { 0.0 };
            }
        }
        let original = m;
        make_semidefinite(&mut m);
        // The projection is the nearest semidefinite matrix: what it adds is semidefinite and orthogonal to it.
        let added: Vec<f64> = m.iter().zip(&original).map(|(a, b)| a - b).collect();
        let product: f64 = m.iter().zip(&added).map(|(a, b)| a * b).sum();
        assert!(product.abs() < 1e-12);
        for seed in 0..20 {
            let x: Vec<f64> = (0..6).map(|i| f64::from((seed * 7 + i * i * 3 + i) % 11 - 5)).collect();
            let form = |m: &[f64]| -> f64 { (0..36).map(|k| m[k] * x[k / 6] * x[k % 6]).sum() };
            assert!(form(&m) >= -1e-12 && form(&added) >= -1e-12);
        }
        assert!(added.iter().any(|a| a.abs() > 1e-3));
    }
}
