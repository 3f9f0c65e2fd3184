//! Sorts the directions for interpolation: by strip of the grid's rows, and by column along a strip.

use std::ops::Range;
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

use rayon::prelude::*;

use crate::TransformError;
use crate::cells::{self, Place};

/// Number of columns of a tile. Points are sorted by tile. The grid values in a tile fit in the L1 cache.
const TILE_COLUMNS: usize = 16;

/// Largest number of runs into which directions are divided, to be sorted in parallel.
const RUNS: usize = 16;
/// Minimum number of directions in a run.
const LEAST_RUN: usize = 1 << 13;
/// Number of directions that are placed together. Their positions stay in the L1 cache until they are sorted.
const PLACED: usize = 256;

/// The directions' positions on the grid, sorted. A *place* is an index in sorted order.
///
/// Directions are sorted by strip of rows, within a strip by tile of columns, and within a tile by cell, so that
/// directions in one cell follow each other. If cells outnumber the directions, directions stay in input order within a
/// tile.
#[derive(Debug)]
pub(crate) struct Points {
    /// The place of each direction, its index in sorted order, computed on first use. The elements are atomic, because
    /// threads write to neighbouring elements. A relaxed store costs no more than a plain store.
    ranks: OnceLock<Vec<AtomicU32>>,
    /// Index of the direction at each place.
    order: Vec<u32>,
    /// Row and column of the grid cell at each place.
    pub(crate) cells: Vec<[u32; 2]>,
    /// Position within the grid cell at each place, as fractions of a row and of a column, each in [0, 1).
    pub(crate) fractions: Vec<[f64; 2]>,
    /// First place of each strip, followed by the number of places.
    pub(crate) strips: Vec<usize>,
}

impl Points {
    /// Sorts directions by their cells in a grid with `grid` points around the sphere, and divides them into strips of
    /// `strip_rows` rows of the grid.
    pub(crate) fn new(directions: &[[f64; 3]], grid: usize, strip_rows: usize) -> Result<Self, TransformError> {
        let max = u32::MAX as usize;
        if directions.len() > max {
            return Err(TransformError::TooManyDirections { found: directions.len(), max });
        }
        let count = directions.len();
        let (mut order, mut cells, mut fractions) = (vec![0; count], vec![[0; 2]; count], vec![[0.0; 2]; count]);
        let all = Slots { order: &mut order, cells: &mut cells, fractions: &mut fractions };
        let strips = by_strips(directions, grid, strip_rows, all);
        let mut rest = Slots { order: &mut order, cells: &mut cells, fractions: &mut fractions };
        let mut tasks: Vec<(Range<usize>, Slots<'_>)> = strips
            .windows(2)
            .enumerate()
            .map(|(strip, bounds)| {
                (strip * strip_rows..(strip + 1) * strip_rows, rest.split_off(bounds[1] - bounds[0]))
            })
            .collect();
        // The longest tasks come first, so that no thread starts a long task at the end.
        tasks.sort_by_key(|(_, slots)| std::cmp::Reverse(slots.order.len()));
        tasks.into_par_iter().with_max_len(1).for_each(|(rows, slots)| {
            let Slots { order, cells, fractions } = slots;
            let from: Vec<(u32, Place)> =
                order.iter().zip(&*cells).zip(&*fractions).map(|((o, c), f)| (*o, (*c, *f))).collect();
            let cell = |(_, (cell, _)): &&(u32, Place)| *cell;
            CellSorter::default().sort(grid, rows, from.len(), from.iter(), cell, |(direction, place), at| {
                order[at] = *direction;
                (cells[at], fractions[at]) = *place;
            });
        });
        Ok(Self { ranks: OnceLock::new(), order, cells, fractions, strips })
    }

    /// Returns the number of directions, n.
    pub(crate) fn len(&self) -> usize {
        self.order.len()
    }

    /// Returns the memory in bytes held for a number of directions. During construction, each thread also holds a copy
    /// of its longest strip; the total is at most twice the bytes held.
    pub(crate) const fn bytes(directions: usize) -> usize {
        directions * (2 * 4 + 8 + 16)
    }

    /// Returns the index of the direction at a place in the sorted order.
    pub(crate) fn direction(&self, place: usize) -> usize {
        self.order[place] as usize
    }

    /// Returns the index of the direction at each place in the sorted order.
    pub(crate) fn order(&self) -> &[u32] {
        &self.order
    }

    /// Returns the place of each direction in the sorted order. The list of places is computed by the first synthesis,
    /// because an adjoint synthesis doesn't need it.
    pub(crate) fn ranks(&self) -> &[AtomicU32] {
        if let Some(ranks) = self.ranks.get() {
            return ranks;
        }
        // The list isn't computed inside `get_or_init`. A thread that waits in `get_or_init` for other threads may pick
        // up work that calls `get_or_init` again, and would then wait for itself.
        let ranks: Vec<AtomicU32> = (0..self.len()).into_par_iter().map(|_| AtomicU32::new(0)).collect();
        self.order.par_iter().enumerate().for_each(|(place, direction)| {
            ranks[*direction as usize].store(place as u32, Ordering::Relaxed);
        });
        self.ranks.get_or_init(|| ranks)
    }
}

/// Slots for directions and their positions.
#[derive(Default)]
struct Slots<'a> {
    order: &'a mut [u32],
    cells: &'a mut [[u32; 2]],
    fractions: &'a mut [[f64; 2]],
}

