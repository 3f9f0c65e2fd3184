//! Represents the voxels of one label as a box of booleans.

/// A box of voxels, each inside or outside the label. The box has a rim of outside voxels, at least one voxel wide, so
/// that all neighbours of an inside voxel are in the box.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mask {
    /// Number of voxels along x, y, z, including the rim.
    pub size: [usize; 3],
    /// Position of the box in the volume: the volume's coordinates of the box's voxel (0, 0, 0).
    pub origin: [i64; 3],
    /// Whether each voxel of the box is inside the label, with x varying fastest.
    pub inside: Vec<bool>,
}

impl Mask {
    /// Returns the smallest box, plus its rim, around the voxels for which `inside` is true, in a volume of `size`
    /// voxels. If such voxels touch the volume's border, the rim extends beyond the volume.
    pub fn new(size: [usize; 3], inside: impl Fn([usize; 3]) -> bool) -> Self {
        let mut low = [usize::MAX; 3];
        let mut high = [0; 3];
        let mut any = false;
        for_each(size, |at| {
            if inside(at) {
                any = true;
                for axis in 0..3 {
                    low[axis] = low[axis].min(at[axis]);
                    high[axis] = high[axis].max(at[axis]);
                }
            }
        });
        if !any {
            return Self { size: [2; 3], origin: [0; 3], inside: vec![false; 8] };
        }
        Self::of_box(low, high, inside)
    }

    /// Returns the box from voxel `low` to voxel `high`, inclusive, plus its rim. All voxels are marked as outside.
    pub(super) fn around(low: [usize; 3], high: [usize; 3]) -> Self {
        let own: [usize; 3] = std::array::from_fn(|k| high[k] - low[k] + 3);
        Self { size: own, origin: low.map(|x| x as i64 - 1), inside: vec![false; own.iter().product()] }
    }

    /// Returns the box from voxel `low` to voxel `high`, inclusive, plus its rim, with the values of `inside`.
    fn of_box(low: [usize; 3], high: [usize; 3], inside: impl Fn([usize; 3]) -> bool) -> Self {
        let mut mask = Self::around(low, high);
        for_each(mask.size.map(|n| n - 2), |at| {
            let index = mask.index(at.map(|x| x + 1));
            mask.inside[index] = inside(std::array::from_fn(|k| at[k] + low[k]));
        });
        mask
    }

    /// Returns the number of voxels inside the label.
    #[must_use]
    pub fn count(&self) -> usize {
        self.inside.iter().filter(|&&inside| inside).count()
    }

    pub(super) fn index(&self, [x, y, z]: [usize; 3]) -> usize {
        x + self.size[0] * (y + self.size[1] * z)
    }

    pub(super) fn place(&self, index: usize) -> [usize; 3] {
        let [nx, ny, _] = self.size;
        [index % nx, index / nx % ny, index / (nx * ny)]
    }

    /// Returns whether the voxel with the given index is in the outermost layer of voxels.
    pub(super) fn is_rim(&self, index: usize) -> bool {
        let at = self.place(index);
        (0..3).any(|k| at[k] == 0 || at[k] + 1 == self.size[k])
    }

    /// Returns the index of a voxel's neighbour at offset (dx, dy, dz) minus the voxel's own index. Each offset is -1,
    /// 0 or 1.
    pub(super) fn step(&self, [dx, dy, dz]: [isize; 3]) -> isize {
        dx + self.size[0] as isize * (dy + self.size[1] as isize * dz)
    }
}

fn for_each(size: [usize; 3], mut f: impl FnMut([usize; 3])) {
    for z in 0..size[2] {
        for y in 0..size[1] {
            for x in 0..size[0] {
                f([x, y, z]);
            }
        }
    }
}

/// Returns the offsets of a voxel's 26 neighbours and of the voxel itself, with x varying fastest; number 13 is the
/// voxel itself.
pub(super) fn around() -> impl Iterator<Item = [isize; 3]> {
    (0..27).map(|i| [i % 3 - 1, i / 3 % 3 - 1, i / 9 - 1])
}

/// The offsets of the 6 neighbours that share a face with a voxel.
pub(super) const FACES: [[isize; 3]; 6] = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
