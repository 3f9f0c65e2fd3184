//! Represents bodies in volumes of grey values or probabilities. A body consists of the voxels whose values reach a
//! given level.
//!
//! The values on both sides of the body's surface locate the surface within the voxels:
//!
//! - Between the centres of a voxel inside and a neighbour outside, the surface is located where linear interpolation
//!   of the two values gives the level (a crossing).
//! - The body's volume is the number of its voxels, corrected by the positions of these crossings. This equals the
//!   total length, within the body, of all lines through voxel centres along an axis, averaged over the three axes
//!   (Cavalieri's principle). For probabilities the volume is the sum of the probabilities near the surface plus the
//!   number of voxels farther inside. If each voxel's value is the share of the voxel inside the body, this sum is
//!   exact. Interpolation underestimates small bodies: in an image of resolution sigma, the level set of a ball of
//!   radius r lies `sigma^2 / r` below the surface of the ball.

use std::fmt;

use super::boundary::{Face, QuadMesh};
use super::mask::{Mask, around};
use crate::error::ParametrizeError;

/// Meaning of the voxels' values.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum VoxelValues {
    /// Labels: whole numbers, 0 for the background.
    #[default]
    Labels,
    /// Grey values. The body gets label 1 and consists of the voxels with this value or more. NaNs are outside.
    Level(f64),
    /// Probabilities, or the share of each voxel inside the body, from 0 to 1. The body gets label 1 and consists of
    /// the voxels with a value of 0.5 or more. NaNs are outside.
    Probability,
}

impl VoxelValues {
    /// Returns the meaning of a volume's values, given by arguments or provenance: grey values if a threshold is given,
    /// otherwise probabilities if `probability` is true, otherwise labels.
    #[must_use]
    pub fn of(threshold: Option<f64>, probability: bool) -> Self {
        match threshold {
            Some(level) => Self::Level(level),
            None if probability => Self::Probability,
            None => Self::Labels,
        }
    }

    /// Returns the threshold: voxels with this value or more are inside the body. `None` for labels, which have no
    /// threshold.
    #[must_use]
    pub fn level(self) -> Option<f64> {
        match self {
            Self::Labels => None,
            Self::Level(level) => Some(level),
            Self::Probability => Some(0.5),
        }
    }

    /// Checks that the level is finite.
    pub(super) fn check(self) -> Result<(), ParametrizeError> {
        match self.level().filter(|level| !level.is_finite()) {
            None => Ok(()),
            Some(level) => {
                let (what, expected) = ("threshold", "a number");
                Err(ParametrizeError::Argument { what, expected, found: level.to_string() })
            }
        }
    }
}

impl fmt::Display for VoxelValues {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Labels => f.write_str("labels"),
            Self::Level(level) => write!(f, "grey values from {level}"),
            Self::Probability => f.write_str("probabilities"),
        }
    }
}

/// The values of the voxels in a box around a body, minus the level.
#[derive(Clone, Debug)]
pub(super) struct Grey {
    values: Vec<f32>,
    /// The box's first voxel, in coordinates of the volume.
    low: [usize; 3],
    /// Number of voxels of the box along each axis.
    size: [usize; 3],
    meaning: VoxelValues,
}

/// The surface of a body, located by its grey values.
#[derive(Clone, Debug)]
pub(crate) struct Located {
    /// For each quadrangle, the axis of its normal, and the position along this axis at which the values cross the
    /// level.
    pub(super) crossings: Vec<(usize, f64)>,
    /// The body's volume in voxels.
    pub(super) volume: f64,
}

