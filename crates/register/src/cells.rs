//! Sorts points into the cells of a grid, so that all points within a cell's width of a position lie in the 27 cells
//! around the position.

use spharm_surface::geometry::{Vec3, bounds};

use crate::exponential::Columns;

/// Maximum number of cells along an axis. With this limit, the table of the first point of each cell takes at most 4
/// MB.
const MOST: f64 = 100.0;

/// Points with normals, sorted by cell.
pub(crate) struct Cells {
    pub(crate) columns: Columns,
    /// Index of each point in the original order.
    pub(crate) index: Vec<u32>,
    starts: Vec<u32>,
    low: Vec3,
    width: f64,
    count: [usize; 3],
}

impl Cells {
    /// Sorts points into cells that are at least `width` wide.
    pub(crate) fn new(points: &[Vec3], normals: &[Vec3], width: f64) -> Self {
        let (low, high) = bounds(points.iter().copied());
        let extent = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        let width = width.max(extent / (MOST - 1.0)).max(f64::MIN_POSITIVE);
        let count: [usize; 3] = std::array::from_fn(|k| ((high[k] - low[k]) / width) as usize + 1);
        let mut cells = Self { columns: Columns::default(), index: Vec::new(), starts: Vec::new(), low, width, count };
        let of: Vec<usize> = points.iter().map(|p| cells.number(std::array::from_fn(|k| cells.along(*p, k)))).collect();
        let mut starts = vec![0u32; count.iter().product::<usize>() + 1];
        of.iter().for_each(|cell| starts[cell + 1] += 1);
        (1..starts.len()).for_each(|cell| starts[cell] += starts[cell - 1]);
        let (mut next, mut index) = (starts.clone(), vec![0u32; points.len()]);
        for (i, cell) in of.iter().enumerate() {
            index[next[*cell] as usize] = i as u32;
            next[*cell] += 1;
        }
        let sorted = |of: &[Vec3], k: usize| index.iter().map(|i| of[*i as usize][k]).collect::<Vec<f64>>();
        cells.columns =
            Columns { x: std::array::from_fn(|k| sorted(points, k)), n: std::array::from_fn(|k| sorted(normals, k)) };
        (cells.index, cells.starts) = (index, starts);
        cells
    }

    /// Calls `run` for each range of points that may lie within a cell's width of `place`.
    pub(crate) fn near(&self, place: Vec3, mut run: impl FnMut(std::ops::Range<usize>)) {
        let reach = |k: usize| -> Option<(usize, usize)> {
            let at = (place[k] - self.low[k]) / self.width;
            let (from, to) = ((at - 1.0).floor().max(0.0), (at + 1.0).floor().min((self.count[k] - 1) as f64));
            (from <= to).then_some((from as usize, to as usize))
        };
        let (Some(x), Some(y), Some(z)) = (reach(0), reach(1), reach(2)) else { return };
        for k in z.0..=z.1 {
            for j in y.0..=y.1 {
                // The points of one row of cells are contiguous.
                let from = self.starts[self.number([x.0, j, k])] as usize;
                let to = self.starts[self.number([x.1, j, k]) + 1] as usize;
                if from < to {
                    run(from..to);
                }
            }
        }
    }

    fn along(&self, point: Vec3, k: usize) -> usize {
        (((point[k] - self.low[k]) / self.width) as usize).min(self.count[k] - 1)
    }

    fn number(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.count[1] + y) * self.count[0] + x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_surface::geometry::{dot, sub};

    #[test]
    fn every_point_within_a_width_is_found_once() {
        let points: Vec<Vec3> = (0..500).map(|i| [0.0, 1.0, 2.0].map(|k| (1.7 * f64::from(i) + k).sin())).collect();
        for width in [0.05, 0.3, 5.0] {
            let cells = Cells::new(&points, &points, width);
            for place in [[0.1, 0.2, -0.3], [1.0, 1.0, 1.0], [-1.2, 0.0, 0.4], [9.0, 0.0, 0.0]] {
                let mut found = Vec::new();
                cells.near(place, |range| found.extend(range.map(|at| cells.index[at])));
                for (i, point) in points.iter().enumerate() {
                    let off = sub(*point, place);
                    let times = found.iter().filter(|index| **index == i as u32).count();
                    assert!(times <= 1 && (times == 1 || dot(off, off) > width * width), "{place:?} {i}");
                }
            }
        }
    }
}
