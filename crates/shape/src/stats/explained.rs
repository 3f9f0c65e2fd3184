//! Computes the fraction of the scatter that the effect explains in relabelled studies.

use ndarray::{Array2, ArrayView2, Axis, s};
use rayon::prelude::*;

use super::arrangements::Relabelling;
use super::linear::{Small, floors};
use super::projection::Projection;
use crate::product::{COLUMNS, product};

/// Residuals prepared for evaluating the fraction of the scatter that the effect explains.
pub(crate) struct Explained<'a> {
    /// Residuals of the reduced model (n, V d), whitened so that the components of a vertex are uncorrelated.
    whitened: Array2<f64>,
    components: usize,
    model: &'a Projection,
    /// Whether relabelled residuals stay orthogonal to the reduced model.
    orthogonal: bool,
}

impl<'a> Explained<'a> {
    /// Prepares the evaluation from the residuals of the reduced model and the values, both (n, V d). `orthogonal`
    /// states whether relabelled residuals stay orthogonal to the reduced model.
    pub(crate) fn new(
        mut reduced: Array2<f64>,
        values: ArrayView2<'_, f64>,
        components: usize,
        model: &'a Projection,
        orthogonal: bool,
    ) -> Self {
        let floor = floors(values);
        let floor = floor.chunks(components).map(|floor| floor.iter().copied().fold(0.0, f64::max));
        let mut blocks: Vec<_> = reduced.axis_chunks_iter_mut(Axis(1), components).zip(floor).collect();
        blocks.par_iter_mut().for_each(|(block, floor)| {
            let mut scatter = Small::gram(block.view());
            if scatter.factorise(*floor) {
                let mut row = vec![0.0; components];
                for mut values in block.rows_mut() {
                    row.iter_mut().zip(&values).for_each(|(row, value)| *row = *value);
                    scatter.whiten(&mut row);
                    values.iter_mut().zip(&row).for_each(|(value, row)| *value = *row);
                }
            } else {
                block.fill(0.0);
            }
        });
        drop(blocks);
        Self { whitened: reduced, components, model, orthogonal }
    }

    /// Calls `use_it` for each relabelling and each range of vertices. The arguments are the index of the relabelling,
    /// the first vertex of the range, and the explained fractions in the range. For one component and a contrast of one
    /// row, fractions have the sign of the estimate.
    pub(crate) fn evaluate(&self, relabellings: &[Relabelling], mut use_it: impl FnMut(usize, usize, &[f64])) {
        let (effect, nuisance, d) = (&self.model.effect, &self.model.nuisance, self.components);
        let (q, z) = (effect.ncols(), if self.orthogonal { 0 } else { nuisance.ncols() });
        let each = q + z;
        let n = effect.nrows();
        // For each relabelling, the rows of the effect are followed by the rows of the reduced model.
        let mut rows = Array2::zeros((relabellings.len() * each, n));
        for (relabelling, mut rows) in relabellings.iter().zip(rows.axis_chunks_iter_mut(Axis(0), each)) {
            for (i, (from, sign)) in relabelling.iter().enumerate() {
                let from = *from as usize;
                (0..q).for_each(|k| rows[[k, i]] = sign * effect[[from, k]]);
                (0..z).for_each(|k| rows[[q + k, i]] = sign * nuisance[[from, k]]);
            }
        }
        let run = (COLUMNS / d).max(1);
        let vertices = self.whitened.ncols() / d;
        let mut found = vec![0.0; run];
        for first in (0..vertices).step_by(run) {
            let count = run.min(vertices - first);
            let products = product(rows.view(), self.whitened.slice(s![.., first * d..(first + count) * d]));
            for (which, products) in products.axis_chunks_iter(Axis(0), each).enumerate() {
                let found = &mut found[..count];
                if z == 0 {
                    found.fill(0.0);
                    for row in products.rows() {
                        let row = row.to_slice().unwrap_or_default();
                        for (found, b) in found.iter_mut().zip(row.chunks_exact(d)) {
                            *found += b.iter().map(|b| b * b).sum::<f64>();
                        }
                    }
                } else {
                    for (v, found) in found.iter_mut().enumerate() {
                        *found = explained(products.slice(s![.., v * d..(v + 1) * d]), q);
                    }
                }
                if q == 1 && d == 1 {
                    found.iter_mut().zip(products.row(0)).for_each(|(found, b)| *found = found.copysign(*b));
                }
                use_it(which, first, found);
            }
        }
    }
}

/// Returns the explained fraction `u = b (1 - g^T g)^-1 b^T`, summed over the rows of b, with b and g as defined in
/// [`permutation`](super::permutation). The first q rows of `products` are b, and the others are g.
fn explained(products: ArrayView2<'_, f64>, q: usize) -> f64 {
    let d = products.ncols();
    if d == 1 {
        let square = |row: usize| products[[row, 0]].powi(2);
        let left = 1.0 - (q..products.nrows()).map(square).sum::<f64>();
        return if left > 1e-13 { (0..q).map(square).sum::<f64>() / left } else { 0.0 };
    }
    let rows: Vec<Vec<f64>> = products.rows().into_iter().map(|row| row.to_vec()).collect();
    if rows.iter().flatten().all(|value| *value == 0.0) {
        return 0.0;
    }
    let mut scatter = Small::unit_without(d, rows[q..].iter().map(Vec::as_slice));
    if scatter.factorise(0.0) { rows[..q].iter().map(|b| scatter.quotient(b)).sum() } else { 0.0 }
}
