//! Records the cells of the sphere that contain samples, at a resolution of half a wavelength.
//!
//! The sphere is cut into bands of equal height in colatitude, and each band into cells that are about as wide as
//! high, `pi / (2 (L + 1))`. A bit for each cell says whether the cell contains a sample of nonzero weight.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::sync::atomic::{AtomicU8, Ordering};

/// The set of the sphere's cells that contain a sample, stored as one bit per cell.
#[derive(Debug)]
pub struct Occupied {
    /// Index of the first cell of each band, followed by the total number of cells.
    first: Vec<u32>,
    bits: Vec<AtomicU8>,
}

impl Occupied {
    /// Creates empty cells for fits to degree L = `max_degree`.
    pub fn new(max_degree: usize) -> Self {
        let bands = 2 * (max_degree + 1);
        let height = std::f64::consts::PI / bands as f64;
        let mut first = vec![0];
        for band in 0..bands {
            let around = 2.0 * bands as f64 * ((band as f64 + 0.5) * height).sin();
            first.push(first[band] + (around.round() as u32).max(3));
        }
        let bytes = (first[bands] as usize).div_ceil(8);
        Self { first, bits: (0..bytes).map(|_| AtomicU8::new(0)).collect() }
    }

    /// Restores the cells from the result of [`bytes`](Self::bytes) for the same degree. Returns `None` if the number
    /// of bytes doesn't match, or if an unused bit of the last byte is set.
    pub fn from_bytes(max_degree: usize, bytes: &[u8]) -> Option<Self> {
        let mut cells = Self::new(max_degree);
        let spare = 8 * bytes.len() - (cells.first[cells.first.len() - 1] as usize).min(8 * bytes.len());
        let clear = bytes.last().is_none_or(|last| u32::from(*last) >> (8 - spare.min(8)) == 0);
        if bytes.len() != cells.bits.len() || !clear {
            return None;
        }
        cells.bits = bytes.iter().copied().map(AtomicU8::new).collect();
        Some(cells)
    }

    /// Returns the bits of all cells; the bit of cell i is bit `i % 8` of byte `i / 8`. Cells are numbered from the
    /// north pole to the south pole, and along each band from azimuth 0.
    pub fn bytes(&self) -> Vec<u8> {
        self.bits.iter().map(|byte| byte.load(Ordering::Relaxed)).collect()
    }

    /// Adds the cells of `other`, which must be for the same degree.
    pub fn merge(&mut self, other: &Self) {
        for (byte, other) in self.bits.iter_mut().zip(&other.bits) {
            *byte.get_mut() |= other.load(Ordering::Relaxed);
        }
    }

    /// Returns the number of cells that contain samples.
    pub fn count(&self) -> usize {
        self.bits.iter().map(|byte| byte.load(Ordering::Relaxed).count_ones() as usize).sum()
    }

    /// Marks the cells that contain samples. Samples are given by their cells and positions on a grid of `grid` points
    /// around the sphere.
    pub(super) fn mark(&self, cells: &[[u32; 2]], fractions: &[[f64; 2]], grid: usize) {
        let bands = self.first.len() - 1;
        let turns = 1.0 / grid as f64;
        for (cell, fraction) in cells.iter().zip(fractions) {
            let turn = |i: usize| (f64::from(cell[i]) + fraction[i]) * turns;
            let band = ((2.0 * turn(0) * bands as f64) as usize).min(bands - 1);
            let around = self.first[band + 1] - self.first[band];
            let column = ((turn(1) * f64::from(around)) as u32).min(around - 1);
            let at = (self.first[band] + column) as usize;
            let (byte, bit) = (&self.bits[at / 8], 1 << (at % 8));
            // The bit is read before it is written, because most cells are already marked, and threads can share a
            // cache line that is only read.
            if byte.load(Ordering::Relaxed) & bit == 0 {
                byte.fetch_or(bit, Ordering::Relaxed);
            }
        }
    }

    /// Returns the diameter of the largest cap without samples, in radians, to within three cells; 0 if all cells
    /// contain samples, and 2 pi if none does.
    ///
    /// Cells are visited in the order of their distance from the nearest sample. Each cell adopts the nearest sample of
    /// the neighbour from which the cell is reached.
    pub fn largest_gap(&self) -> f64 {
        let cells = self.first[self.first.len() - 1];
        let taken = |cell: u32| self.bits[cell as usize / 8].load(Ordering::Relaxed) >> (cell % 8) & 1 == 1;
        let mut reached: Vec<bool> = (0..cells).map(taken).collect();
        if reached.iter().all(|reached| !reached) {
            return 2.0 * std::f64::consts::PI;
        }
        let mut next = BinaryHeap::new();
        let mut gap = 0.0f64;
        let spread = |cell: u32, source: u32, reached: &[bool], next: &mut BinaryHeap<_>| {
            let from = self.centre(source);
            self.neighbours(cell, |neighbour| {
                if !reached[neighbour as usize] {
                    let to = self.centre(neighbour);
                    let chord: f64 = (0..3).map(|i| (to[i] - from[i]).powi(2)).sum();
                    // The bits of positive doubles, as integers, have the same order as the doubles.
                    next.push((Reverse(chord.to_bits()), neighbour, source));
                }
            });
        };
        for cell in (0..cells).filter(|cell| taken(*cell)) {
            spread(cell, cell, &reached, &mut next);
        }
        while let Some((Reverse(chord), cell, source)) = next.pop() {
            if !std::mem::replace(&mut reached[cell as usize], true) {
                gap = gap.max(f64::from_bits(chord));
                spread(cell, source, &reached, &mut next);
            }
        }
        4.0 * (gap.sqrt() / 2.0).min(1.0).asin()
    }

