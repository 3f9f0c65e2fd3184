//! Computes the description length of a group and its derivatives with respect to the members' values.
//!
//! N members have C channels at n directions. x_i(u) are the values of member i, m(u) is their mean, and w(u) are
//! weights that sum to 1. Then
//!
//! ```text
//! G_ij = 1/N sum_u w(u) (x_i - m) . (x_j - m),    J = sum_k log(lambda_k(G) + delta) = log det(G + delta 1)
//! w(u) = mask(u) / N sum_i a_i(u) / A_i,    A_i = sum_u mask(u) a_i(u)
//! ```
//!
//! where lambda_k are the eigenvalues of G, delta is a positive constant, 1 is the identity matrix, and a_i(u) is a
//! third of the total area of the triangles around u on surface i (R. H. Davies et al., "A minimum description length
//! approach to statistical shape modeling", IEEE Trans. Med. Imaging 21, 2002; J. Cates et al., "Shape modeling and
//! analysis with entropy-based particle systems", IPMI 2007). Because weights follow the members' areas, J depends on
//! the surfaces but not on the density of directions, and doesn't change if all members are reparameterised in the same
//! way. The weights are differentiated as well. With fixed weights, a descent would gather directions in regions in
//! which members agree, although this doesn't decrease J with the correct weights. With `B = (G + delta 1)^-1` and y =
//! x - m,
//!
//! ```text
//! q(u) = dJ/dw(u) = 1/N sum_ij B_ij y_i . y_j,    dJ/dx_i = 2/N w sum_j B_ij y_j + sum_u q(u) dw(u)/dx_i
//! ```
//!
//! The first term of dJ/dx_i sums to 0 over the members, so the derivative of the mean contributes nothing.
//!
//! Cost: `2 N^2 n C` flops for a value, and as many for a gradient. Memory: three (N, n C) arrays.

use ndarray::{Array2, Axis};
use rayon::prelude::*;
use spharm_linalg::{Accum, Cholesky, Mat, MatMut, MatRef, matmul};
use spharm_surface::geometry::{Vec3, cross, dot, face_normal, scale, sub};

use crate::error::ShapeError;

/// Number of rows of a matrix product that one task computes, independent of the number of threads.
const ROWS: usize = 32;

/// Minimum of the regularisation delta, as a fraction of the mean area. Deviations of 1e-8 times the square root of the
/// area have this variance.
const ROUNDING: f64 = 1e-16;

/// Inputs of the objective that stay the same during a descent: triangles and weights.
pub(super) struct Objective<'a> {
    /// Triangles of the sphere.
    pub(super) faces: &'a [[u32; 3]],
    /// Non-negative weight of each direction (n).
    pub(super) mask: &'a [f64],
}

/// Covariance of a group whose members are mapped by given maps, with the data from which derivatives are computed.
pub(super) struct Covariance {
    /// The members' values minus the mean, y (N, n C).
    pub(super) centred: Array2<f64>,
    /// Mean of the members' values, m (n C).
    pub(super) mean: Vec<f64>,
    /// Weights of the directions, w (n).
    pub(super) weights: Vec<f64>,
    /// Area a_i(u) of each member i at each direction u (N, n).
    areas: Array2<f64>,
    /// Area A_i of each member inside the mask (N).
    totals: Vec<f64>,
    /// Covariance of the members, G (N, N).
    pub(super) gram: Array2<f64>,
}

