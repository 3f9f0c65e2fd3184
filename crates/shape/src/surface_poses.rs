//! Checks whether the surfaces of an aligned group coincide in space, regardless of their parameters.
//!
//! An alignment compares the points of surfaces at equal directions. If the surfaces' maps to the sphere differ, the
//! pose with the smallest distance at equal directions may be wrong. After such an alignment of ten vertebrae, the
//! distances between corresponding points were 4 to 65 mm. After a further rigid motion, they were only 4 to 7 mm.
//! Therefore the surfaces themselves are compared. Points are spread evenly over the area of each surface, and their
//! distances to the nearest points of the other surface are measured. The distance
//!
//! ```text
//! d(A, B)^2 = (mean_p d(p, B)^2 + mean_q d(q, A)^2) / 2,  p on A, q on B
//! ```
//!
//! is measured between each member and the mean. If the group's poses are wrong, the mean resembles no member. Members
//! are therefore also compared with the typical member, which is the member nearest to the mean. These distances are
//! measured in the given pose, after a small rigid motion that is found from nearest points, and in the best of all
//! [poses](mod@spharm_surface::pose). If the best pose reduces the distance by more than [`GAIN`], the member's pose is
//! wrong. The distances of six of the ten vertebrae fall by 36 to 69 %. The distances of hippocampi and generated
//! bodies in correct poses fall by at most 9 %.
//!
//! A second check concerns the correspondence. If the members' distance from the mean at equal directions exceeds the
//! distance between the surfaces by a factor above [`FAR`], equal directions don't correspond. The group's variance is
//! then mostly variance of the maps to the sphere. Because the mean may not resemble any member, distances from the
//! typical member are checked in the same way, with the factor [`FAR_FROM_A_MEMBER`].
//!
//! Cost: about 70 ms per member, on two threads. Memory: 2 MB per thread.

use std::fmt;

use ndarray::{ArrayView2, s};
use rayon::prelude::*;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_monitor::Monitor;
use spharm_surface::matrix3::angle_between;
use spharm_surface::pose::{PoseParams, PoseSurface, distance, improved, pose};

use crate::error::ShapeError;
use crate::evaluated::Evaluated;
use crate::transform::{SQRT_4_PI, Similarity};

/// A member's pose is reported as wrong if a rotation reduces the member's distance from the typical member by more
/// than this fraction.
pub const GAIN: f64 = 0.2;
/// Maximum ratio between two distances of the members from the mean: the distance between points at equal directions,
/// and the distance between the surfaces. If the ratio is above this value, equal directions don't correspond.
pub const FAR: f64 = 2.0;
/// Maximum ratio as in [`FAR`], for distances from the typical member instead of the mean. This limit is higher than
/// [`FAR`], because a member's surface has more relief than the mean's surface. The ratio is 2.0 to 2.3 for surfaces
/// whose coefficients differ only by noise, and 2.1 for hippocampi.
pub const FAR_FROM_A_MEMBER: f64 = 2.5;
/// Distances of a group's surfaces from the surface of their mean.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfacePoses {
    /// Root mean square distance between each member's surface and the mean's surface, in both directions, in the
    /// surfaces' unit.
    pub distances: Vec<f64>,
    /// Warnings about the correspondence between the members of the group.
    pub warnings: Vec<SurfacePoseWarning>,
}

/// Reasons to doubt that the members of a group correspond.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum SurfacePoseWarning {
    /// Rotating a member would bring its surface much nearer to the other surfaces.
    Turned {
        /// Index of the member, from 0.
        member: usize,
        /// Index of the typical member, with which the member is compared. It is the member nearest to the mean.
        typical: usize,
        /// Distance between the member's surface and the typical member's surface.
        distance: f64,
        /// The same distance after the rotation.
        turned: f64,
        /// Angle of the rotation, in degrees.
        angle: f64,
    },
    /// Points at equal directions don't correspond.
    PlacesDiffer {
        /// Root mean square distance of the members from the reference at equal directions. The reference is the
        /// mean, or the member nearest to the mean.
        rmsd: f64,
        /// Distance between the surfaces of the members and of the reference.
        distance: f64,
        /// Name of the reference in the warning's text.
        from: &'static str,
    },
}

impl SurfacePoseWarning {
    /// Returns the warning's text, without the member's number.
    #[must_use]
    pub fn of_member(&self) -> String {
        match self {
            Self::Turned { distance, turned, angle, .. } => format!(
                "the distance from the surface of the most typical member is {distance:.4}, but would be {turned:.4} \
                 after a rotation by {angle:.0} degrees: the pose may be wrong"
            ),
            Self::PlacesDiffer { .. } => self.to_string(),
        }
    }
}

