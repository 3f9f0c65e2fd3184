//! Where on the sphere samples are, to a resolution of half a wavelength.
//!
//! The sphere is cut into bands of equal height in colatitude, and each band into cells that are about as wide as high,
//! `pi / (2 (L + 1))`. A bit for each cell says whether a sample with weight lies in it.

use std::sync::atomic::{AtomicU8, Ordering};

/// A bit for each cell of the sphere: whether there is a sample in it.
#[derive(Debug)]
pub struct Occupied {
    /// First cell of each band, and at the end the number of cells.
    first: Vec<u32>,
    bits: Vec<AtomicU8>,
}

impl Occupied {
    /// Makes the empty cells for fits to degree L = `max_degree`.
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

    /// Takes the bits that [`bytes`](Self::bytes) gave for the same degree; `None` if there aren't as many.
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

    /// Returns the bits, bit i of the list in bit `i % 8` of byte `i / 8`. Cells go from the north pole to the south
    /// pole, and along each band from azimuth 0.
    pub fn bytes(&self) -> Vec<u8> {
        self.bits.iter().map(|byte| byte.load(Ordering::Relaxed)).collect()
    }

    /// Adds the cells of other samples for the same degree.
    pub fn merge(&mut self, other: &Self) {
        for (byte, other) in self.bits.iter_mut().zip(&other.bits) {
            *byte.get_mut() |= other.load(Ordering::Relaxed);
        }
    }

    /// Marks samples at places of a grid of `grid` points around.
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
            // Most cells are marked already, and a cache line that is only read can be shared.
            if byte.load(Ordering::Relaxed) & bit == 0 {
                byte.fetch_or(bit, Ordering::Relaxed);
            }
        }
    }

    /// Returns the centres of the cells that are marked, or of those that aren't: unit vectors.
    pub fn centres(&self, marked: bool) -> Vec<[f64; 3]> {
        let bands = self.first.len() - 1;
        let mut found = Vec::new();
        for band in 0..bands {
            let (sine, cosine) = ((band as f64 + 0.5) * std::f64::consts::PI / bands as f64).sin_cos();
            let around = self.first[band + 1] - self.first[band];
            for column in 0..around {
                let at = (self.first[band] + column) as usize;
                if (self.bits[at / 8].load(Ordering::Relaxed) >> (at % 8) & 1 == 1) == marked {
                    let (s, c) = ((f64::from(column) + 0.5) * std::f64::consts::TAU / f64::from(around)).sin_cos();
                    found.push([sine * c, sine * s, cosine]);
                }
            }
        }
        found
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
