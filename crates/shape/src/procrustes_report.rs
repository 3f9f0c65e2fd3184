//! Settings and results of a group's alignment.

use std::fmt;

use spharm_harmonics::Coefficients;
use spharm_surface::pose::GroupPoseWarning;

use crate::align::{AlignParams, AlignWarning};
use crate::surface_poses::SurfacePoseWarning;
use crate::transform::Transform;
use crate::units::OtherUnit;

/// Settings of a group's alignment.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcrustesParams {
    /// Settings for aligning one surface to another. The method must be [`Method::Joint`](crate::Method::Joint),
    /// [`Method::Surfaces`](crate::Method::Surfaces) or [`Method::FixedParameters`](crate::Method::FixedParameters). By
    /// default only 3 starts are refined per search, because every surface is searched several times.
    pub align: AlignParams,
    /// Number of templates; by default all members in groups of up to 20, and 5 members in larger groups.
    pub templates: Option<usize>,
    /// An alignment from one template has converged when a round decreases the spread by less than this fraction; 1e-7
    /// by default. The best of these alignments then continues until surfaces move by less than 1e-10 of their size.
    pub tolerance: f64,
    /// Maximum number of rounds for each template; 100 by default.
    pub max_rounds: usize,
}

impl Default for ProcrustesParams {
    fn default() -> Self {
        Self {
            align: AlignParams { starts: 3, ..Default::default() },
            templates: None,
            tolerance: 1e-7,
            max_rounds: 100,
        }
    }
}

/// Warnings about a group's alignment.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ProcrustesWarning {
    /// The members have different maximum degrees; only degrees up to the lowest of these were compared.
    DegreesDiffer {
        /// Lowest maximum degree of a member.
        lowest: usize,
        /// Highest maximum degree of a member.
        highest: usize,
    },
    /// The lengths of a member seem to be in a different unit from those of the other members.
    Unit(OtherUnit),
    /// A member's mirror image is nearer to the other members than the member itself is, whereas the others are nearer
    /// to each other without mirroring. The member may therefore be from the other side of the body. A mirrored member
    /// usually isn't detected if the shapes differ little from their mirror images, or if they differ more from each
    /// other than from their mirror images. Hippocampi are an example of the second case.
    Mirrored {
        /// Index of the member, from 0.
        member: usize,
        /// Distance of the member from the mean of the other members. If the surfaces determine the poses, this is the
        /// distance between the surfaces of the member and of the typical member, at the typical member's size.
        rmsd: f64,
        /// Distance of the member's mirror image, measured in the same way as `rmsd`.
        mirrored: f64,
    },
    /// The group mixes two sides, and its mean belongs to neither: matching mirror images reduces the spread by more
    /// than 18 %.
    Sides {
        /// Indices of the members on the smaller side, from 0. If both sides have the same size, the side without the
        /// first member is listed. Empty if the shapes don't show which members belong to this side.
        members: Vec<usize>,
        /// Number of members in the group.
        of: usize,
        /// Spread of the group. If the surfaces determine the poses, this is the root mean square distance of the
        /// members of one side from the typical member of the other side.
        spread: f64,
        /// Spread after mirroring all members whose mirror images fit better, measured in the same way as `spread`.
        mirrored: f64,
    },
    /// A warning about the alignment of one member to the mean.
    Member {
        /// Index of the member, from 0.
        member: usize,
        /// The warning.
        warning: AlignWarning,
    },
    /// The mean's first-order ellipsoid is nearly round, so the group's pose has little meaning.
    NearlyRound {
        /// Smallest ratio between the lengths of neighbouring axes.
        ratio: f64,
    },
    /// A member has no area, so poses are determined by the distances between points at equal directions, as with
    /// [`Method::Joint`](crate::Method::Joint).
    NoArea {
        /// Index of the member, from 0.
        member: usize,
    },
    /// A warning about the pose of a member's surface relative to the other members, for
    /// [`Method::Surfaces`](crate::Method::Surfaces).
    Pose(GroupPoseWarning),
    /// A warning from comparing the surfaces themselves, regardless of directions.
    Surfaces(SurfacePoseWarning),
    /// The alignment hasn't converged after the maximum number of rounds.
    NotConverged {
        /// The last relative change of the spread.
        change: f64,
    },
}

impl ProcrustesWarning {
    /// Returns the index, from 0, of the member concerned, if the warning concerns a single member.
    #[must_use]
    pub fn member(&self) -> Option<usize> {
        match self {
            Self::Mirrored { member, .. }
            | Self::Member { member, .. }
            | Self::NoArea { member }
            | Self::Surfaces(SurfacePoseWarning::Turned { member, .. }) => Some(*member),
            Self::Pose(warning) => Some(warning.member()),
            Self::Unit(warning) => Some(warning.member),
            _ => None,
        }
    }

