//! Computes the steps of a transform between coefficients and the oversampled grid, and their transposes.

use ndarray::Array2;
use rayon::prelude::*;
use rustfft::num_complex::Complex64;
use spharm_harmonics::index::basis_size;

use super::Transform;
use crate::fourier::RingPair;
use crate::grid::Layout;
use crate::legendre::SomeColumns;
use crate::workspace::{ThreadWorkspace, Workspace};

impl Transform {
    /// Computes coefficients (K, c) from a grid, including its margins, to which the values of c channels have been
    /// spread.
    pub(crate) fn coefficients_of_grid(&self, grid: Vec<f64>, channels: usize) -> Array2<f64> {
        let layout = self.layout(channels);
        let complex = Complex64::default();
        let mut space = Workspace {
            circles: vec![complex; self.fourier.order_pairs() * channels * self.gridding.grid],
            spectra: vec![complex; layout.core_rows() * channels * (self.max_degree + 1)],
            grids: [Vec::new(), grid],
            samples: Vec::new(),
            by_order: vec![0.0; (self.max_degree + 1) * (self.max_degree + 2) * channels],
        };
        let mut coefficients = Array2::zeros((basis_size(self.max_degree), channels));
        self.coefficients_of(layout, &mut space, coefficients.view_mut());
        coefficients
    }

    /// Evaluates the functions with the coefficients in `channels` columns on the first grid, and fills the grid's
    /// margins. Returns the grid's layout.
    pub(super) fn grid_of(&self, coefficients: SomeColumns<'_>, channels: usize, space: &mut Workspace) -> Layout {
        let (columns, rings) = (2 * channels, self.legendre.rings());
        let layout = self.layout(channels);
        space.circles.par_chunks_mut(channels * self.gridding.grid).enumerate().with_max_len(1).for_each_init(
            || (ThreadWorkspace::new(columns, rings, self.max_degree), self.fourier.work()),
            |(scratch, fourier_work), (pair, circles)| {
                for parity in 0..2 {
                    let m = 2 * pair + parity;
                    let [even, odd] = &mut scratch.sums[parity];
                    if m > self.max_degree {
                        even.fill(0.0);
                        odd.fill(0.0);
                        continue;
                    }
                    let factor = self.order_factor[m] * if m == 0 { 1.0 } else { 0.5 };
                    let x = &mut scratch.x;
                    self.legendre.scaled(m, factor, coefficients, channels, x);
                    self.legendre.synthesis(m, x, columns, even, odd, &mut scratch.work);
                }
                let [[ee, eo], [oe, oo]] = &scratch.sums;
                for (channel, circle) in circles.chunks_exact_mut(self.gridding.grid).enumerate() {
                    let ring = |j: usize| {
                        let at = 2 * channel * rings + j;
                        let pair = |sums: &[f64]| Complex64::new(sums[at], sums[at + rings]);
                        RingPair { even_order: [pair(ee), pair(eo)], odd_order: [pair(oe), pair(oo)] }
                    };
                    self.fourier.rings_to_circle(ring, circle, fourier_work);
                }
            },
        );
        self.fourier.circles_to_grid(&space.circles, layout, &mut space.grids[0]);
        layout.extend(&mut space.grids[0]);
        layout
    }

    /// Computes coefficients from the second grid of `space`, including its margins: the transpose of
    /// [`grid_of`](Self::grid_of).
    pub(super) fn coefficients_of(&self, layout: Layout, space: &mut Workspace, out: ndarray::ArrayViewMut2<'_, f64>) {
        let channels = layout.channels;
        let (columns, rings) = (2 * channels, self.legendre.rings());
        layout.fold(&mut space.grids[1]);
        self.fourier.grid_to_circles(&mut space.grids[1], layout, &mut space.spectra, &mut space.circles);
        // Each pair of an even order and the next odd order gets its own part of `by_order`.
        let mut rest = &mut space.by_order[..];
        let mut parts = Vec::with_capacity(self.fourier.order_pairs());
        for pair in 0..self.fourier.order_pairs() {
            let degrees = |m: usize| (self.max_degree + 1).saturating_sub(m);
            let (part, tail) = rest.split_at_mut((degrees(2 * pair) + degrees(2 * pair + 1)) * columns);
            parts.push(part);
            rest = tail;
        }
        parts
            .into_par_iter()
            .zip(space.circles.par_chunks_mut(channels * self.gridding.grid))
            .enumerate()
            .with_max_len(1)
            .for_each_init(
                || (ThreadWorkspace::new(columns, rings, self.max_degree), self.fourier.work()),
                |(scratch, fourier_work), (pair, (part, circles))| {
                    for (channel, circle) in circles.chunks_exact_mut(self.gridding.grid).enumerate() {
                        let [[ee, eo], [oe, oo]] = &mut scratch.sums;
                        let ring = |j: usize, pair: RingPair| {
                            let at = 2 * channel * rings + j;
                            for (sums, value) in [
                                (&mut *ee, pair.even_order[0]),
                                (eo, pair.even_order[1]),
                                (oe, pair.odd_order[0]),
                                (oo, pair.odd_order[1]),
                            ] {
                                (sums[at], sums[at + rings]) = (value.re, value.im);
                            }
                        };
                        self.fourier.circle_to_rings(circle, ring, fourier_work);
                    }
                    let degrees = self.max_degree + 1 - 2 * pair;
                    let (even_order, odd_order) = part.split_at_mut(degrees * columns);
                    for (parity, x) in [even_order, odd_order].into_iter().enumerate() {
                        let m = 2 * pair + parity;
                        if m > self.max_degree {
                            continue;
                        }
                        let [even, odd] = &mut scratch.sums[parity];
                        self.legendre.adjoint(m, even, odd, columns, x, &mut scratch.work);
                        for (x, scale) in x.chunks_exact_mut(columns).zip(self.legendre.scale(m)) {
                            for x in x {
                                *x *= self.order_factor[m] * scale;
                            }
                        }
                    }
                },
            );
        self.legendre.to_canonical(&space.by_order, out);
    }
}
