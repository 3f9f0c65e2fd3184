//! Settings and results of a group's alignment.

use std::fmt;

use spharm_harmonics::Coefficients;
use spharm_surface::pose::GroupPoseWarning;

use crate::align::{AlignParams, AlignWarning};
use crate::surface_poses::SurfacePoseWarning;
use crate::transform::Transform;

/// Settings of a group's alignment.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcrustesParams {
    /// How a surface is brought to another: [`Method::Joint`](crate::Method::Joint),
    /// [`Method::Surfaces`](crate::Method::Surfaces) or [`Method::FixedParameters`](crate::Method::FixedParameters). By
    /// default 3 starts are refined in each search, as every surface is searched several times.
    pub align: AlignParams,
    /// Templates to start from; by default every member of up to 20, and 5 members of larger groups.
    pub templates: Option<usize>,
    /// A start ends when the spread falls by less than this, relative to itself; 1e-7 by default. The best start goes
    /// on until surfaces move by less than 1e-10 of their size.
    pub tolerance: f64,
    /// Rounds of a start, at most; 100 by default.
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

/// Something to know about a group's alignment.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum ProcrustesWarning {
    /// Members have different degrees; those up to the lowest were compared.
    DegreesDiffer {
        /// The lowest one.
        lowest: usize,
        /// The highest one.
        highest: usize,
    },
    /// A member is nearer to the others as its mirror image, where these are nearer as they are: it may be of the other
    /// side. Where shapes hardly differ from their mirror images, or differ more among themselves, as five hippocampi
    /// do, a mirrored member mostly isn't noticed.
    Mirrored {
        /// The member, counted from 0.
        member: usize,
        /// Its distance from the mean of the others.
        rmsd: f64,
        /// That of its mirror image.
        mirrored: f64,
    },
    /// The group is of two sides, and its mean of neither: with mirror images matched its spread is less by a fifth or
    /// more.
    Sides {
        /// The members of the smaller side, counted from 0; of two that are alike, of the one that the first member
        /// isn't on. Empty where shapes don't tell which ones they are.
        members: Vec<usize>,
        /// Members of the group.
        of: usize,
        /// The group's spread; where poses are by the surfaces, distance of those of one side from the typical one of
        /// the other.
        spread: f64,
        /// The same with mirror images matched.
        mirrored: f64,
    },
    /// Something to know about how one member was brought to the mean.
    Member {
        /// The member, counted from 0.
        member: usize,
        /// What.
        warning: AlignWarning,
    },
    /// The mean's first-order ellipsoid is nearly round: the group's pose has little meaning.
    NearlyRound {
        /// The ratio of its neighbouring axes.
        ratio: f64,
    },
    /// A member has no area, so that poses are by the distance at equal directions, as of
    /// [`Method::Joint`](crate::Method::Joint).
    NoArea {
        /// The member, counted from 0.
        member: usize,
    },
    /// The pose of a member's surface beside the others', of [`Method::Surfaces`](crate::Method::Surfaces).
    Pose(GroupPoseWarning),
    /// The surfaces don't lie on each other as the alignment suggests.
    Surfaces(SurfacePoseWarning),
    /// The rounds were used up.
    NotConverged {
        /// The last relative change of the spread.
        change: f64,
    },
}

impl ProcrustesWarning {
    /// Returns the member that it is about, counted from 0, if it is about one.
    #[must_use]
    pub fn member(&self) -> Option<usize> {
        match self {
            Self::Mirrored { member, .. }
            | Self::Member { member, .. }
            | Self::NoArea { member }
            | Self::Surfaces(SurfacePoseWarning::Turned { member, .. }) => Some(*member),
            Self::Pose(warning) => Some(warning.member()),
            _ => None,
        }
    }

    /// Returns what it says of the member, without its number, where it is about one; else all of it.
    #[must_use]
    pub fn of_member(&self) -> String {
        match self {
            Self::Mirrored { rmsd, mirrored, .. } => {
                format!("is {rmsd:.4} from the others, and its mirror image {mirrored:.4}: it may be of the other side")
            }
            Self::Member { warning, .. } => warning.to_string(),
            Self::NoArea { .. } => {
                "it has no area, so that the group's poses are by the distance at equal directions".to_owned()
            }
            Self::Surfaces(warning) => warning.of_member(),
            Self::Pose(warning) => warning.of_member(),
            other => other.to_string(),
        }
    }

    /// Returns the members that are, or may be, mirror images of the others, counted from 0.
    #[must_use]
    pub fn mirrored(&self) -> &[usize] {
        match self {
            Self::Mirrored { member, .. } => std::slice::from_ref(member),
            Self::Sides { members, .. } => members,
            _ => &[],
        }
    }

    /// Returns the warning with members by their names, at most 12 of a list.
    pub fn naming(&self, name: impl Fn(usize) -> String) -> String {
        const MOST: usize = 12;
        match (self, self.member()) {
            (_, Some(member)) => format!("{}: {}", name(member), self.of_member()),
            (Self::Sides { members, of, spread, mirrored }, _) => {
                let named: Vec<String> = members.iter().take(MOST).map(|member| name(*member)).collect();
                let more = members.len().saturating_sub(MOST);
                let more = if more > 0 { format!(" and {more} more") } else { String::new() };
                let which = match members.len() {
                    0 => "; the shapes don't tell which members are of which side".to_owned(),
                    count => format!(": {count} of {of} members may be of the other one: {}{more}", named.join(", ")),
                };
                format!(
                    "the group seems to be of two sides, and its mean of neither: with mirror images matched the spread falls from \
                     {spread:.4} to {mirrored:.4}{which}"
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
            Self::Mirrored { member, .. } => write!(f, "member {member} {}", self.of_member()),
            Self::Member { member, .. } | Self::NoArea { member } => {
                write!(f, "member {member}: {}", self.of_member())
            }
            Self::Surfaces(warning) => warning.fmt(f),
            Self::Pose(warning) => warning.fmt(f),
            Self::NearlyRound { ratio } => write!(
                f,
                "the mean's first-order ellipsoid has axes alike, with a ratio of {ratio:.3}: the group's pose has little \
                 meaning"
            ),
            Self::NotConverged { change } => {
                write!(f, "the rounds were used up while the spread still fell by {change:.1e} of itself")
            }
        }
    }
}

/// Where a start ended.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TemplateEnd {
    /// The member that all were brought to first.
    pub template: usize,
    /// The spread that was reached.
    pub spread: f64,
    /// Rounds that it took.
    pub rounds: usize,
}

/// What an alignment of a group did.
#[derive(Debug, Clone, PartialEq)]
pub struct ProcrustesReport {
    /// Highest degree compared.
    pub degree: usize,
    /// Root mean square distance of the members from their mean, in their unit: after centring alone, and at the end.
    pub spread_before: f64,
    /// See `spread_before`.
    pub spread_after: f64,
    /// Distance of each member from the mean, at equal directions.
    pub rmsd: Vec<f64>,
    /// Distance of each member's surface from the mean's, whatever the directions.
    pub surface_distances: Vec<f64>,
    /// Where each start ended.
    pub ends: Vec<TemplateEnd>,
    /// What to know.
    pub warnings: Vec<ProcrustesWarning>,
}

/// A group that was brought together.
#[derive(Debug, Clone, PartialEq)]
pub struct Procrustes {
    /// What brings each member to the mean, at all its degrees.
    pub transforms: Vec<Transform>,
    /// The mean, (K, 3) of the highest degree compared, centred.
    pub mean: Coefficients,
    /// What was done.
    pub report: ProcrustesReport,
}
