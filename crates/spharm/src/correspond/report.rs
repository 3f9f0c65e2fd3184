//! How a correspondence was found, and what to look at.

use std::fmt;

use serde::Serialize;
use spharm_register::Cover;
use spharm_shape::groupwise::GroupwiseReport;
use spharm_surface::pose::GroupPoseWarning;

use super::guide::GuideReport;

/// Share of a member's area that the template may miss before it is named.
pub(super) const UNREACHED: f64 = 0.02;

/// How a group was made to correspond.
#[derive(Debug, Clone)]
pub struct CorrespondReport {
    /// The subject that was the first template, counted from 0; none for one that was given.
    pub template: Option<usize>,
    /// Repairs that the first template needed to be mapped.
    pub changes: Vec<String>,
    /// Each member.
    pub members: Vec<MemberReport>,
    /// What to look at.
    pub warnings: Vec<CorrespondWarning>,
    /// Landmarks that guided, where there were any.
    pub guide: Option<GuideReport>,
    /// The refinement, where there was one.
    pub refinement: Option<GroupwiseReport>,
    /// Seconds of the steps, in their order.
    pub seconds: Vec<(&'static str, f64)>,
}

/// How one member was registered, lengths in the group's unit.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct MemberReport {
    /// The median distance of its surface from the others' in the group's pose.
    pub pose_distance: f64,
    /// Root mean square distance of its surface from the registered template.
    pub cover_rms: f64,
    /// The distance below which 99 % of its surface is.
    pub cover_most: f64,
    /// The largest distance found.
    pub cover_farthest: f64,
    /// Share of its area that the template doesn't reach.
    pub unreached: f64,
    /// Places of the template without a counterpart on it, but for the template's own.
    pub without_counterpart: usize,
    /// Triangles that are turned over.
    pub turned: usize,
    /// Root mean square distance between the model and the places that it was fitted to.
    pub model_rms: f64,
}

impl MemberReport {
    pub(super) fn new(pose_distance: f64, cover: &Cover) -> Self {
        Self {
            pose_distance,
            cover_rms: cover.rms,
            cover_most: cover.most,
            cover_farthest: cover.farthest,
            unreached: cover.unreached,
            without_counterpart: 0,
            turned: 0,
            model_rms: 0.0,
        }
    }
}

/// A reason to look at a member.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum CorrespondWarning {
    /// Its pose, or its kind, is in doubt.
    Pose(GroupPoseWarning),
    /// The template reaches less of its surface than 98 %.
    Unreached {
        /// The member, counted from 0.
        member: usize,
        /// Share of its area that isn't reached.
        share: f64,
        /// How far the template is at most.
        farthest: f64,
    },
    /// Much of the template has no counterpart on it.
    Lacks {
        /// The member, counted from 0.
        member: usize,
        /// Share of the template's directions.
        share: f64,
    },
    /// Two members are the same surface.
    Same {
        /// The member, counted from 0.
        member: usize,
        /// The other, before it.
        as_member: usize,
    },
}

impl CorrespondWarning {
    /// Returns the member, counted from 0.
    #[must_use]
    pub fn member(&self) -> usize {
        match self {
            Self::Pose(warning) => warning.member(),
            Self::Unreached { member, .. } | Self::Lacks { member, .. } | Self::Same { member, .. } => *member,
        }
    }

    /// Returns the text without the member's number; `name` gives the name of another one.
    #[must_use]
    pub fn of_member(&self, name: impl Fn(usize) -> String) -> String {
        match self {
            Self::Pose(warning) => warning.of_member(),
            Self::Unreached { share, farthest, .. } => format!(
                "the template doesn't reach {:.1} % of its surface, by at most {farthest:.4}: it has parts that the template \
                 lacks",
                100.0 * share
            ),
            Self::Lacks { share, .. } => format!(
                "{:.1} % of the template have no counterpart on it: places there are guesses, and marked so",
                100.0 * share
            ),
            Self::Same { as_member, .. } => format!("it is the same surface as {}", name(*as_member)),
        }
    }
}

impl fmt::Display for CorrespondWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "member {}: {}", self.member(), self.of_member(|other| format!("member {other}")))
    }
}