    fn band(&self, cell: u32) -> usize {
        self.first.partition_point(|first| *first <= cell) - 1
    }

    fn centre(&self, cell: u32) -> [f64; 3] {
        let (band, bands) = (self.band(cell), self.first.len() - 1);
        let (column, around) = (cell - self.first[band], self.first[band + 1] - self.first[band]);
        let (sine, cosine) = ((band as f64 + 0.5) * std::f64::consts::PI / bands as f64).sin_cos();
        let (s, c) = ((f64::from(column) + 0.5) * std::f64::consts::TAU / f64::from(around)).sin_cos();
        [sine * c, sine * s, cosine]
    }

    /// Calls `visit` with the cells to the left and right of a cell, above it and below it. Next to a pole, also calls
    /// `visit` with all cells of the cell's band.
    fn neighbours(&self, cell: u32, mut visit: impl FnMut(u32)) {
        let band = self.band(cell);
        let around = |band: usize| self.first[band + 1] - self.first[band];
        let (column, own) = (cell - self.first[band], around(band));
        visit(self.first[band] + (column + 1) % own);
        visit(self.first[band] + (column + own - 1) % own);
        let bands = self.first.len() - 1;
        for other in [band.checked_sub(1), Some(band + 1).filter(|other| *other < bands)].into_iter().flatten() {
            let there = u64::from(around(other));
            let from = u64::from(column) * there / u64::from(own);
            let to = (u64::from(column + 1) * there).div_ceil(u64::from(own));
            (from..to).for_each(|column| visit(self.first[other] + column as u32));
        }
        if band == 0 || band + 1 == bands {
            (0..own).for_each(|column| visit(self.first[band] + column));
        }
    }
}

impl Clone for Occupied {
    fn clone(&self) -> Self {
        Self { first: self.first.clone(), bits: self.bytes().into_iter().map(AtomicU8::new).collect() }
    }
}

impl PartialEq for Occupied {
    fn eq(&self, other: &Self) -> bool {
        self.first == other.first && self.bytes() == other.bytes()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cells::place;

    fn marked(max_degree: usize, directions: &[[f64; 3]]) -> Occupied {
        let occupied = Occupied::new(max_degree);
        let mut places = vec![([0; 2], [0.0; 2]); directions.len()];
        place(directions, 1024, &mut places);
        for (cell, fraction) in places {
            occupied.mark(&[cell], &[fraction], 1024);
        }
        occupied
    }

    #[test]
    fn the_largest_gap_is_found_to_three_cells() {
        assert_eq!(Occupied::new(5).largest_gap(), std::f64::consts::TAU);
        let everywhere = spharm_harmonics::Directions::fibonacci(60_000).unwrap();
        assert_eq!(marked(20, everywhere.as_slice()).largest_gap(), 0.0);
        // Samples everywhere except in one cap, whose centre is a pole, on the seam, or elsewhere.
        for (centre, radius) in [([0.0, 0.0, 1.0], 0.4f64), ([1.0, 0.0, 0.0], 0.7), ([-0.48, 0.6, -0.64], 1.1)] {
            let outside = |v: &&[f64; 3]| (0..3).map(|i| v[i] * centre[i]).sum::<f64>() < radius.cos();
            let rest: Vec<[f64; 3]> = everywhere.as_slice().iter().filter(outside).copied().collect();
            let found = marked(20, &rest).largest_gap();
            // The gap's diameter is twice a radius, and each end of a radius is uncertain by half a cell's diagonal.
            assert!((found - 2.0 * radius).abs() < 3.0 * std::f64::consts::PI / 42.0, "{found} {radius}");
        }
        // With a single sample, the gap covers all cells but one.
        assert!(marked(20, &[[0.0, 0.6, 0.8]]).largest_gap() > 6.0);
    }

    #[test]
    fn bits_return() {
        let some = marked(3, &[[0.0, 0.0, 1.0], [0.0, 0.6, -0.8]]);
        let bytes = some.bytes();
        assert_eq!(some.count(), 2);
        assert_eq!(Occupied::from_bytes(3, &bytes).unwrap(), some);
        assert!(Occupied::from_bytes(4, &bytes).is_none());
    }
}
