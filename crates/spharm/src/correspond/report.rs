//! Reports on correspondences, with warnings.

use std::fmt;

use serde::Serialize;
use spharm_register::Cover;
use spharm_shape::groupwise::GroupwiseReport;
use spharm_surface::AxesDiffer;
use spharm_surface::pose::GroupPoseWarning;

use super::guide::GuideReport;

/// Largest share of a member's area that may have no counterpart on the template without a warning.
pub(super) const UNREACHED: f64 = 0.02;

/// Two surfaces are treated as the same if they differ by at most this fraction in area and in volume.
const SAME: f64 = 1e-6;

/// Returns whether two areas or volumes are treated as the same.
pub(super) fn close(a: f64, b: f64) -> bool {
    (a - b).abs() <= SAME * a.abs().max(b.abs())
}

/// Report on a group's correspondence.
#[derive(Debug, Clone)]
pub struct CorrespondReport {
    /// Index of the subject that was the first template, counted from 0; `None` for a given template.
    pub template: Option<usize>,
    /// Repairs of the first template that were necessary to map it to the sphere.
    pub changes: Vec<String>,
    /// Report on each member.
    pub members: Vec<MemberReport>,
    /// Reasons to check members.
    pub warnings: Vec<CorrespondWarning>,
    /// The axes stated in the members' files, if they differ between members.
    pub axes: Option<AxesDiffer>,
    /// Report on guiding landmarks; `None` without landmarks.
    pub guide: Option<GuideReport>,
    /// Report on the refinement; `None` if it was skipped.
    pub refinement: Option<GroupwiseReport>,
    /// Wall time of the steps in seconds, in order.
    pub seconds: Vec<(&'static str, f64)>,
}

impl CorrespondReport {
    /// Returns the warnings about the whole group. `members` has the name of each member, and whether the member was
    /// mirrored.
    #[must_use]
    pub fn of_group(&self, members: &[(&str, bool)]) -> Vec<String> {
        let of_pose = |warning: &CorrespondWarning| match warning {
            CorrespondWarning::Pose(of_pose) => Some(*of_pose),
            _ => None,
        };
        let of_poses: Vec<GroupPoseWarning> = self.warnings.iter().filter_map(of_pose).collect();
        let axes = self.axes.as_ref().map(|axes| axes.with_names(|member| members[member].0.to_owned()));
        GroupPoseWarning::two_sides(&of_poses, members).into_iter().chain(axes).collect()
    }
}

/// Report on the registration of one member; lengths are in the group's unit.
#[derive(Debug, Clone, Copy, Serialize)]
pub struct MemberReport {
    /// Median distance of the member's surface from the other surfaces after their poses were computed, or its
    /// distance from a given template.
    pub pose_distance: f64,
    /// Root mean square distance of the member's surface from the registered template.
    pub cover_rms: f64,
    /// 99th percentile, over the member's surface, of the distance from the registered template.
    pub cover_most: f64,
    /// Largest distance found between the member's surface and the registered template.
    pub cover_farthest: f64,
    /// Share of the member's area that the template doesn't reach.
    pub unreached: f64,
    /// Number of the template's points without a counterpart on the member. Points that are masked on the template
    /// itself aren't counted.
    pub without_counterpart: usize,
    /// Number of flipped triangles of the registered template.
    pub turned: usize,
    /// Root mean square distance between the model and the corresponding points that it was fitted to.
    pub model_rms: f64,
    /// Area of the member's surface, in the square of the surface's own unit; 0 if unknown.
    pub area: f64,
    /// Volume of the member's surface, at least 0, in the cube of the surface's own unit.
    pub volume: f64,
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
            area: 0.0,
            volume: 0.0,
        }
    }

    /// Converts the lengths of the registration and of the model to another unit, by multiplying them by `factor`. The
    /// distance of the pose isn't converted, nor are the area and the volume, which are in the surface's own unit.
    pub(super) fn in_unit_of(&mut self, factor: f64) {
        for length in [&mut self.cover_rms, &mut self.cover_most, &mut self.cover_farthest, &mut self.model_rms] {
            *length *= factor;
        }
    }

    /// Returns whether the areas and volumes of two members' surfaces are equal within a relative difference of 1e-6.
    /// If they are, the two surfaces are taken to be the same, possibly moved or mirrored.
    #[must_use]
    pub fn same_surface(&self, other: &Self) -> bool {
        self.area > 0.0 && close(self.area, other.area) && close(self.volume, other.volume)
    }
}

