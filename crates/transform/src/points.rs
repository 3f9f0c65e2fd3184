//! The directions sorted for interpolation: by strips of the grid's rows, and by columns along a strip.

use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use crate::TransformError;
use crate::cells::{Place, place};

/// Columns of a tile; points are sorted by tiles. A tile with the rows of its strip fits the L1 cache.
const TILE_COLUMNS: usize = 16;

/// Runs that directions are sorted in, and the least length of one.
const RUNS: usize = 16;
const LEAST_RUN: usize = 1 << 13;

/// The directions' positions on the grid, sorted. A *place* is an index in sorted order.
#[derive(Debug)]
pub(crate) struct Points {
    /// The place of each direction.
    rank: Vec<u32>,
    /// The direction at each place.
    order: Vec<u32>,
    /// At each place, row and column of the grid cell.
    pub(crate) cells: Vec<[u32; 2]>,
    /// At each place, the position in the cell along rows and columns, in [0, 1).
    pub(crate) fractions: Vec<[f64; 2]>,
    /// First place of each strip, and at the end the number of places.
    pub(crate) strips: Vec<usize>,
}

impl Points {
    /// Sorts directions for a grid of `grid` points around, into strips of `strip_rows` rows.
    pub(crate) fn new(directions: &[[f64; 3]], grid: usize, strip_rows: usize) -> Result<Self, TransformError> {
        let max = u32::MAX as usize;
        if directions.len() > max {
            return Err(TransformError::TooManyDirections { found: directions.len(), max });
        }
        let tiles = grid.div_ceil(TILE_COLUMNS);
        let strip_count = (grid / 2 + 1).div_ceil(strip_rows);
        let buckets = strip_count * tiles;
        let bucket = |cell: [u32; 2]| cell[0] as usize / strip_rows * tiles + cell[1] as usize / TILE_COLUMNS;
        // A stable counting sort by buckets, of runs of directions at once.
        let run = directions.len().div_ceil(RUNS).max(LEAST_RUN);
        let mut places: Vec<Place> = vec![([0; 2], [0.0; 2]); directions.len()];
        let mut counts: Vec<Vec<u32>> = places
            .par_chunks_mut(run)
            .zip(directions.par_chunks(run))
            .map(|(places, directions)| {
                let mut counts = vec![0u32; buckets];
                place(directions, grid, places);
                for (cell, _) in places {
                    counts[bucket(*cell)] += 1;
                }
                counts
            })
            .collect();
        // Counts become the first places of each run in each bucket.
        let (mut next, mut strips) = (0u32, Vec::with_capacity(strip_count + 1));
        for at in 0..buckets {
            if at % tiles == 0 {
                strips.push(next as usize);
            }
            for counts in &mut counts {
                (counts[at], next) = (next, next + counts[at]);
            }
        }
        strips.push(next as usize);
        let mut rank = vec![0u32; places.len()];
        // Threads write to places of each other's neighbourhood: a relaxed store is a plain one.
        let order: Vec<AtomicU32> = (0..places.len()).into_par_iter().map(|_| AtomicU32::new(0)).collect();
        rank.par_chunks_mut(run).zip(places.par_chunks(run)).zip(&mut counts).enumerate().for_each(
            |(first, ((rank, places), next))| {
                for (i, (rank, (cell, _))) in rank.iter_mut().zip(places).enumerate() {
                    let next = &mut next[bucket(*cell)];
                    *rank = *next;
                    order[*next as usize].store((first * run + i) as u32, Ordering::Relaxed);
                    *next += 1;
                }
            },
        );
        let order: Vec<u32> = order.into_par_iter().map(AtomicU32::into_inner).collect();
        let (mut cells, mut fractions) = (Vec::new(), Vec::new());
        order.par_iter().map(|&i| places[i as usize]).unzip_into_vecs(&mut cells, &mut fractions);
        Ok(Self { rank, order, cells, fractions, strips })
    }

    /// Number of directions, n.
    pub(crate) fn len(&self) -> usize {
        self.order.len()
    }

    /// Bytes held for a number of directions; `new` takes twice that.
    pub(crate) const fn bytes(directions: usize) -> usize {
        directions * (2 * 4 + 8 + 16)
    }

    /// The direction at a place.
    pub(crate) fn direction(&self, place: usize) -> usize {
        self.order[place] as usize
    }

    /// The direction at each place.
    pub(crate) fn order(&self) -> &[u32] {
        &self.order
    }

    /// The place of each direction.
    pub(crate) fn ranks(&self) -> &[u32] {
        &self.rank
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_direction_has_one_place_and_strips_are_in_order() {
        let directions: Vec<[f64; 3]> = (0..500)
            .map(|i| {
                let (t, p) = (f64::from(i) * 0.00628, f64::from(i) * 2.4);
                [t.sin() * p.cos(), t.sin() * p.sin(), t.cos()]
            })
            .collect();
        let points = Points::new(&directions, 64, 16).unwrap();
        let mut seen = vec![false; 500];
        for at in 0..500 {
            seen[points.direction(at)] = true;
            assert_eq!(points.ranks()[points.direction(at)] as usize, at);
        }
        assert!(seen.into_iter().all(|s| s));
        assert_eq!((points.strips[0], points.strips[points.strips.len() - 1]), (0, 500));
        for (strip, bounds) in points.strips.windows(2).enumerate() {
            for cell in &points.cells[bounds[0]..bounds[1]] {
                assert_eq!(cell[0] as usize / 16, strip);
            }
        }
    }
}
