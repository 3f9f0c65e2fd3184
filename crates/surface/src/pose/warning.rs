//! Defines warnings about poses that should be checked.

mod sides;

use std::fmt;

/// The distances in two poses of a member are treated as close if they differ by at most this factor. If the distances
/// in the two best poses are close, the distances from the other members decide between the poses. The warning
/// `Elsewhere` is given if a member's distance exceeds this multiple of the distance in its best pose.
pub const CLOSE: f64 = 1.5;

/// First words of messages about doubtful poses.
pub const IN_DOUBT: &str = "the pose is doubtful";

/// A reason to doubt the pose of a group's member.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum GroupPoseWarning {
    /// Another pose of the member is nearly as good.
    Doubtful {
        /// Index of the member, counted from 0.
        member: usize,
        /// The member's distance from the other members in the chosen pose.
        distance: f64,
        /// The member's distance from the other members in the other pose.
        second: f64,
        /// Whether only poses near the given one were considered.
        near: bool,
    },
    /// The member is much farther from the other members than is usual in the group. It may be of another kind or in
    /// another unit.
    Far {
        /// Index of the member, counted from 0.
        member: usize,
        /// The member's distance from the other members.
        distance: f64,
        /// Median over all members of their distance from the other members.
        median: f64,
    },
    /// Only poses near the given one were considered, but another pose of the member is much better.
    Elsewhere {
        /// Index of the member, counted from 0.
        member: usize,
        /// The member's distance from the typical member, in the pose that was found near the given pose.
        distance: f64,
        /// The member's distance from the typical member in the best pose.
        best: f64,
    },
    /// The member's mirror image is nearer to the other members, and mirror images weren't allowed.
    Mirrored {
        /// Index of the member, counted from 0.
        member: usize,
        /// The member's distance from the other members.
        distance: f64,
        /// The distance of the member's mirror image from the other members.
        mirrored: f64,
    },
}

/// Warning that the mirror image of a surface is nearer to another surface, although mirror images weren't allowed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NearerMirrored {
    /// Distance of the surface from the other surface in its best pose.
    pub distance: f64,
    /// Distance of the surface's mirror image from the other surface in its best pose.
    pub mirrored: f64,
}

impl fmt::Display for NearerMirrored {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = mirror_image_fits("the other surface", self.distance, self.mirrored);
        write!(f, "{text}; to match mirror images, use --mirror (in Python mirror=True)")
    }
}

fn mirror_image_fits(others: &str, distance: f64, mirrored: f64) -> String {
    format!(
        "the mirror image fits {others} better (distance {mirrored:.4} instead of {distance:.4}): the surface may be \
         from the other side of the body, or the file may be mirrored"
    )
}

impl GroupPoseWarning {
    /// Returns the index of the member, counted from 0.
    #[must_use]
    pub fn member(&self) -> usize {
        match self {
            Self::Doubtful { member, .. }
            | Self::Far { member, .. }
            | Self::Elsewhere { member, .. }
            | Self::Mirrored { member, .. } => *member,
        }
    }

    /// Returns whether the warning explains why the member is far from the other members: another pose or the mirror
    /// image is much nearer, or the member is of another kind.
    pub(super) fn explains_distance(&self) -> bool {
        match self {
            Self::Elsewhere { .. } | Self::Far { .. } => true,
            Self::Mirrored { distance, mirrored, .. } => CLOSE * mirrored < *distance,
            Self::Doubtful { .. } => false,
        }
    }

    /// Returns the warning's message without the member's index.
    #[must_use]
    pub fn of_member(&self) -> String {
        match self {
            Self::Doubtful { distance, second, .. } => format!(
                "{IN_DOUBT}: another pose fits the other surfaces {} (distance {second:.4} instead of {distance:.4}), \
                 so the surface may be the wrong way round",
                if second < distance { "better" } else { "nearly equally well" }
            ),
            Self::Far { distance, median, .. } => format!(
                "the distance from the other surfaces is {distance:.4}, but the group's median distance is \
                 {median:.4}: the surface may be of another kind or in another unit"
            ),
            Self::Elsewhere { distance, best, .. } => format!(
                "the distance from the typical surface is {distance:.4} near the given pose, but only {best:.4} in \
                 another pose: the surface may be rotated or in another coordinate system"
            ),
            Self::Mirrored { distance, mirrored, .. } => mirror_image_fits("the other surfaces", *distance, *mirrored),
        }
    }
}

impl fmt::Display for GroupPoseWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "member {}: {}", self.member(), self.of_member())
    }
}
