//! Evaluates energies and derivatives of many triangles at once in SIMD registers.

use multiversion::multiversion;

use crate::density::{Balanced, Density, Stretch};
use crate::energy::{Energy, Shape};
use crate::geometry::Vec3;
use crate::local::{INPUTS, NUMBERS, derivatives, value};

/// Number of triangles per batch.
pub(crate) const BATCH: usize = 64;

/// Inputs of up to [`BATCH`] triangles, one array per input. A triangle has 13 inputs: nine coordinates, three
/// cotangents and the area.
pub(crate) struct Batch([[f64; BATCH]; INPUTS]);

/// Results of [`derivatives`](Batch::derivatives) for a batch: one array per result, with an entry for each triangle.
pub(crate) type Numbers = [[f64; BATCH]; NUMBERS];

impl Batch {
    /// Returns a batch in which every lane holds a regular triangle. Unused lanes then produce no subnormal, infinite
    /// or NaN results, which are slow to compute.
    pub(crate) fn new() -> Self {
        let sound = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.5, 0.5, 0.5, 1.0];
        Self(sound.map(|number| [number; BATCH]))
    }

    /// Stores the inputs of a triangle in a lane of the batch.
    #[inline(always)]
    pub(crate) fn set(&mut self, lane: usize, corners: [Vec3; 3], shape: &Shape) {
        for (corner, p) in corners.iter().enumerate() {
            for (axis, x) in p.iter().enumerate() {
                self.0[3 * corner + axis][lane] = *x;
            }
        }
        for (corner, cotangent) in shape.cotangents.iter().enumerate() {
            self.0[9 + corner][lane] = *cotangent;
        }
        self.0[12][lane] = shape.area;
    }

    /// Computes the energies of the first `count` triangles; later entries of `out` are unspecified.
    pub(crate) fn values(&self, energy: Energy, count: usize, out: &mut [f64; BATCH]) {
        match energy {
            Energy::Balanced { area, shape, bound } => {
                balanced_values(self, Balanced { area, shape, bound }, count, out)
            }
            Energy::Stretch { shrink } => stretch_values(self, Stretch { shrink }, count, out),
        }
    }

    /// Computes the energies, gradients and Hessians of the first `count` triangles; later entries of `out` are
    /// unspecified.
    pub(crate) fn derivatives(&self, energy: Energy, count: usize, out: &mut Numbers) {
        match energy {
            Energy::Balanced { area, shape, bound } => {
                balanced_derivatives(self, Balanced { area, shape, bound }, count, out);
            }
            Energy::Stretch { shrink } => stretch_derivatives(self, Stretch { shrink }, count, out),
        }
    }

    #[inline(always)]
    fn corners(&self, lane: usize) -> [Vec3; 3] {
        let n = &self.0;
        [
            [n[0][lane], n[1][lane], n[2][lane]],
            [n[3][lane], n[4][lane], n[5][lane]],
            [n[6][lane], n[7][lane], n[8][lane]],
        ]
    }

    #[inline(always)]
    fn cotangents(&self, lane: usize) -> [f64; 3] {
        [self.0[9][lane], self.0[10][lane], self.0[11][lane]]
    }
}

/// Number of lanes computed together. The number of triangles in a batch is rounded up to a multiple of this number.
const LANES: usize = 8;

#[inline(always)]
fn all_values<D: Density>(batch: &Batch, density: D, count: usize, out: &mut [f64; BATCH]) {
    for (lane, out) in out[..count.next_multiple_of(LANES)].iter_mut().enumerate() {
        *out = value(density, batch.corners(lane), batch.cotangents(lane), batch.0[12][lane]);
    }
}

#[inline(always)]
fn all_derivatives<D: Density>(batch: &Batch, density: D, count: usize, out: &mut Numbers) {
    for lane in 0..count.next_multiple_of(LANES) {
        let numbers = derivatives(density, batch.corners(lane), batch.cotangents(lane), batch.0[12][lane]);
        for (row, number) in out.iter_mut().zip(numbers) {
            row[lane] = number;
        }
    }
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn balanced_values(batch: &Batch, density: Balanced, count: usize, out: &mut [f64; BATCH]) {
    all_values(batch, density, count, out);
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn stretch_values(batch: &Batch, density: Stretch, count: usize, out: &mut [f64; BATCH]) {
    all_values(batch, density, count, out);
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn balanced_derivatives(batch: &Batch, density: Balanced, count: usize, out: &mut Numbers) {
    all_derivatives(batch, density, count, out);
}

#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
fn stretch_derivatives(batch: &Batch, density: Stretch, count: usize, out: &mut Numbers) {
    all_derivatives(batch, density, count, out);
}