impl fmt::Display for SurfacePoseWarning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Turned { member, .. } => write!(f, "member {member}: {}", self.of_member()),
            Self::PlacesDiffer { rmsd, distance, from } => write!(
                f,
                "the distance between the members and {from} is {rmsd:.4} if points at equal directions are compared, \
                 but {distance:.4} if surfaces are compared: equal directions don't correspond, so modes and tests \
                 reflect differences between the maps to the sphere"
            ),
        }
    }
}

/// Compares the surfaces of members (K, 3), in the group's pose, with the surface of their mean. A member's degree must
/// be at least the mean's; higher degrees are ignored. Members in `except`, such as known mirror images, cause no
/// warnings.
///
/// # Panics
///
/// If a member's degree is below the mean's.
///
/// # Errors
///
/// [`ShapeError::Transform`] if the transform fails; [`ShapeError::Interrupted`] if the monitor cancels.
pub fn surface_poses(
    members: &[ArrayView2<'_, f64>],
    mean: &Coefficients,
    except: &[usize],
    monitor: &dyn Monitor,
) -> Result<SurfacePoses, ShapeError> {
    let degree = mean.max_degree();
    let evaluated = Evaluated::new(degree)?;
    let surface = |coefficients: ArrayView2<'_, f64>| evaluated.surface(coefficients);
    let of_mean = mean.values().view();
    let mean = surface(of_mean)?;
    let row = |member: usize| members[member].slice_move(s![..basis_size(degree), ..]);
    let from_mean = |member: usize| -> Result<f64, ShapeError> {
        monitor.check()?;
        Ok(as_they_lie(surface(row(member))?.as_ref(), mean.as_ref()))
    };
    let distances: Vec<Result<f64, ShapeError>> = (0..members.len()).into_par_iter().map(from_mean).collect();
    let distances = distances.into_iter().collect::<Result<Vec<f64>, _>>()?;
    // If many poses are wrong, the mean resembles no member. Therefore members are compared with the member nearest to
    // the mean.
    let candidates = (0..distances.len()).filter(|member| !except.contains(member));
    let Some(typical) = candidates.min_by(|a, b| distances[*a].total_cmp(&distances[*b])) else {
        return Ok(SurfacePoses { distances, warnings: Vec::new() });
    };
    let of_typical = surface(row(typical))?;
    let alike: Vec<usize> =
        (0..members.len()).filter(|member| *member != typical && !except.contains(member)).collect();
    let look = |&member: &usize| -> Result<Look, ShapeError> {
        monitor.check()?;
        let surface = surface(row(member))?;
        let turned = match (&surface, &of_typical) {
            (Some(surface), Some(typical)) => better_turn(surface, typical, monitor)?,
            _ => None,
        };
        let warning =
            |(distance, turned, angle)| SurfacePoseWarning::Turned { member, typical, distance, turned, angle };
        let distance = as_they_lie(surface.as_ref(), of_typical.as_ref());
        Ok(Look { turned: turned.map(warning), rmsd: rmsd(row(member), row(typical)), distance })
    };
    let looks: Vec<Result<Look, ShapeError>> = alike.par_iter().map(look).collect();
    let looks = looks.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut warnings: Vec<SurfacePoseWarning> = looks.iter().filter_map(|look| look.turned).collect();
    // A mean that includes mirror images (`except`) resembles no member. Members are therefore compared with the mean
    // only if there are no mirror images.
    let of_all = except.is_empty().then(|| {
        let rmsd = (0..members.len()).map(|member| rmsd(row(member), of_mean));
        (root_mean_square(rmsd), root_mean_square(distances.iter().copied()), "their mean", FAR)
    });
    let rmsd = root_mean_square(looks.iter().map(|look| look.rmsd));
    let distance = root_mean_square(looks.iter().map(|look| look.distance));
    let apart = [of_all, Some((rmsd, distance, "the most typical member", FAR_FROM_A_MEMBER))];
    let places = apart.into_iter().flatten().find(|(rmsd, distance, _, far)| *rmsd > far * distance);
    warnings.extend(places.map(|(rmsd, distance, from, _)| SurfacePoseWarning::PlacesDiffer { rmsd, distance, from }));
    Ok(SurfacePoses { distances, warnings })
}

/// Result of comparing a member with the typical member.
struct Look {
    turned: Option<SurfacePoseWarning>,
    /// Root mean square distance from the typical member, between points at equal directions.
    rmsd: f64,
    /// Distance between the surfaces of the two members.
    distance: f64,
}

/// Returns the root mean square distance between two surfaces, between points at equal directions.
fn rmsd(a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>) -> f64 {
    (&a - &b).iter().map(|v| v * v).sum::<f64>().sqrt() / SQRT_4_PI
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

/// Returns the distance between two surfaces in their given poses, over all their points; 0 if either surface is
/// `None`.
fn as_they_lie(a: Option<&PoseSurface>, b: Option<&PoseSurface>) -> f64 {
    a.zip(b).map_or(0.0, |(a, b)| distance(a, b, &Similarity::default(), 0.0))
}

/// Returns the distance of a member from the typical member, the distance in the best pose, and the angle in degrees of
/// the rotation to the best pose. Returns `None` if the best pose doesn't reduce the distance by more than [`GAIN`].
/// Both distances are measured after a rigid motion that is found from nearest points, so that only large changes of
/// pose matter.
fn better_turn(
    member: &PoseSurface,
    typical: &PoseSurface,
    monitor: &dyn Monitor,
) -> Result<Option<(f64, f64, f64)>, ShapeError> {
    let params = PoseParams { trimmed: 0.0, ..PoseParams::default() };
    let (motion, distance) = improved(member, typical, &Similarity::default(), &params);
    let best = pose(member, typical, &params, monitor)?;
    let angle = angle_between(&motion.orthogonal, &best.similarity.orthogonal).to_degrees();
    Ok((best.distance < (1.0 - GAIN) * distance).then_some((distance, best.distance, angle)))
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use spharm_monitor::Silent;

    use super::*;
    use crate::Rotation;
    use crate::samples::blob;
    use crate::{Transform as Pose, mean};

    /// Returns slightly different blobs, each in the pose given for its index.
    fn group(pose: impl Fn(usize) -> Pose) -> Vec<Coefficients> {
        let common = blob(6, 1);
        let member = |n: usize| {
            let values = common.values() + &(0.04 * (blob(6, 20 + n as u32).values() - common.values()));
            pose(n).apply(&Coefficients::new(values).unwrap(), &Silent).unwrap()
        };
        (0..8).map(member).collect()
    }

    fn looked_at(members: &[Coefficients]) -> SurfacePoses {
        let mean = mean(members).unwrap();
        let views: Vec<ArrayView2<'_, f64>> = members.iter().map(|member| member.values().view()).collect();
        surface_poses(&views, &mean, &[], &Silent).unwrap()
    }

    #[test]
    fn a_group_in_one_pose_is_left_alone() {
        let found = looked_at(&group(|_| Pose::default()));
        assert!(found.warnings.is_empty(), "{:?}", found.warnings);
        assert!(found.distances.len() == 8 && found.distances.iter().all(|d| (0.001..1.0).contains(d)), "{found:?}");
    }

    #[test]
    fn a_member_that_is_turned_is_named() {
        // A member is rotated about each axis of the first-order ellipsoid, as it may be after a wrong alignment.
        for axis in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            let turn = Rotation::from_axis_angle(axis, std::f64::consts::PI).unwrap();
            let similarity = Similarity { orthogonal: turn.matrix(), ..Similarity::default() };
            let found =
                looked_at(&group(|n| if n == 5 { Pose { similarity, ..Pose::default() } } else { Pose::default() }));
            let named: Vec<usize> = found
                .warnings
                .iter()
                .filter_map(|warning| match warning {
                    SurfacePoseWarning::Turned { member, distance, turned, .. } if turned < distance => Some(*member),
                    _ => None,
                })
                .collect();
            assert_eq!(named, [5], "{axis:?}: {found:?}");
            assert!(found.warnings[0].to_string().starts_with("member 5: the distance from the surface "), "{found:?}");
        }
    }

    #[test]
    fn parameters_that_differ_are_noticed() {
        let turn = |n: usize| Rotation::from_euler(0.9 * n as f64, 0.5 * n as f64, 0.2).unwrap();
        let found = looked_at(&group(|n| Pose { rotation: turn(n), ..Pose::default() }));
        assert!(
            found.warnings.iter().any(|warning| matches!(warning, SurfacePoseWarning::PlacesDiffer { .. })),
            "{found:?}"
        );
    }

    #[test]
    fn what_is_no_surface_has_distances_of_zero() {
        let point = Coefficients::new(Array2::zeros((4, 3))).unwrap();
        let found = looked_at(&[point.clone(), point.clone(), point]);
        assert_eq!((found.distances, found.warnings), (vec![0.0; 3], Vec::new()));
    }
}
