//! Stores labels as runs of equal labels, so that background takes no memory.
//!
//! Most of a label volume is background, and most neighbouring voxels have the same label. A volume is therefore read
//! as a stream, and only the runs of equal labels along x are stored.

use std::collections::BTreeMap;

use spharm_surface::io::{NoRoom, check_room};

/// Consecutive voxels along x with the same label other than 0.
#[derive(Clone, Copy, Debug)]
struct Run {
    /// Index of the first voxel, counted with x varying fastest.
    start: usize,
    length: u32,
    label: i32,
}

/// A label's number of voxels, and the first and last voxel of its bounding box.
#[derive(Clone, Copy, Debug)]
pub(super) struct Extent {
    pub(super) voxels: usize,
    pub(super) low: [usize; 3],
    pub(super) high: [usize; 3],
}

/// All labels of a volume, as runs.
#[derive(Clone, Debug)]
pub(super) struct Runs {
    size: [usize; 3],
    /// The runs in the order of the voxels. No run continues from one row into the next.
    runs: Vec<Run>,
}

impl Runs {
    /// Converts labels, given for every voxel with x varying fastest, to runs.
    pub(super) fn of(size: [usize; 3], values: &[i32]) -> Result<Self, NoRoom> {
        let mut builder = Builder::new(size);
        values.iter().try_for_each(|&label| builder.push(label))?;
        builder.finish()
    }

    /// Returns the number of voxels and the bounding box of every label.
    pub(super) fn extents(&self) -> BTreeMap<i32, Extent> {
        let mut extents = BTreeMap::new();
        for run in &self.runs {
            let low = self.place(run.start);
            let mut high = low;
            high[0] += run.length as usize - 1;
            let extent = extents.entry(run.label).or_insert(Extent { voxels: 0, low, high });
            extent.voxels += run.length as usize;
            for k in 0..3 {
                extent.low[k] = extent.low[k].min(low[k]);
                extent.high[k] = extent.high[k].max(high[k]);
            }
        }
        extents
    }

    /// Calls `f` for the part of each run that lies in the box from `low` to `high`, inclusive. The arguments of `f`
    /// are the first voxel of this part, the x of its last voxel, and the label.
    pub(super) fn within(&self, low: [usize; 3], high: [usize; 3], mut f: impl FnMut([usize; 3], usize, i32)) {
        let [nx, ny, _] = self.size;
        for z in low[2]..=high[2] {
            for y in low[1]..=high[1] {
                let row = nx * (y + ny * z);
                let (from, to) = (row + low[0], row + high[0]);
                let first = self.runs.partition_point(|run| run.start + run.length as usize <= from);
                for run in self.runs[first..].iter().take_while(|run| run.start <= to) {
                    let last = (run.start + run.length as usize - 1).min(to);
                    f([run.start.max(from) - row, y, z], last - row, run.label);
                }
            }
        }
    }

    /// Returns the labels with the axes reversed: converts from z varying fastest to x varying fastest.
    pub(super) fn transposed(&self) -> Result<Self, NoRoom> {
        let [nz, ny, nx] = self.size;
        let mut builder = Builder::new([nx, ny, nz]);
        let extents = self.extents();
        let Some(low) =
            extents.values().map(|extent| extent.low).reduce(|a, b| std::array::from_fn(|k| a[k].min(b[k])))
        else {
            return builder.finish();
        };
        let high = extents.values().fold([0; 3], |a: [usize; 3], b| std::array::from_fn(|k| a[k].max(b.high[k])));
        // Only the bounding box of all labels is expanded to one value per voxel.
        let own: [usize; 3] = std::array::from_fn(|k| high[k] - low[k] + 1);
        let count = own.iter().product::<usize>();
        check_room(4 * count as u64)?;
        let mut dense = vec![0; count];
        self.within(low, high, |[from, y, x], to, label| {
            let voxel = |z: usize| (x - low[2]) + own[2] * ((y - low[1]) + own[1] * (z - low[0]));
            (from..=to).for_each(|z| dense[voxel(z)] = label);
        });
        for (row, values) in dense.chunks_exact(own[2]).enumerate() {
            let (y, z) = (low[1] + row % own[1], low[0] + row / own[1]);
            builder.to(low[2] + nx * (y + ny * z))?;
            values.iter().try_for_each(|&label| builder.push(label))?;
        }
        builder.finish()
    }

    fn place(&self, voxel: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [voxel % nx, voxel / nx % ny, voxel / (nx * ny)]
    }
}

/// Builds runs from labels that are added one after another, with x varying fastest.
pub(super) struct Builder {
    runs: Runs,
    /// Number of voxels added so far.
    at: usize,
    /// Number of voxels until the end of the current row.
    left: usize,
    /// The label of the current run.
    label: i32,
    /// Index of the first voxel of the current run.
    began: usize,
}

impl Builder {
    pub(super) fn new(size: [usize; 3]) -> Self {
        Self { runs: Runs { size, runs: Vec::new() }, at: 0, left: size[0], label: 0, began: 0 }
    }

