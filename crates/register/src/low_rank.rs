//! Approximates the matrix K of a Gaussian kernel by a product of low rank, `K = F F^T`. The kernel of width w is
//! `k(y, y') = exp(-|y - y'|^2 / (2 w^2))`.
//!
//! F is computed by a pivoted Cholesky factorisation that ends when no diagonal entry of the remainder exceeds a
//! tolerance: N. Higham, "Analysis of the Cholesky decomposition of a semi-definite matrix" (1990). The rows of F at
//! further points (places) follow from the same pivots, so that a displacement `F a` of the points extends to all of
//! space. Cost: `(n + m) r^2` flops, and `n + m` exponentials per column.

use rayon::prelude::*;
use spharm_surface::geometry::{Vec3, dot, sub};

/// A factor of the kernel. The factor has rows for the points, from which the pivots are chosen, and rows for further
/// points, called places.
pub struct LowRank {
    /// Number of columns, r.
    pub rank: usize,
    /// The factor's rows for the n points: an array (n, r) in row-major order.
    pub points: Vec<f64>,
    /// The factor's rows for the m places: an array (m, r) in row-major order.
    pub places: Vec<f64>,
}

/// Number of rows per parallel task.
const ROWS: usize = 512;

impl LowRank {
    /// Computes the factor of the kernel of the given width at `points`. Columns are added until no diagonal entry of
    /// the remainder exceeds `tolerance`, or until there are `most` columns.
    #[must_use]
    pub fn new(points: &[Vec3], places: &[Vec3], width: f64, most: usize, tolerance: f64) -> Self {
        let all: Vec<Vec3> = points.iter().chain(places).copied().collect();
        let mut rest: Vec<f64> = vec![1.0; points.len()];
        let mut factor = vec![0.0; all.len() * most];
        let mut rank = 0;
        while rank < most {
            let largest = (0..points.len()).max_by(|a, b| rest[*a].total_cmp(&rest[*b]).then(b.cmp(a)));
            let Some(pivot) = largest.filter(|at| rest[*at] > tolerance) else { break };
            let (diagonal, at) = (rest[pivot].sqrt(), all[pivot]);
            let row: Vec<f64> = factor[pivot * most..pivot * most + rank].to_vec();
            factor.par_chunks_mut(ROWS * most).zip(all.par_chunks(ROWS)).for_each(|(rows, all)| {
                for (own, point) in rows.chunks_exact_mut(most).zip(all) {
                    let off = sub(*point, at);
                    let kernel = (-dot(off, off) / (2.0 * width * width)).exp();
                    let known: f64 = own.iter().zip(&row).map(|(a, b)| a * b).sum();
                    own[rank] = (kernel - known) / diagonal;
                }
            });
            for (i, rest) in rest.iter_mut().enumerate() {
                *rest -= factor[i * most + rank].powi(2);
            }
            rest[pivot] = 0.0;
            rank += 1;
        }
        let mut rows = factor.chunks_exact(most.max(1)).map(|row| &row[..rank]);
        let points = rows.by_ref().take(points.len()).flatten().copied().collect();
        Self { rank, points, places: rows.flatten().copied().collect() }
    }

    /// Returns the displacements `F a`, where F is the factor with the given rows and a are coefficients (r, 3).
    #[must_use]
    pub fn displacements(rank: usize, rows: &[f64], coefficients: &[Vec3]) -> Vec<Vec3> {
        let row = |row: &[f64]| {
            let mut sum = [0.0; 3];
            for (f, a) in row.iter().zip(coefficients) {
                (0..3).for_each(|k| sum[k] += f * a[k]);
            }
            sum
        };
        rows.par_chunks_exact(rank.max(1)).with_min_len(ROWS).map(row).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_surface::generate::icosphere;

    #[test]
    fn products_of_rows_are_the_kernel() {
        let (points, places) = (icosphere(3).vertices, icosphere(2).vertices);
        let places: Vec<Vec3> = places.iter().map(|p| p.map(|v| 1.01 * v)).collect();
        let factor = LowRank::new(&points, &places, 0.8, 200, 1e-8);
        assert!((20..200).contains(&factor.rank), "{}", factor.rank);
        let row = |i: usize, of: &[f64]| of[i * factor.rank..(i + 1) * factor.rank].to_vec();
        for i in (0..points.len()).step_by(37) {
            for j in (0..places.len()).step_by(11) {
                let off = sub(points[i], places[j]);
                let expected = (-dot(off, off) / 1.28).exp();
                let found: f64 = row(i, &factor.points).iter().zip(row(j, &factor.places)).map(|(a, b)| a * b).sum();
                assert!((found - expected).abs() < 2e-4, "{i} {j}: {found} {expected}");
            }
        }
    }
}