impl Objective<'_> {
    /// Computes the covariance of the members' values (N, n C), whose first three channels are positions.
    pub(super) fn covariance(&self, mut values: Array2<f64>) -> Result<Covariance, ShapeError> {
        let (members, directions) = (values.nrows(), self.mask.len());
        let mut areas = Array2::zeros((members, directions));
        let rows = areas.axis_iter_mut(Axis(0)).into_par_iter().zip(values.axis_iter(Axis(0)).into_par_iter());
        let totals: Vec<f64> = rows
            .map(|(mut areas, row)| {
                let at = corners(row.as_slice().unwrap_or_default(), directions);
                for face in self.faces {
                    let normal = face_normal(face.map(|v| at(v as usize)));
                    let third = dot(normal, normal).sqrt() / 6.0;
                    face.iter().for_each(|&v| areas[v as usize] += third);
                }
                areas.iter().zip(self.mask).map(|(area, mask)| area * mask).sum()
            })
            .collect();
        if let Some(index) = totals.iter().position(|total| !(*total > 0.0 && total.is_finite())) {
            let source = Box::new(ShapeError::NoArea);
            return Err(ShapeError::Member { index, source });
        }
        let mut weights = vec![0.0; directions];
        for (row, total) in areas.rows().into_iter().zip(&totals) {
            let factor = 1.0 / (members as f64 * total);
            weights.iter_mut().zip(row).zip(self.mask).for_each(|((w, area), mask)| *w += factor * mask * area);
        }
        let mut mean = vec![0.0; values.ncols()];
        for row in values.rows() {
            mean.iter_mut().zip(row).for_each(|(m, x)| *m += x / members as f64);
        }
        values.axis_iter_mut(Axis(0)).into_par_iter().for_each(|mut row| {
            row.iter_mut().zip(&mean).for_each(|(x, m)| *x -= m);
        });
        let channels = mean.len() / directions;
        let mut scaled = values.clone();
        scaled.axis_iter_mut(Axis(0)).into_par_iter().for_each(|mut row| {
            let row = row.as_slice_mut().unwrap_or_default().chunks_exact_mut(channels);
            row.zip(&weights).for_each(|(y, w)| {
                let root = (w / members as f64).sqrt();
                y.iter_mut().for_each(|y| *y *= root);
            });
        });
        let gram = product(&scaled, &scaled, true);
        Ok(Covariance { centred: values, mean, weights, areas, totals, gram })
    }

    /// Returns the derivatives dJ/dx_i (N, n C) of the description length J with respect to the members' values x_i.
    /// `inverse` is the matrix `B = (G + delta 1)^-1` (see the module).
    pub(super) fn covectors(&self, of: &Covariance, inverse: &Array2<f64>) -> Array2<f64> {
        let (members, directions) = (of.centred.nrows(), self.mask.len());
        let channels = of.mean.len() / directions;
        let mut found = product(inverse, &of.centred, false);
        // The derivatives q(u) = dJ/dw(u) of the objective J with respect to the weights w(u), multiplied by the mask.
        let mut slopes = vec![0.0; directions];
        for (row, centred) in found.rows().into_iter().zip(of.centred.rows()) {
            let (row, centred) = (row.as_slice().unwrap_or_default(), centred.as_slice().unwrap_or_default());
            let pairs = row.chunks_exact(channels).zip(centred.chunks_exact(channels));
            for ((slope, mask), (b, y)) in slopes.iter_mut().zip(self.mask).zip(pairs) {
                *slope += mask / members as f64 * b.iter().zip(y).map(|(b, y)| b * y).sum::<f64>();
            }
        }
        let rows = found.axis_iter_mut(Axis(0)).into_par_iter().enumerate();
        rows.for_each(|(i, mut row)| {
            let row = row.as_slice_mut().unwrap_or_default();
            for (row, w) in row.chunks_exact_mut(channels).zip(&of.weights) {
                row.iter_mut().for_each(|b| *b *= 2.0 / members as f64 * w);
            }
            let total = of.totals[i];
            let average: f64 = slopes.iter().zip(of.areas.row(i)).map(|(q, area)| q * area).sum::<f64>() / total;
            let centred = of.centred.row(i);
            let centred = centred.as_slice().unwrap_or_default();
            let at =
                |v: usize| -> Vec3 { std::array::from_fn(|c| centred[v * channels + c] + of.mean[v * channels + c]) };
            for face in self.faces {
                let slope: f64 = face.iter().map(|&v| slopes[v as usize] - average * self.mask[v as usize]).sum();
                let [a, b, c] = face.map(|v| at(v as usize));
                let normal = face_normal([a, b, c]);
                let double = dot(normal, normal).sqrt();
                if double == 0.0 {
                    continue;
                }
                // The derivative of a triangle's area with respect to its corner a is n x (c - b) / 2, with the unit
                // normal n.
                let n = scale(normal, slope / (6.0 * members as f64 * total * double));
                for (v, along) in face.iter().zip([sub(c, b), sub(a, c), sub(b, a)]) {
                    let g = &mut row[*v as usize * channels..][..3];
                    let by = cross(n, along);
                    (0..3).for_each(|k| g[k] += by[k]);
                }
            }
        });
        found
    }
}

impl Covariance {
    /// Returns the sum of the variances, which is the trace of G.
    pub(super) fn total(&self) -> f64 {
        self.gram.diag().sum()
    }

    /// Returns delta, the constant that the objective adds to every variance. It is the fraction `share` of the sum of
    /// variances, but at least [`ROUNDING`] times the mean area, so that it is positive even for identical members.
    pub(super) fn delta(&self, share: f64) -> f64 {
        let area = self.totals.iter().sum::<f64>() / self.totals.len() as f64;
        (share * self.total()).max(ROUNDING * area)
    }

    /// Returns the description length J and the matrix `B = (G + delta 1)^-1`, for a delta above 0.
    pub(super) fn description_length(&self, delta: f64) -> Result<(f64, Array2<f64>), ShapeError> {
        let n = self.gram.nrows();
        let matrix = Mat::from_fn(n, n, |i, j| self.gram[[i, j]] + if i == j { delta } else { 0.0 });
        let factor = Cholesky::new(matrix.as_ref()).map_err(|_| ShapeError::NoDecomposition)?;
        let inverse = factor.inverse();
        Ok((factor.log_determinant(), Array2::from_shape_fn((n, n), |(i, j)| inverse[(i.max(j), i.min(j))])))
    }
}

/// Returns a function from the index of a direction to the position at this direction, given a member's row of values.
pub(super) fn corners(row: &[f64], directions: usize) -> impl Fn(usize) -> Vec3 {
    let channels = row.len() / directions.max(1);
    move |v| std::array::from_fn(|c| row[v * channels + c])
}

/// Returns `A B`, or `A B^T` if `transposed` is true, computed in blocks of rows.
fn product(a: &Array2<f64>, b: &Array2<f64>, transposed: bool) -> Array2<f64> {
    let (depth, columns) = (a.ncols(), if transposed { b.nrows() } else { b.ncols() });
    let mut out = Array2::zeros((a.nrows(), columns));
    let whole = b.as_slice().unwrap_or_default();
    let whole = MatRef::from_row_major_slice(whole, b.nrows(), b.ncols());
    let whole = if transposed { whole.transpose() } else { whole };
    let rows = out.as_slice_mut().unwrap_or_default().par_chunks_mut(ROWS * columns);
    rows.zip(a.as_slice().unwrap_or_default().par_chunks(ROWS * depth)).for_each(|(out, a)| {
        let count = a.len() / depth;
        let a = MatRef::from_row_major_slice(a, count, depth);
        matmul(MatMut::from_row_major_slice_mut(out, count, columns), Accum::Replace, a, whole, 1.0);
    });
    out
}
