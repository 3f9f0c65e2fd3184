//! Builds the coarse space of the two-grid preconditioner: up to ten thousand patches that rotate as rigid bodies.
//!
//! A smoother reduces error slowly if the error is a displacement that hardly deforms triangles, for example if each
//! patch of the sphere rotates and the rotation changes gradually from patch to patch. The coarse unknowns are
//! therefore the rotation vectors omega_k (three numbers) of patches. Patch k consists of the vertices within `R` edges
//! of a seed vertex. Vertex v moves by
//!
//! ```text
//! x_v = F_v sum over patches k of phi_k(v) omega_k x p_v,      phi_k(v) ~ 1 - distance(v, seed k) / (R + 1)
//! ```
//!
//! where p_v is the position of vertex v on the unit sphere, F_v converts a vector to coordinates in the tangent plane
//! at p_v, and omega_k x p_v is a vector product. The phi_k(v) are scaled to sum to 1 over the patches, so that the
//! space contains rotations of the entire sphere exactly. This is smoothed aggregation with the rigid modes of
//! elasticity (P. Vanek, J. Mandel, M. Brezina, Computing 56, 1996), except that the phi_k are hat functions of the
//! distance and aren't smoothed by the matrix. Patches depend only on the triangulation and are computed once. Let P be
//! the matrix that maps all omega_k to all x_v, and H the Hessian. The coarse matrix is P^T H P, which the library faer
//! factors.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

use crate::blocks::Pattern;
use crate::geometry::{Vec3, add, dot, scale};
use crate::local::frame;
use crate::sparse_cholesky::{Factor, Symbolic};

/// Smallest radius R of a patch, in edges. R is larger on meshes that would otherwise have too many patches.
const LEAST_RADIUS: usize = 4;

/// Approximate maximum number of patches. The number is limited because the coarse matrix is factored repeatedly.
const MOST_PATCHES: usize = 10_000;

/// Largest number of neighbours of an ordinary vertex. A vertex with more neighbours gets its own patch, and other
/// patches exclude it. If they included the vertex, all patches near it would become neighbours of each other, and the
/// coarse matrix would get a large dense block.
const HUB: usize = 64;

/// Number added to the diagonal of the coarse matrix, relative to the trace of each patch's 3 x 3 diagonal block.
/// Without the shift the matrix can be singular: a patch of a single vertex doesn't move when it rotates about that
/// vertex.
const SHIFT: f64 = 1e-9;

/// Used in place of an index if a position or a patch is missing.
const NOWHERE: u32 = u32::MAX;

/// Patches of a triangulation, and the symbolic factorisation of the coarse matrix.
pub(crate) struct Coarse {
    /// Index in `weights` of each vertex's first entry, followed by the length of `weights`.
    starts: Vec<u32>,
    /// The patches that contain each vertex: (patch, weight).
    weights: Vec<(u32, f32)>,
    /// Index in `members` of each patch's first entry, followed by the length of `members`.
    members_of: Vec<u32>,
    /// The vertices of each patch: (vertex, weight).
    members: Vec<(u32, f32)>,
    /// Index in `columns` of each patch's first neighbour. The last entry is the length of `columns`.
    rows: Vec<u32>,
    columns: Vec<u32>,
    symbolic: Symbolic,
}