    /// Returns the number of voxels added so far.
    pub(super) fn len(&self) -> usize {
        self.at
    }

    /// Sets the number of slices. Used by readers of formats that don't state this number in advance.
    pub(super) fn slices(&mut self, count: usize) {
        self.runs.size[2] = count;
    }

    /// Adds the next voxel's label.
    pub(super) fn push(&mut self, label: i32) -> Result<(), NoRoom> {
        if label != self.label || self.left == 0 {
            self.close()?;
            self.label = label;
            if self.left == 0 {
                self.left = self.runs.size[0];
            }
        }
        self.at += 1;
        self.left -= 1;
        Ok(())
    }

    /// Adds background until `voxel` is the next voxel.
    pub(super) fn to(&mut self, voxel: usize) -> Result<(), NoRoom> {
        self.close()?;
        let width = self.runs.size[0].max(1);
        (self.at, self.began, self.label, self.left) = (voxel, voxel, 0, width - voxel % width);
        Ok(())
    }

    /// Ends the current run.
    fn close(&mut self) -> Result<(), NoRoom> {
        let runs = &mut self.runs.runs;
        while self.began < self.at && self.label != 0 {
            if runs.len() == runs.capacity() {
                let more = runs.len().max(1 << 10);
                check_room(((runs.len() + more) * size_of::<Run>()) as u64)?;
                runs.reserve_exact(more);
            }
            let length = u32::try_from(self.at - self.began).unwrap_or(u32::MAX);
            runs.push(Run { start: self.began, length, label: self.label });
            self.began += length as usize;
        }
        self.began = self.at;
        Ok(())
    }

    pub(super) fn finish(mut self) -> Result<Runs, NoRoom> {
        self.close()?;
        Ok(self.runs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns reproducible random labels 0 to 2, mostly 0.
    fn noise(size: [usize; 3]) -> Vec<i32> {
        let mut state = 1_u64;
        let mut next = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 60) as i32 - 12).max(0) % 3
        };
        (0..size.iter().product()).map(|_| next()).collect()
    }

    fn dense(runs: &Runs) -> Vec<i32> {
        let [nx, ny, nz] = runs.size;
        let mut values = vec![0; nx * ny * nz];
        runs.within([0; 3], [nx - 1, ny - 1, nz - 1], |[from, y, z], to, label| {
            (from..=to).for_each(|x| values[x + nx * (y + ny * z)] = label);
        });
        values
    }

    #[test]
    fn labels_return_in_either_order_of_the_axes() {
        let size = [5, 4, 3];
        let values = noise(size);
        let runs = Runs::of(size, &values).unwrap();
        assert_eq!(dense(&runs), values);
        let turned = runs.transposed().unwrap();
        assert_eq!(turned.size, [3, 4, 5]);
        let expected: Vec<i32> = (0..60).map(|i| values[i / 12 + 5 * (i / 3 % 4 + 4 * (i % 3))]).collect();
        assert_eq!(dense(&turned), expected);
        assert_eq!(dense(&turned.transposed().unwrap()), values);
    }

    #[test]
    fn boxes_and_extents_are_those_of_the_voxels() {
        let size = [7, 5, 4];
        let values = noise(size);
        let runs = Runs::of(size, &values).unwrap();
        for (label, extent) in runs.extents() {
            let own: Vec<[usize; 3]> =
                (0..values.len()).filter(|&i| values[i] == label).map(|i| [i % 7, i / 7 % 5, i / 35]).collect();
            assert_eq!(extent.voxels, own.len());
            for k in 0..3 {
                assert_eq!(extent.low[k], own.iter().map(|at| at[k]).min().unwrap());
                assert_eq!(extent.high[k], own.iter().map(|at| at[k]).max().unwrap());
            }
        }
        let (low, high) = ([2, 1, 1], [4, 3, 2]);
        let mut found = 0;
        runs.within(low, high, |[from, y, z], to, label| {
            assert!(low[0] <= from && to <= high[0]);
            found += to + 1 - from;
            assert!((from..=to).all(|x| values[x + 7 * (y + 5 * z)] == label));
        });
        let expected = (low[2]..=high[2]).flat_map(|z| (low[1]..=high[1]).map(move |y| (y, z)));
        let expected = expected.flat_map(|(y, z)| (low[0]..=high[0]).map(move |x| x + 7 * (y + 5 * z)));
        assert_eq!(found, expected.filter(|&i| values[i] != 0).count());
    }

    #[test]
    fn background_takes_no_room_and_rows_end_runs() {
        let mut builder = Builder::new([4, 2, 1]);
        builder.to(2).unwrap();
        (0..4).for_each(|_| builder.push(7).unwrap());
        builder.to(8).unwrap();
        let runs = builder.finish().unwrap();
        assert_eq!(dense(&runs), [0, 0, 7, 7, 7, 7, 0, 0]);
        assert_eq!(runs.runs.len(), 2);
        let runs = Runs::of([4, 2, 1], &[0; 8]).unwrap();
        assert!(runs.runs.capacity() == 0 && runs.extents().is_empty());
        assert!(runs.transposed().unwrap().extents().is_empty());
    }
}