impl Grey {
    /// Returns the values in the box from voxel `low` to voxel `high`, inclusive, enlarged by a margin of one voxel;
    /// `None` if the volume has labels. `all` contains each voxel's value minus the level, for a volume of size
    /// `whole`, with x varying fastest.
    pub(super) fn around(
        all: &[f32],
        whole: [usize; 3],
        low: [usize; 3],
        high: [usize; 3],
        meaning: VoxelValues,
    ) -> Option<Self> {
        meaning.level()?;
        let low = low.map(|x| x.saturating_sub(1));
        let size: [usize; 3] = std::array::from_fn(|k| (high[k] + 2).min(whole[k]) - low[k]);
        let mut values = Vec::with_capacity(size.iter().product());
        for z in low[2]..low[2] + size[2] {
            for y in low[1]..low[1] + size[1] {
                let row = low[0] + whole[0] * (y + whole[1] * z);
                values.extend_from_slice(&all[row..row + size[0]]);
            }
        }
        Some(Self { values, low, size, meaning })
    }

    /// Returns the difference of a voxel's value from the level; `None` for a voxel beyond the volume or without a
    /// finite value.
    fn at(&self, voxel: [i64; 3]) -> Option<f64> {
        let mut index = 0;
        for k in [2, 1, 0] {
            let x = usize::try_from(voxel[k] - self.low[k] as i64).ok().filter(|x| *x < self.size[k])?;
            index = index * self.size[k] + x;
        }
        Some(f64::from(self.values[index])).filter(|value| value.is_finite())
    }

    /// Locates the surface of a mask, which may have been repaired, given its quadrangles in voxel coordinates.
    pub(super) fn locate(&self, quads: &QuadMesh, mask: &Mask) -> Located {
        let faces = (0..quads.quads.len()).map(|quad| quads.face(quad));
        let located = faces.map(|face| (face, self.offset(&face)));
        let (crossings, offsets): (Vec<(usize, f64)>, Vec<f64>) =
            located.map(|(face, offset)| ((face.axis, face.centre[face.axis] + face.sign * offset), offset)).unzip();
        let volume = match self.meaning {
            VoxelValues::Probability => self.expected_volume(mask),
            _ => mask.count() as f64 + offsets.iter().sum::<f64>() / 3.0,
        };
        Located { crossings, volume }
    }

    /// Returns the distance outwards from a quadrangle to the crossing of the level, from -0.5 to 0.5 voxels. The
    /// distance is 0 where a repair has moved the surface away from the level, and at the volume's border.
    fn offset(&self, face: &Face) -> f64 {
        let voxel = |outwards: f64| {
            let centre = |k: usize| face.centre[k] + if k == face.axis { outwards * face.sign } else { 0.0 };
            [0, 1, 2].map(|k| centre(k).round() as i64)
        };
        let (Some(inside), Some(outside)) = (self.at(voxel(-0.5)), self.at(voxel(0.5))) else { return 0.0 };
        let crosses = inside >= 0.0 && outside < 0.0;
        if crosses { inside / (inside - outside) - 0.5 } else { 0.0 }
    }

    /// Returns the volume of a body of probabilities: the sum of the probabilities of all voxels next to the surface
    /// (with a neighbour on its other side), plus the number of all other voxels inside. Voxels that a repair has moved
    /// to the other side contribute 0 if they are now outside, and 1 if they are now inside.
    fn expected_volume(&self, mask: &Mask) -> f64 {
        let steps: Vec<isize> = around().map(|d| mask.step(d)).collect();
        // The mask's box has a rim of voxels outside, so it contains all neighbours of the voxels inside.
        let mut near = vec![false; mask.inside.len()];
        for index in (0..near.len()).filter(|&index| mask.inside[index]) {
            for next in steps.iter().map(|step| index.wrapping_add_signed(*step)).filter(|&next| !mask.inside[next]) {
                (near[index], near[next]) = (true, true);
            }
        }
        let of = |index: usize| {
            let side = mask.inside[index];
            let certain = f64::from(u8::from(side));
            if !near[index] {
                return certain;
            }
            let at = mask.place(index);
            let voxel = std::array::from_fn(|k| at[k] as i64 + mask.origin[k]);
            let above = self.at(voxel).filter(|above| (*above >= 0.0) == side);
            above.map_or(certain, |above| (0.5 + above).clamp(0.0, 1.0))
        };
        (0..mask.inside.len()).map(of).sum()
    }
}