impl<'a> Slots<'a> {
    /// Splits off the first `count` slots.
    fn split_off(&mut self, count: usize) -> Slots<'a> {
        Slots {
            order: self.order.split_off_mut(..count).unwrap_or_default(),
            cells: self.cells.split_off_mut(..count).unwrap_or_default(),
            fractions: self.fractions.split_off_mut(..count).unwrap_or_default(),
        }
    }
}

/// Places directions on the grid and writes them to the slots, sorted stably by strip. Returns the first place of each
/// strip, followed by the number of places.
///
/// This is a counting sort of several runs of directions in parallel; each run has its own slots in every strip.
/// Directions are placed twice, the first time only by row, which costs less than storing the positions.
fn by_strips(directions: &[[f64; 3]], grid: usize, strip_rows: usize, mut slots: Slots<'_>) -> Vec<usize> {
    let buckets = (grid / 2 + 1).div_ceil(strip_rows);
    let run = directions.len().div_ceil(RUNS).max(LEAST_RUN);
    let count = |directions: &[[f64; 3]]| {
        let (mut counts, mut rows) = (vec![0; buckets], [0; PLACED]);
        for directions in directions.chunks(PLACED) {
            let rows = &mut rows[..directions.len()];
            cells::rows(directions, grid, rows);
            rows.iter().for_each(|row| counts[*row as usize / strip_rows] += 1);
        }
        counts
    };
    let counts: Vec<Vec<usize>> = directions.par_chunks(run).map(count).collect();
    let mut of_runs: Vec<Vec<Slots<'_>>> = counts.iter().map(|_| Vec::with_capacity(buckets)).collect();
    let mut strips = vec![0];
    for strip in 0..buckets {
        for (of_run, counts) in of_runs.iter_mut().zip(&counts) {
            of_run.push(slots.split_off(counts[strip]));
        }
        strips.push(directions.len() - slots.order.len());
    }
    directions.par_chunks(run).zip(of_runs).enumerate().for_each(|(index, (directions, mut slots))| {
        let (mut next, mut places) = (vec![0; buckets], [Place::default(); PLACED]);
        for (chunk, directions) in directions.chunks(PLACED).enumerate() {
            let places = &mut places[..directions.len()];
            cells::place(directions, grid, places);
            for (i, (cell, fraction)) in places.iter().enumerate() {
                let strip = cell[0] as usize / strip_rows;
                let (slots, at) = (&mut slots[strip], next[strip]);
                slots.order[at] = (index * run + chunk * PLACED + i) as u32;
                (slots.cells[at], slots.fractions[at]) = (*cell, *fraction);
                next[strip] += 1;
            }
        }
    });
    strips
}

/// Sorts the points of a strip, and reuses its memory for the next strip.
#[derive(Debug, Default)]
pub(crate) struct CellSorter {
    next: Vec<u32>,
}

impl CellSorter {
    /// Sorts `count` points of a strip, and calls `put` with each point and its place in the strip. The strip has the
    /// rows `rows` of a grid. Points are sorted by tile of columns and, if there are enough points, by cell within a
    /// tile, such that the points of each square of two by two cells are contiguous. The sort is stable.
    pub(crate) fn sort<P>(
        &mut self,
        grid: usize,
        rows: Range<usize>,
        count: usize,
        points: impl Iterator<Item = P> + Clone,
        cell: impl Fn(&P) -> [u32; 2],
        mut put: impl FnMut(P, usize),
    ) {
        let tiles = grid.div_ceil(TILE_COLUMNS);
        let per_tile = rows.len().next_multiple_of(2) * TILE_COLUMNS;
        // With fewer points, few cells contain more than one point, so sorting by cell costs more time than it saves.
        let by_cells = count > tiles * per_tile;
        let bucket = |[row, column]: [u32; 2]| {
            let (row, column) = (row as usize - rows.start, column as usize);
            if !by_cells {
                return column / TILE_COLUMNS;
            }
            let four = row / 2 * (TILE_COLUMNS / 2) + column % TILE_COLUMNS / 2;
            column / TILE_COLUMNS * per_tile + 4 * four + 2 * (row % 2) + column % 2
        };
        self.next.clear();
        self.next.resize(if by_cells { tiles * per_tile } else { tiles }, 0);
        for point in points.clone() {
            self.next[bucket(cell(&point))] += 1;
        }
        let mut first = 0;
        for next in &mut self.next {
            (*next, first) = (first, first + *next);
        }
        for point in points {
            let next = &mut self.next[bucket(cell(&point))];
            let at = *next as usize;
            *next += 1;
            put(point, at);
        }
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
            assert_eq!(points.ranks()[points.direction(at)].load(Ordering::Relaxed) as usize, at);
        }
        assert!(seen.into_iter().all(|s| s));
        assert_eq!((points.strips[0], points.strips[points.strips.len() - 1]), (0, 500));
        for (strip, bounds) in points.strips.windows(2).enumerate() {
            for cell in &points.cells[bounds[0]..bounds[1]] {
                assert_eq!(cell[0] as usize / 16, strip);
            }
        }
    }

    #[test]
    fn directions_of_a_cell_follow_each_other_where_they_are_many() {
        let directions: Vec<[f64; 3]> =
            spharm_harmonics::Directions::fibonacci(6000).unwrap().as_slice().iter().rev().copied().collect();
        let points = Points::new(&directions, 64, 16).unwrap();
        let equator = points.strips[1]..points.strips[2];
        let runs = points.cells[equator.clone()].chunk_by(|a, b| a == b).count();
        let mut cells = points.cells[equator].to_vec();
        cells.sort_unstable();
        cells.dedup();
        assert_eq!(runs, cells.len());
    }
}