impl Coarse {
    /// Covers a triangulation with patches. Returns `None` if faer runs out of memory in the symbolic analysis.
    pub(crate) fn new(pattern: &Pattern, monitor: &dyn Monitor) -> Result<Option<Self>, Interrupted> {
        let n = pattern.rows();
        // Seeds are more than R edges apart, so there is about one seed per R^2 vertices.
        let radius = LEAST_RADIUS.max((n as f64 / MOST_PATCHES as f64).sqrt().ceil() as usize);
        let found = balls(pattern, radius);
        monitor.check()?;
        let patches = found.last().map_or(0, |last| last.0 as usize + 1);
        let mut members_of = vec![0_u32; patches + 1];
        let mut starts = vec![0_u32; n + 1];
        for &(patch, v, _) in &found {
            members_of[patch as usize + 1] += 1;
            starts[v as usize + 1] += 1;
        }
        (0..patches).for_each(|k| members_of[k + 1] += members_of[k]);
        (0..n).for_each(|v| starts[v + 1] += starts[v]);
        let mut sums = vec![0.0_f32; n];
        found.iter().for_each(|&(_, v, weight)| sums[v as usize] += weight);
        let mut next = starts.clone();
        let mut weights = vec![(0, 0.0); found.len()];
        let mut members = Vec::with_capacity(found.len());
        for &(patch, v, weight) in &found {
            let weight = weight / sums[v as usize];
            members.push((v, weight));
            weights[next[v as usize] as usize] = (patch, weight);
            next[v as usize] += 1;
        }
        drop(found);
        let patches_at = |v: u32| weights[starts[v as usize] as usize..starts[v as usize + 1] as usize].iter();
        let neighbours: Vec<Vec<u32>> = (0..patches)
            .into_par_iter()
            .map(|k| {
                let vertices = &members[members_of[k] as usize..members_of[k + 1] as usize];
                let mut near: Vec<u32> =
                    vertices.iter().flat_map(|&(v, _)| pattern.columns_of(v).iter().copied()).collect();
                near.sort_unstable();
                near.dedup();
                let mut list: Vec<u32> = near.into_iter().flat_map(|w| patches_at(w).map(|(l, _)| *l)).collect();
                list.sort_unstable();
                list.dedup();
                list
            })
            .collect();
        let mut rows = vec![0];
        let mut columns = Vec::new();
        for list in &neighbours {
            columns.extend(list);
            rows.push(columns.len() as u32);
        }
        let symbolic = Symbolic::new(3, &rows, &columns, monitor)?;
        Ok(symbolic.map(|symbolic| Self { starts, weights, members_of, members, rows, columns, symbolic }))
    }

    /// Returns the Cholesky factor of the coarse matrix, given the blocks of the Hessian and the [`turns`] of each
    /// vertex; `None` if the matrix isn't positive definite.
    pub(crate) fn factor(
        &self,
        pattern: &Pattern,
        blocks: &[[f64; 4]],
        turns: &[[Vec3; 2]],
        monitor: &dyn Monitor,
    ) -> Result<Option<Factor>, Interrupted> {
        let patches = self.rows.len() - 1;
        let rows: Vec<Vec<[f64; 9]>> = (0..patches)
            .into_par_iter()
            .map_init(|| vec![NOWHERE; patches], |places, k| self.row(k, places, pattern, blocks, turns))
            .collect();
        monitor.check()?;
        let mut values: Vec<[f64; 9]> = rows.concat();
        for k in 0..patches {
            let range = self.rows[k] as usize..self.rows[k + 1] as usize;
            let at = range.start + self.columns[range].binary_search(&(k as u32)).unwrap_or(0);
            let shift = SHIFT * (values[at][0] + values[at][4] + values[at][8]) + f64::MIN_POSITIVE;
            [0, 4, 8].into_iter().for_each(|i| values[at][i] += shift);
        }
        self.symbolic.factor(&self.rows, &self.columns, values, monitor)
    }

    /// Computes the 3 x 3 blocks in one patch's row of the coarse matrix. `places` is scratch memory, which is restored
    /// before returning.
    fn row(
        &self,
        k: usize,
        places: &mut [u32],
        pattern: &Pattern,
        blocks: &[[f64; 4]],
        turns: &[[Vec3; 2]],
    ) -> Vec<[f64; 9]> {
        let columns = &self.columns[self.rows[k] as usize..self.rows[k + 1] as usize];
        columns.iter().zip(0..).for_each(|(&l, place)| places[l as usize] = place);
        let mut row = vec![[0.0; 9]; columns.len()];
        for &(v, weight) in &self.members[self.members_of[k] as usize..self.members_of[k + 1] as usize] {
            let own = turns[v as usize].map(|turn| scale(turn, f64::from(weight)));
            for at in pattern.range(v as usize) {
                let w = pattern.columns[at];
                let [a, b, c, d] = blocks[at];
                // The 3 x 3 product P_v^T H_vw P_w. P_v has the two rows `turns[v]`, multiplied by the vertex's weight
                // in patch k, P_w the rows `turns[w]`, and H_vw is the block of the Hessian for the vertices v and w.
                let left = [add(scale(own[0], a), scale(own[1], c)), add(scale(own[0], b), scale(own[1], d))];
                let right = turns[w as usize];
                let mut product = [0.0; 9];
                for i in 0..3 {
                    for j in 0..3 {
                        product[3 * i + j] = left[0][i] * right[0][j] + left[1][i] * right[1][j];
                    }
                }
                let range = self.starts[w as usize] as usize..self.starts[w as usize + 1] as usize;
                for &(l, weight) in &self.weights[range] {
                    let block = &mut row[places[l as usize] as usize];
                    block.iter_mut().zip(product).for_each(|(sum, x)| *sum += f64::from(weight) * x);
                }
            }
        }
        columns.iter().for_each(|&l| places[l as usize] = NOWHERE);
        row
    }