/// A reason to check a member.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum CorrespondWarning {
    /// The member's pose is doubtful, or its surface differs greatly from the other surfaces.
    Pose(GroupPoseWarning),
    /// The template reaches less than 98 % of the member's surface.
    Unreached {
        /// Index of the member, counted from 0.
        member: usize,
        /// Share of the member's area that the template doesn't reach.
        share: f64,
        /// Largest distance of the member's surface from the template.
        farthest: f64,
    },
    /// More than 5 % of the template's directions have no counterpart on the member.
    Lacks {
        /// Index of the member, counted from 0.
        member: usize,
        /// Share of the template's directions that have no counterpart.
        share: f64,
    },
    /// Two members have the same surface.
    Same {
        /// Index of the member, counted from 0.
        member: usize,
        /// Index of the earlier member with the same surface, counted from 0.
        as_member: usize,
    },
}

/// First words of the message about a member whose surface equals another member's. The other member's name follows.
pub const IDENTICAL_TO: &str = "the surface is identical to ";

impl CorrespondWarning {
    /// Returns the index of the member, counted from 0.
    #[must_use]
    pub fn member(&self) -> usize {
        match self {
            Self::Pose(warning) => warning.member(),
            Self::Unreached { member, .. } | Self::Lacks { member, .. } | Self::Same { member, .. } => *member,
        }
    }

    /// Returns the warning's message without the member's number. `name` returns the name of the member with a given
    /// index.
    #[must_use]
    pub fn of_member(&self, name: impl Fn(usize) -> String) -> String {
        match self {
            Self::Pose(warning @ GroupPoseWarning::Doubtful { near, .. }) => {
                let or_near =
                    if *near { "" } else { " or, if the given poses are right, search only near them (pose near)" };
                format!("{}; guide the registration by landmarks{or_near}", warning.of_member())
            }
            Self::Pose(warning) => warning.of_member(),
            Self::Unreached { share, farthest, .. } => format!(
                "the template doesn't reach {:.1} % of this surface (largest distance {farthest:.4}): the surface has \
                 parts that the template lacks",
                100.0 * share
            ),
            Self::Lacks { share, .. } => format!(
                "{:.1} % of the template has no counterpart on this surface; positions there are guesses and are \
                 marked as such",
                100.0 * share
            ),
            Self::Same { as_member, .. } => format!("{IDENTICAL_TO}{}", name(*as_member)),
        }
    }
}

impl fmt::Display for CorrespondWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "member {}: {}", self.member(), self.of_member(|other| format!("member {other}")))
    }
}

#[cfg(test)]
mod tests {
    use spharm_monitor::Silent;
    use spharm_surface::generate::icosphere;

    use super::*;
    use crate::correspond::{CorrespondParams, correspond};

    #[test]
    fn only_a_search_of_all_poses_advises_to_search_near_the_given_ones() {
        let text = |near| {
            let doubtful = GroupPoseWarning::Doubtful { member: 0, distance: 1.0, second: 1.05, near };
            CorrespondWarning::Pose(doubtful).of_member(|_| String::new())
        };
        assert!(text(false).ends_with(
            "guide the registration by landmarks or, if the given poses are right, search only near them (pose near)"
        ));
        assert!(text(true).ends_with("; guide the registration by landmarks"), "{}", text(true));
    }

    #[test]
    fn a_group_whose_files_state_different_axes_is_warned_about() {
        let ball = icosphere(3);
        let read = |index: usize| {
            let mut mesh =
                ball.with_vertices(ball.vertices.iter().map(|[x, y, z]| [9.0 * x, 6.0 * y, 4.0 * z]).collect());
            let axes = ["LPS", "RAS", "LPS"].get(index).map(|axes| ("SPACE".to_owned(), (*axes).to_owned()));
            mesh.meta.file_metadata.extend(axes);
            Ok(mesh)
        };
        let params = CorrespondParams::up_to(3).with_subdivisions(2).with_rounds(1).with_refinement(None);
        let group = correspond(4, &read, &params, &Silent).unwrap();
        assert_eq!(group.report.axes, Some(AxesDiffer { lps: vec![0, 2], ras: vec![1] }));
        let warnings = group.report.of_group(&["a", "b", "c", "d"].map(|name| (name, false)));
        assert!(warnings.iter().any(|text| text.contains("LPS for a, c; RAS for b")), "{warnings:?}");
    }
}
