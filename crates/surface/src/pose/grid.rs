//! Finds the nearest piece of a surface quickly but approximately, with a lookup table over the cells of a box.
//!
//! A table is used because thousands of rotations are evaluated before any is improved, and each search in a tree would
//! take 0.15 us. For each cell, the table has the point nearest to the cell's middle. For a position outside of the
//! box, the nearest cell is used. The point found isn't always the nearest one, but a neighbour of the nearest point
//! suffices, since distances are measured to the disk that a point represents. The table has 32,768 cells over a box
//! along the surface's principal axes and takes 64 KiB.

use super::level::Level;
use crate::geometry::{Vec3, add, scale, sub};
use crate::matrix3::{Matrix3, times, transposed};

/// Approximate number of cells in the table.
const CELLS: f64 = 32_768.0;
/// Width of the margin around the surface's own box, in cells.
const MARGIN: f64 = 4.0;

/// Number of points in a group whose nearest pieces are found together.
pub(super) const LANES: usize = 16;

/// One coordinate of all points in a group.
pub(super) type Lanes = [f64; LANES];

pub(super) struct Grid {
    /// Matrix of the map from positions to cell coordinates, `x -> cells x + origin`.
    cells: Matrix3,
    origin: Vec3,
    counts: [usize; 3],
    nearest: Vec<u16>,
}

impl Grid {
    /// Builds the table from the points of a level, of which there may be at most 65,536. The rows of `axes` are the
    /// axes of the table's box.
    pub(super) fn new(level: &Level, axes: &Matrix3) -> Self {
        let (low, high) = crate::geometry::bounds(level.points.iter().map(|p| times(axes, *p)));
        let sides = sub(high, low);
        let volume = |side: f64| sides.iter().map(|s| s / side + 2.0 * MARGIN).product::<f64>();
        // Bisection finds the cell size at which the box with its margin has the wanted number of cells.
        let longest = sides.iter().fold(0.0_f64, |most, s| most.max(*s));
        let (mut small, mut large) = (1e-6 * longest, longest);
        for _ in 0..50 {
            let middle = (small * large).sqrt();
            if volume(middle) > CELLS { small = middle } else { large = middle }
        }
        let side = large;
        let counts = sides.map(|s| (s / side + 2.0 * MARGIN).ceil() as usize);
        let corner = low.map(|v| v - MARGIN * side);
        let (cells, origin) = (axes.map(|row| row.map(|v| v / side)), corner.map(|v| -v / side));
        let back = transposed(axes);
        let middle = |i: usize| {
            let at = [i / (counts[1] * counts[2]), i / counts[2] % counts[1], i % counts[2]];
            times(&back, add(corner, scale(at.map(|k| k as f64 + 0.5), side)))
        };
        let nearest = (0..counts.iter().product()).map(|i| level.nearest(middle(i)) as u16).collect();
        Self { cells, origin, counts, nearest }
    }

    /// Returns the index of the point nearest to `p`, or of a neighbour of that point.
    pub(super) fn nearest(&self, p: Vec3) -> usize {
        let at = add(times(&self.cells, p), self.origin);
        let cell = |k: usize| (at[k].max(0.0) as usize).min(self.counts[k] - 1);
        usize::from(self.nearest[(cell(0) * self.counts[1] + cell(1)) * self.counts[2] + cell(2)])
    }
}

impl Grid {
    /// Returns the result of [`nearest`](Self::nearest) for each position in a group. `p` has one array per coordinate.
    #[inline(always)]
    pub(super) fn nearest_of_group(&self, p: &[Lanes; 3]) -> [usize; LANES] {
        // Coordinates of cells are small integers, so arithmetic on them in f64 is exact.
        let [_, rows, columns] = self.counts.map(|count| count as f64);
        let mut cell = [[0.0; LANES]; 3];
        for (k, cell) in cell.iter_mut().enumerate() {
            let (row, last) = (&self.cells[k], (self.counts[k] - 1) as f64);
            for i in 0..LANES {
                let at = row[0] * p[0][i] + row[1] * p[1][i] + row[2] * p[2][i] + self.origin[k];
                cell[i] = at.max(0.0).min(last).floor();
            }
        }
        let mut index = [0_u32; LANES];
        for i in 0..LANES {
            index[i] = ((cell[0][i] * rows + cell[1][i]) * columns + cell[2][i]) as i32 as u32;
        }
        index.map(|i| usize::from(self.nearest[i as usize]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{SplitMix64, icosphere};
    use crate::geometry::dot;
    use crate::pose::PoseSurface;

    #[test]
    fn points_are_nearest_to_within_a_cell() {
        let ball = icosphere(4);
        let body = ball.with_vertices(ball.vertices.iter().map(|v| [9.0 * v[0], 3.0 * v[1], 2.0 * v[2]]).collect());
        let surface = PoseSurface::new(&body).unwrap();
        let level = &surface.levels[1];
        let mut random = SplitMix64::new(3);
        for _ in 0..1000 {
            let p = [random.between(-10.0, 10.0), random.between(-4.0, 4.0), random.between(-3.0, 3.0)];
            let to = |i: usize| dot(sub(level.points[i], p), sub(level.points[i], p)).sqrt();
            assert!(to(surface.grid.nearest(p)) < to(level.nearest(p)) + 2.0 * level.radius, "{p:?}");
        }
        assert!(surface.grid.nearest.len() < 40_000);
        // A nearest point is also found for positions far away.
        for far in [[1e9, 0.0, 0.0], [-1e300, 1e300, 0.0], [f64::INFINITY, 0.0, 0.0]] {
            assert!(surface.grid.nearest(far) < level.points.len());
        }
    }
}
