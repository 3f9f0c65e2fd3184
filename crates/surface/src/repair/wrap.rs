//! Describes the closed surface (wrap) that replaces a mesh.

use std::fmt;

use serde::Serialize;

use super::{percent, phrase};

/// A closed surface of genus zero around a mesh, found on a grid of voxels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Wrap {
    /// Number of voxels along the longest side of the mesh's bounding box.
    pub voxels: usize,
    /// Length of a voxel's edges, in the coordinates' unit.
    pub voxel: f64,
    /// Share of the mesh's area that lies farther than a voxel from the wrap: inner walls and parts that are thinner
    /// than a voxel.
    pub hidden_area: f64,
    /// Share of the mesh's area that lies outside of the wrap and farther than two voxels from it: parts that were left
    /// out or are thinner than a voxel.
    pub lost_area: f64,
    /// Share of the wrap's area that lies farther than a voxel from the mesh: the wrap spans holes there.
    pub bridged_area: f64,
    /// Root mean square distance of the wrap from the mesh, in the coordinates' unit.
    pub rms_distance: f64,
    /// Number of pieces of the body that were left out. Only the largest piece is kept.
    pub pieces: usize,
    /// Share of the body's voxels in the pieces that were left out.
    pub left_out: f64,
    /// Number of cavities filled.
    pub cavities: usize,
    /// Number of handles removed.
    pub handles: usize,
    /// Whether handles were removed by cutting them. If false, they were removed by filling their holes.
    pub handles_cut: bool,
}

impl Wrap {
    /// Returns the larger of two shares that the wrap loses: the share of the mesh's area and the share of the body's
    /// voxels.
    #[must_use]
    pub fn loss(&self) -> f64 {
        self.lost_area.max(self.left_out)
    }

    /// Returns a description of the losses with their shares: phrases joined by commas.
    #[must_use]
    pub fn losses(&self) -> String {
        self.lost().into_iter().flatten().collect::<Vec<_>>().join(", ")
    }

    fn lost(&self) -> [Option<String>; 2] {
        let pieces = phrase(self.pieces, "smaller piece left out", "smaller pieces left out");
        [
            share(self.lost_area, "of the mesh's area lies more than 2 voxels outside the wrap"),
            pieces.map(|text| format!("{text} ({} % of the body's voxels)", percent(self.left_out))),
        ]
    }
}

/// Returns a share as a percentage, followed by `text`; `None` for shares that round to 0.
fn share(share: f64, text: &str) -> Option<String> {
    (share >= 5e-5).then(|| format!("{} % {text}", percent(share)))
}

impl fmt::Display for Wrap {
    /// Describes the wrap and its differences from the mesh by phrases joined by commas.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "wrapped with {} voxels along the longest side", self.voxels)?;
        let handles = match self.handles_cut {
            true => phrase(self.handles, "handle cut", "handles cut"),
            false => phrase(self.handles, "handle filled", "handles filled"),
        };
        let [outside, pieces] = self.lost();
        let phrases = [
            share(self.hidden_area, "of the mesh's area is farther than a voxel from the wrap"),
            outside,
            share(self.bridged_area, "of the wrap's area is farther than a voxel from the mesh"),
            pieces,
            phrase(self.cavities, "cavity filled", "cavities filled"),
            handles,
        ];
        phrases.into_iter().flatten().try_for_each(|phrase| write!(f, ", {phrase}"))
    }
}