    /// Returns the warning's text, without the member's number if the warning concerns a single member.
    #[must_use]
    pub fn of_member(&self) -> String {
        match self {
            Self::Mirrored { rmsd, mirrored, .. } => {
                format!(
                    "the member's distance from the other members is {rmsd:.4}, but that of its mirror image is \
                     {mirrored:.4}: the member may be from the other side, such as left instead of right"
                )
            }
            Self::Member { warning, .. } => warning.to_string(),
            Self::NoArea { .. } => {
                "the member has no area, so the group is aligned by the distance at equal directions".to_owned()
            }
            Self::Surfaces(warning) => warning.of_member(),
            Self::Pose(warning) => warning.of_member(),
            Self::Unit(warning) => warning.of_member(),
            other => other.to_string(),
        }
    }

    /// Returns the indices, from 0, of members that may be mirror images of the other members.
    #[must_use]
    pub fn mirrored(&self) -> &[usize] {
        match self {
            Self::Mirrored { member, .. } => std::slice::from_ref(member),
            Self::Sides { members, .. } => members,
            _ => &[],
        }
    }

    /// Returns the warning's text. `name` returns the name of the member with a given index. The text lists at most 12
    /// members by name.
    pub fn naming(&self, name: impl Fn(usize) -> String) -> String {
        const MOST: usize = 12;
        match (self, self.member()) {
            (_, Some(member)) => format!("{}: {}", name(member), self.of_member()),
            (Self::Sides { members, of, spread, mirrored }, _) => {
                let named: Vec<String> = members.iter().take(MOST).map(|member| name(*member)).collect();
                let more = members.len().saturating_sub(MOST);
                let more = if more > 0 { format!(" and {more} more") } else { String::new() };
                let which = match members.len() {
                    0 => "; the shapes don't show which members are from which side".to_owned(),
                    count => {
                        format!("; {count} of {of} members may be from the other side: {}{more}", named.join(", "))
                    }
                };
                format!(
                    "the group seems to mix two sides, such as left and right, so its mean resembles neither side: if \
                     mirror images are allowed, the spread falls from {spread:.4} to {mirrored:.4}{which}"
                )
            }
            _ => self.to_string(),
        }
    }
}

impl fmt::Display for ProcrustesWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::DegreesDiffer { lowest, highest } => {
                write!(f, "the members have degrees {lowest} to {highest}; degrees up to {lowest} were compared")
            }
            Self::Sides { .. } => f.write_str(&self.naming(|member| member.to_string())),
            Self::Mirrored { member, .. } | Self::Member { member, .. } | Self::NoArea { member } => {
                write!(f, "member {member}: {}", self.of_member())
            }
            Self::Surfaces(warning) => warning.fmt(f),
            Self::Pose(warning) => warning.fmt(f),
            Self::Unit(warning) => warning.fmt(f),
            Self::NearlyRound { ratio } => write!(
                f,
                "two axes of the mean's first-order ellipsoid have nearly equal lengths, with a ratio of {ratio:.3}: \
                 the orientation of the group is unreliable"
            ),
            Self::NotConverged { change } => {
                write!(
                    f,
                    "the alignment did not converge within the maximum number of rounds: the last round still \
                     reduced the spread by a fraction of {change:.1e}"
                )
            }
        }
    }
}

/// Result of the alignment that started from one template.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TemplateEnd {
    /// Index of the member to which all members were first aligned.
    pub template: usize,
    /// Spread of the group after this alignment.
    pub spread: f64,
    /// Number of rounds that the alignment took.
    pub rounds: usize,
}

/// Report of a group's alignment.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcrustesReport {
    /// Highest degree compared.
    pub degree: usize,
    /// Root mean square distance of the members from their mean after centring alone, in the members' unit.
    pub spread_before: f64,
    /// Root mean square distance of the members from their mean after the alignment, in the members' unit.
    pub spread_after: f64,
    /// Distance of each member from the mean, between points at equal directions.
    pub rmsd: Vec<f64>,
    /// Distance between each member's surface and the mean's surface, measured to nearest points, regardless of
    /// directions.
    pub surface_distances: Vec<f64>,
    /// Results of the alignments, one for each template.
    pub ends: Vec<TemplateEnd>,
    /// Warnings about the group's alignment.
    pub warnings: Vec<ProcrustesWarning>,
}

/// An aligned group.
#[derive(Debug, Clone, PartialEq)]
pub struct Procrustes {
    /// For each member, the transform that aligns it to the mean. The transform applies to all degrees of the member.
    pub transforms: Vec<Transform>,
    /// Coefficients (K, 3) of the group's centred mean, up to the highest degree compared.
    pub mean: Coefficients,
    /// Spreads, distances and warnings.
    pub report: ProcrustesReport,
}
