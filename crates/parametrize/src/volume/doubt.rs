//! Describes reasons to doubt the voxel size of a volume or the positions of its voxels.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use spharm_monitor::number;

/// Largest number of volumes that a warning lists by name.
const NAMED: usize = 3;

/// A reason to doubt the voxel size of a volume or the positions of its voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub enum VolumeDoubt {
    /// The caller's voxel size contradicts the voxel size in the file.
    Replaced {
        /// The caller's voxel size.
        given: [f64; 3],
        /// The file's voxel size.
        file: [f64; 3],
    },
    /// The sides of a voxel differ by a large factor.
    Uneven {
        /// The voxel size.
        size: [f64; 3],
    },
    /// The NIfTI header has neither an sform nor a qform (the two descriptions of voxel positions).
    NoForm,
    /// The sform and the qform in a NIfTI header disagree, though they have the same code.
    Apart {
        /// Largest distance between a voxel's position by the sform and its position by the qform, in mm.
        distance: f64,
    },
    /// The unit of length in an NRRD header is unknown.
    UnknownUnit,
}

impl VolumeDoubt {
    /// Returns a number that identifies the kind of doubt.
    fn kind(&self) -> u8 {
        match self {
            Self::Replaced { .. } => 0,
            Self::Uneven { .. } => 1,
            Self::NoForm => 2,
            Self::Apart { .. } => 3,
            Self::UnknownUnit => 4,
        }
    }

    /// Returns the severity of a doubt, for comparison with other doubts of its kind.
    fn severity(&self) -> f64 {
        match self {
            Self::Replaced { given, file } => {
                (0..3).map(|axis| (given[axis] / file[axis]).ln().abs()).fold(0.0, f64::max)
            }
            Self::Uneven { size } => ratio(*size),
            Self::NoForm | Self::UnknownUnit => 0.0,
            Self::Apart { distance } => *distance,
        }
    }

    /// Returns the text of a warning about one volume or, if `several` is true, about several volumes, for which this
    /// is the most severe doubt of its kind.
    pub(super) fn text(&self, several: bool) -> String {
        match self {
            Self::Replaced { given, file } => {
                let [given, file] = [*given, *file].map(sides);
                let replaced =
                    if several { format!("other sizes, such as {file}") } else { format!("the file's size {file}") };
                format!("the given voxel size {given} replaces {replaced}")
            }
            Self::Uneven { size } => {
                let (up_to, ratio, size) = (if several { "up to " } else { "" }, ratio(*size), sides(*size));
                format!(
                    "the sides of the voxels differ by a factor of {up_to}{ratio:.0} ({size}); check the voxel size"
                )
            }
            Self::NoForm => "the header has neither an sform nor a qform, so only the voxel size is used, and the \
                             directions of the axes are unknown; if they matter, write an sform to the header"
                .to_owned(),
            Self::Apart { distance } => format!(
                "the sform and the qform in the header put the same voxel up to {} mm apart; the sform is used; if it \
                 is wrong, correct the header",
                number(*distance)
            ),
            Self::UnknownUnit => "the unit of length in the header is unknown, so lengths are taken to be in mm; \
                                  correct `space units` or `units` in the header, or give the voxel size"
                .to_owned(),
        }
    }
}

/// Doubts about all volumes that a run reads, merged by kind.
#[derive(Clone, Debug, Default)]
pub struct VolumeDoubts(BTreeMap<u8, (VolumeDoubt, BTreeSet<PathBuf>)>);

impl VolumeDoubts {
    /// Adds the doubts about the volume at `path`. A volume that is added several times is counted once.
    pub fn add(&mut self, path: &Path, doubts: &[VolumeDoubt]) {
        for &doubt in doubts {
            let (worst, paths) = self.0.entry(doubt.kind()).or_insert_with(|| (doubt, BTreeSet::new()));
            if doubt.severity() > worst.severity() {
                *worst = doubt;
            }
            paths.insert(path.to_owned());
        }
    }

    /// Returns a warning for each kind of doubt. A warning contains the names of the first few volumes.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        self.0.values().map(|(worst, paths)| warning(worst, paths)).collect()
    }
}

fn warning(worst: &VolumeDoubt, paths: &BTreeSet<PathBuf>) -> String {
    let count = paths.len();
    let named = paths.iter().take(NAMED).map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
    let text = worst.text(count > 1);
    match count {
        ..=1 => format!("{named}: {text}"),
        2..=NAMED => format!("{count} volumes, {named}: {text}"),
        _ => format!("{count} volumes, such as {named}: {text}"),
    }
}

/// Returns the ratio of a voxel's longest side to its shortest side.
pub(super) fn ratio(size: [f64; 3]) -> f64 {
    size.into_iter().fold(0.0, f64::max) / size.into_iter().fold(f64::INFINITY, f64::min)
}

/// Returns the sides of a voxel with up to four significant digits, such as `0.2 x 0.2 x 0.5`.
fn sides(size: [f64; 3]) -> String {
    size.map(|side| format!("{side:.3e}").parse::<f64>().unwrap_or(side).to_string()).join(" x ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn doubts_of_one_kind_share_a_warning_with_the_largest_value() {
        let mut doubts = VolumeDoubts::default();
        for (name, distance) in [("d", 2.0), ("b", 1.0), ("a", 40.0), ("a", 40.0)] {
            doubts.add(Path::new(name), &[VolumeDoubt::Apart { distance }]);
        }
        let [three] = &doubts.warnings()[..] else { panic!("{doubts:?}") };
        assert!(three.starts_with("3 volumes, a, b, d: the sform") && three.contains(" 40.00 mm apart"), "{three}");
        doubts.add(Path::new("c"), &[VolumeDoubt::NoForm, VolumeDoubt::Apart { distance: 3.0 }]);
        let [none, four] = &doubts.warnings()[..] else { panic!("{doubts:?}") };
        assert!(none.starts_with("c: the header has neither"), "{none}");
        assert!(four.starts_with("4 volumes, such as a, b, c: ") && four.contains(" 40.00 mm apart"), "{four}");
    }

    #[test]
    fn voxel_sizes_of_several_volumes_are_merged() {
        let mut doubts = VolumeDoubts::default();
        let given = [1.0, 1.0, 20.0];
        for (name, file) in [("a", [1.0, 1.0, 2.0]), ("b", [1.0, 1.0, 0.5])] {
            doubts.add(Path::new(name), &[VolumeDoubt::Replaced { given, file }, VolumeDoubt::Uneven { size: given }]);
        }
        let expected = [
            "2 volumes, a, b: the given voxel size 1 x 1 x 20 replaces other sizes, such as 1 x 1 x 0.5",
            "2 volumes, a, b: the sides of the voxels differ by a factor of up to 20 (1 x 1 x 20); check the voxel \
             size",
        ];
        assert_eq!(doubts.warnings(), expected);
    }
}
