//! Defines the reasons for flagging a subject, and the phrases that describe them to users.

use std::fmt;

use serde_json::{Map, Value};
use spharm::shape::outliers::FAR;
use spharm_monitor::number;

use super::measure::Measure;
use crate::equal::first_of;

/// Largest fraction of a label's voxels that a repair may change without a flag.
pub(super) const VOXELS_CHANGED: f64 = 0.02;
/// Largest number of equal subjects that a flag lists by name.
const NAMED: usize = 6;

/// Changes made by a repair.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of voxels dropped, filled or changed. The number is 0 for the repair of a mesh.
    pub voxels: u64,
    /// Descriptions of the changes, with counts, such as `pieces dropped 2`. Empty if nothing was changed.
    pub texts: Vec<String>,
}

impl Counts {
    /// Returns the changes recorded in a model's provenance. Counts of 0 are omitted.
    pub(super) fn of(repair: &Map<String, Value>) -> Self {
        let count = |name: &str| repair.get(name).and_then(Value::as_u64).unwrap_or(0);
        let numbers = repair.iter().filter_map(|(name, value)| Some((name, value.as_u64().filter(|n| *n > 0)?)));
        Self {
            voxels: count("voxels_dropped") + count("voxels_filled") + count("voxels_changed"),
            texts: numbers.map(|(name, count)| format!("{} {count}", name.replace('_', " "))).collect(),
        }
    }
}

impl fmt::Display for Counts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.texts.join(", "))
    }
}

/// A list of other subjects. At most six of them are named.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Others(String);

impl Others {
    /// Creates a list of the subjects of a set, except the subject called `id`.
    pub(super) fn new(id: &str, set: &[&str]) -> Self {
        Self(first_of(set.iter().copied().filter(|name| *name != id), NAMED))
    }
}

impl fmt::Display for Others {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A reason for flagging a subject. [`Display`](fmt::Display) gives a phrase without the subject's id.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum Flag {
    /// The subject's value of a measure is far from those of the other subjects.
    Far {
        /// The measure.
        measure: Measure,
        /// Value of the measure.
        value: f64,
        /// Median of the measure in the group.
        median: f64,
        /// Robust z of the measure.
        z: f64,
    },
    /// The subject's score along a mode is far from those of the other subjects.
    FarScore {
        /// The mode, counted from 1.
        mode: usize,
        /// Robust z of the score.
        z: f64,
    },
    /// A mode is mostly due to this subject: without the subject, the variance along the mode falls by more than half.
    MakesMode {
        /// The mode, counted from 1.
        mode: usize,
        /// Fraction by which the variance falls without the subject.
        share: f64,
    },
    /// Other subjects have the same input file and label.
    SameInput(Others),
    /// Other subjects have the same model, but different input files.
    SameModel(Others),
    /// Other subjects have the same surface, in other poses or files.
    SameSurface(Others),
    /// The label touches the border of its volume.
    AtBorder,
    /// The voxel size differs from the voxel size of most subjects.
    VoxelSize {
        /// Size of the voxels in mm.
        found: [f64; 3],
        /// Voxel size of most subjects in mm.
        usual: [f64; 3],
    },
    /// A repair changed many voxels.
    Repaired {
        /// Description of the changes.
        what: String,
        /// Number of changed voxels, as a fraction of the label's voxels.
        share: f64,
    },
    /// A warning about the subject from another command.
    Note(String),
}

impl Flag {
    /// Returns the rank by which the flags of a subject are sorted: 0 for an unusual voxel size, 1 for other causes,
    /// and 2 for unusual values, which may be effects of these causes.
    pub(super) fn rank(&self) -> u8 {
        match self {
            Self::VoxelSize { .. } => 0,
            Self::Far { .. } | Self::FarScore { .. } | Self::MakesMode { .. } => 2,
            _ => 1,
        }
    }

    /// Returns the severity of the flag, by which flags are ordered. For a flag with a robust z, the severity is the
    /// magnitude of z relative to the threshold [`FAR`]; for other flags, it is between 1 and 2.
    #[must_use]
    pub fn severity(&self) -> f64 {
        match self {
            Self::Far { z, .. } | Self::FarScore { z, .. } => z.abs() / FAR,
            Self::MakesMode { share, .. } => 1.0 + share,
            Self::SameInput(_) | Self::SameModel(_) | Self::SameSurface(_) => 1.5,
            Self::AtBorder | Self::VoxelSize { .. } | Self::Repaired { .. } | Self::Note(_) => 1.0,
        }
    }
}

impl fmt::Display for Flag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Far { measure, value, median, z } => {
                write!(f, "{} {} (median {}, robust z {z:.1}", measure.name(), number(*value), number(*median))?;
                match unit_factor(*measure, *value / *median) {
                    Some(factor) => {
                        write!(f, "; the lengths may be in another unit: about {factor} the lengths of the others)")
                    }
                    None => f.write_str(")"),
                }
            }
            Self::FarScore { mode, z } => write!(f, "far from the other subjects along mode {mode} (robust z {z:.1})"),
            Self::MakesMode { mode, share } => {
                write!(
                    f,
                    "mode {mode} is mostly due to this subject (without the subject, the variance along the mode falls \
                     by "
                )?;
                write!(f, "{:.1} %)", 100.0 * share)
            }
            Self::SameInput(others) => write!(f, "same input as {others}"),
            Self::SameModel(others) => write!(f, "same model as {others}"),
            Self::SameSurface(others) => write!(f, "same surface as {others}"),
            Self::AtBorder => f.write_str("touches the border of the volume and may be cut off"),
            Self::VoxelSize { found, usual } => {
                write!(f, "voxel size {} mm, but {} mm for most subjects", edges(*found), edges(*usual))
            }
            Self::Repaired { what, share } => write!(f, "repaired: {what} ({:.1} % of the voxels)", 100.0 * share),
            Self::Note(text) => f.write_str(text),
        }
    }
}

/// Returns the ratio of two units of length as a phrase, such as `10 times`, if `ratio` indicates a wrong unit. `ratio`
/// is the volume or area divided by its median.
fn unit_factor(measure: Measure, ratio: f64) -> Option<&'static str> {
    let dimension = match measure {
        Measure::Volume => 3.0,
        Measure::Area => 2.0,
        _ => return None,
    };
    spharm::shape::unit_factor(ratio.powf(1.0 / dimension))
}

/// Formats the edge lengths of a voxel, such as `1 x 1 x 1.5`.
#[must_use]
pub fn edges(size: [f64; 3]) -> String {
    size.map(|edge| ((1e4 * edge).round() / 1e4).to_string()).join(" x ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_ratios_of_units_are_taken_for_wrong_units() {
        assert_eq!(unit_factor(Measure::Volume, 1e9), Some("1000 times"));
        assert_eq!(unit_factor(Measure::Area, 0.012), Some("1/10 of"));
        assert_eq!(unit_factor(Measure::Volume, 3.0), None);
        assert_eq!(unit_factor(Measure::Distance, 1000.0), None);
    }

    #[test]
    fn counts_of_zero_are_left_out() {
        let repair = serde_json::json!({"pieces_dropped": 2, "voxels_dropped": 31, "handles": 0, "way": "filled"});
        let counts = Counts::of(repair.as_object().unwrap());
        assert_eq!((counts.voxels, counts.to_string().as_str()), (31, "pieces dropped 2, voxels dropped 31"));
    }
}