    /// Solves the coarse system for a residual and adds the solution to `x`.
    pub(crate) fn correct(&self, factor: &Factor, turns: &[[Vec3; 2]], residual: &[[f64; 2]], x: &mut [[f64; 2]]) {
        let patches = self.rows.len() - 1;
        let gather = |k: usize| {
            let members = &self.members[self.members_of[k] as usize..self.members_of[k + 1] as usize];
            members.iter().fold([0.0; 3], |sum, &(v, weight)| {
                let ([a, b], [r, s]) = (turns[v as usize], residual[v as usize]);
                add(sum, scale(add(scale(a, r), scale(b, s)), f64::from(weight)))
            })
        };
        let mut solution: Vec<Vec3> = (0..patches).into_par_iter().with_min_len(64).map(gather).collect();
        factor.solve(solution.as_flattened_mut());
        x.par_iter_mut().enumerate().with_min_len(1024).for_each(|(v, x)| {
            let weights = &self.weights[self.starts[v] as usize..self.starts[v + 1] as usize];
            let turn = weights
                .iter()
                .fold([0.0; 3], |sum, &(k, weight)| add(sum, scale(solution[k as usize], f64::from(weight))));
            let [a, b] = turns[v];
            x[0] += dot(a, turn);
            x[1] += dot(b, turn);
        });
    }
}

/// Returns the two rows of the matrix that maps omega to omega x p in the frame (u, w) of p's tangent plane, using u .
/// (omega x p) = omega . (p x u).
pub(crate) fn turns(p: Vec3) -> [Vec3; 2] {
    let [u, w] = frame(p);
    [w, scale(u, -1.0)]
}

/// Covers all vertices with patches. A patch is a ball around a seed, with the given radius in edges. Seeds are farther
/// apart than the radius. Returns a list of (patch, vertex, weight).
fn balls(pattern: &Pattern, radius: usize) -> Vec<(u32, u32, f32)> {
    let n = pattern.rows();
    let mut found = Vec::with_capacity(3 * n);
    // For each vertex, the last patch that has reached it.
    let mut reached = vec![NOWHERE; n];
    let (mut shell, mut next) = (Vec::new(), Vec::new());
    let mut patch = 0;
    for seed in 0..n {
        if reached[seed] != NOWHERE {
            continue;
        }
        reached[seed] = patch;
        shell.push(seed as u32);
        for distance in 0..=radius {
            let weight = 1.0 - distance as f32 / (radius + 1) as f32;
            for &v in &shell {
                found.push((patch, v, weight));
                let row = pattern.columns_of(v);
                if distance == radius || row.len() > HUB {
                    continue;
                }
                for &w in row {
                    if reached[w as usize] != patch && pattern.columns_of(w).len() <= HUB {
                        reached[w as usize] = patch;
                        next.push(w);
                    }
                }
            }
            shell.clear();
            std::mem::swap(&mut shell, &mut next);
        }
        patch += 1;
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;
    use spharm_surface::generate::bipyramid;

    /// Returns the number of blocks in the coarse matrix of a bipyramid, divided by the bipyramid's number of sides.
    fn blocks(sides: u32) -> f64 {
        let pattern = Pattern::new(sides as usize + 2, &bipyramid(sides).faces);
        let coarse = Coarse::new(&pattern, &Silent).unwrap().unwrap();
        coarse.columns.len() as f64 / f64::from(sides)
    }

    #[test]
    fn patches_at_a_vertex_of_high_degree_dont_all_become_neighbours() {
        let (few, many) = (blocks(500), blocks(8000));
        assert!(many < 1.2 * few && many < 5.0, "{few} {many}");
    }
}
