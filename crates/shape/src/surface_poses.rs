//! Whether the surfaces of an aligned group lie on each other, whatever their parameters.
//!
//! An alignment compares surfaces at equal directions. If their maps to the sphere differ, the pose of least distance
//! at equal directions may be a wrong one: of ten vertebrae, aligned so, places that a rigid motion leaves 4 to 7 mm
//! apart were 4 to 65 mm apart. So the surfaces are compared. From [`POINTS`] points on each, evenly spread over its
//! area, to the nearest points of the other,
//!
//! ```text
//! d(A, B)^2 = (mean_p d(p, B)^2 + mean_q d(q, A)^2) / 2,  p on A, q on B
//! ```
//!
//! is measured between each member and the mean. The mean of a group in wrong poses has no member's shape, so members
//! are then compared with the one that is nearest to it: as they lie, and turned about their centres by the 24
//! rotations of a cube whose edges are that one's principal axes, each after a rigid motion by nearest points. A member
//! that a turn brings nearer by more than [`GAIN`] lies in a wrong pose: six of those ten vertebrae gain 36 to 69 %,
//! where hippocampi and generated bodies that are right gain at most 9 %. And if members are farther from the mean at
//! equal directions than their surfaces are, by a factor above [`FAR`], equal directions aren't equal places: the
//! variance is that of the maps. As a mean may have no member's shape, the same is asked of the typical member, with
//! [`FAR_FROM_A_MEMBER`].
//!
//! Cost: some 8 ms a member, and 60 ms one that is named, of two threads. Memory: 2 MB a thread.

use std::fmt;

use ndarray::{ArrayView2, s};
use rayon::prelude::*;
use spharm_harmonics::{Coefficients, Directions, basis_size};
use spharm_monitor::Monitor;
use spharm_surface::generate::icosphere;
use spharm_transform::{Transform, TransformParams};

use crate::error::ShapeError;
use crate::matrix3::{IDENTITY, Matrix3, determinant, product, transposed};
use crate::sampled::{Rigid, Sampled};
use crate::transform::SQRT_4_PI;

/// Points on each surface.
pub const POINTS: usize = 2000;
/// Points and rounds of the first look at a turn.
const FIRST: usize = 50;
const FIRST_ROUNDS: usize = 10;
/// Turns that get a motion by nearest points, at the first look: those that bring the surfaces nearest without one.
const REFINED: usize = 5;
/// Points and rounds of the second look.
const SECOND: usize = 250;
const SECOND_ROUNDS: usize = 40;
/// Turns that are looked at twice, at most: those that gain at the first look.
const LOOKED_AT: usize = 3;
/// Least share of its distance that a turn has to save.
pub const GAIN: f64 = 0.2;
/// Largest ratio of the distance at equal directions to that of the surfaces, from the mean.
pub const FAR: f64 = 2.0;
/// The same from a member, whose surface has more relief than a mean's: surfaces whose coefficients differ by noise
/// alone have 2.0 to 2.3, hippocampi 2.1.
pub const FAR_FROM_A_MEMBER: f64 = 2.5;
/// Vertices of the meshes: 2,562.
const LEVEL: u32 = 4;
/// Accuracy of the vertices, relative to the coefficients.
const ACCURACY: f64 = 1e-6;

/// No motion.
const STAY: Rigid = Rigid { rotation: IDENTITY, translation: [0.0; 3] };

/// Distances of the surfaces of a group from that of its mean.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfacePoses {
    /// Root mean square distance of each member's surface from the mean's, both ways, in their unit.
    pub distances: Vec<f64>,
    /// Reasons to doubt the group.
    pub warnings: Vec<SurfacePoseWarning>,
}

/// A reason to doubt that the members of a group correspond.
#[derive(Debug, Clone, Copy, PartialEq)]
#[non_exhaustive]
pub enum SurfacePoseWarning {
    /// A member whose surface would be much nearer to the others' if it were turned.
    Turned {
        /// The member, counted from 0.
        member: usize,
        /// The member that it is compared with, the nearest to the mean.
        typical: usize,
        /// Distance of their surfaces.
        distance: f64,
        /// The same, if it were turned.
        turned: f64,
        /// The angle of that turn, in degrees.
        angle: f64,
    },
    /// Equal directions aren't equal places.
    PlacesDiffer {
        /// Root mean square distance of the members from the mean, or from the one that is nearest to it, at equal
        /// directions.
        rmsd: f64,
        /// That of their surfaces.
        distance: f64,
        /// Which of the two, in words.
        from: &'static str,
    },
}

impl SurfacePoseWarning {
    /// Returns the text without the member's number.
    #[must_use]
    pub fn of_member(&self) -> String {
        match self {
            Self::Turned { distance, turned, angle, .. } => format!(
                "its surface is {distance:.4} from that of the most typical member, and would be {turned:.4} if it were turned by \
                 {angle:.0} degrees: it may lie in a wrong pose"
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
                "at equal directions the members are {rmsd:.4} from {from}, and their surfaces {distance:.4}: equal directions \
                 aren't equal places, and modes and tests show how the maps to the sphere differ"
            ),
        }
    }
}

/// Compares the surfaces of members in the group's pose, (K, 3) each, with that of their mean. Members are of the
/// mean's degree or of higher ones, of which the degrees up to that are used. Warnings are not of the members in
/// `except`, such as those that are known to be mirror images.
///
/// # Panics
///
/// If a member is of a lower degree than the mean.
///
/// # Errors
///
/// [`ShapeError::Transform`], [`ShapeError::Interrupted`].
pub fn surface_poses(
    members: &[ArrayView2<'_, f64>],
    mean: &Coefficients,
    except: &[usize],
    monitor: &dyn Monitor,
) -> Result<SurfacePoses, ShapeError> {
    let sphere = icosphere(LEVEL);
    let degree = mean.max_degree();
    let params = TransformParams { max_degree: degree, accuracy: ACCURACY, channels: 3 };
    let transform = Transform::new(&Directions::from_vertices(&sphere.vertices)?, &params)?;
    let surface = |coefficients: ArrayView2<'_, f64>| -> Result<Sampled, ShapeError> {
        let rows = transform.synthesis(coefficients)?;
        let vertices = rows.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
        Ok(Sampled::new(&sphere.with_vertices(vertices), POINTS))
    };
    let of_mean = mean.values().view();
    let mean = surface(of_mean)?;
    let row = |member: usize| members[member].slice_move(s![..basis_size(degree), ..]);
    let distance = |member: usize| -> Result<f64, ShapeError> {
        monitor.check()?;
        Ok(surface(row(member))?.distance(&mean, &STAY, 1))
    };
    let distances: Vec<Result<f64, ShapeError>> = (0..members.len()).into_par_iter().map(distance).collect();
    let distances = distances.into_iter().collect::<Result<Vec<f64>, _>>()?;
    // If many poses are wrong, the mean's shape resembles no member's, so members are compared with the nearest to it.
    let candidates = (0..distances.len()).filter(|member| !except.contains(member));
    let Some(typical) = candidates.min_by(|a, b| distances[*a].total_cmp(&distances[*b])) else {
        return Ok(SurfacePoses { distances, warnings: Vec::new() });
    };
    let of_typical = surface(row(typical))?;
    let turns = turns(&of_typical.axes());
    let alike: Vec<usize> =
        (0..members.len()).filter(|member| *member != typical && !except.contains(member)).collect();
    let look = |&member: &usize| -> Result<Look, ShapeError> {
        monitor.check()?;
        let surface = surface(row(member))?;
        let turned = better_turn(&surface, &of_typical, &turns);
        let warning =
            |(distance, turned, angle)| SurfacePoseWarning::Turned { member, typical, distance, turned, angle };
        let distance = surface.distance(&of_typical, &STAY, 1);
        Ok(Look { turned: turned.map(warning), rmsd: rmsd(row(member), row(typical)), distance })
    };
    let looks: Vec<Result<Look, ShapeError>> = alike.par_iter().map(look).collect();
    let looks = looks.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut warnings: Vec<SurfacePoseWarning> = looks.iter().filter_map(|look| look.turned).collect();
    // Mirror images leave the mean no member's shape, as wrong poses do.
    let from_mean = except.is_empty().then(|| {
        let rmsd = (0..members.len()).map(|member| rmsd(row(member), of_mean));
        (root_mean_square(rmsd), root_mean_square(distances.iter().copied()), "their mean", FAR)
    });
    let rmsd = root_mean_square(looks.iter().map(|look| look.rmsd));
    let distance = root_mean_square(looks.iter().map(|look| look.distance));
    let apart = [from_mean, Some((rmsd, distance, "the most typical one", FAR_FROM_A_MEMBER))];
    let places = apart.into_iter().flatten().find(|(rmsd, distance, _, far)| *rmsd > far * distance);
    warnings.extend(places.map(|(rmsd, distance, from, _)| SurfacePoseWarning::PlacesDiffer { rmsd, distance, from }));
    Ok(SurfacePoses { distances, warnings })
}

/// What is found of a member beside the typical one.
struct Look {
    turned: Option<SurfacePoseWarning>,
    /// At equal directions.
    rmsd: f64,
    /// Of the surfaces.
    distance: f64,
}

/// Root mean square distance of two surfaces at equal directions.
fn rmsd(a: ArrayView2<'_, f64>, b: ArrayView2<'_, f64>) -> f64 {
    (&a - &b).iter().map(|v| v * v).sum::<f64>().sqrt() / SQRT_4_PI
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len().max(1) as f64;
    (values.map(|value| value * value).sum::<f64>() / count).sqrt()
}

/// Distance of a member from the typical one, that after the best of the turns, and the angle of that, if it gains
/// enough. Both are after a rigid motion by nearest points, so that what counts is the pose at large.
fn better_turn(member: &Sampled, typical: &Sampled, turns: &[Matrix3]) -> Option<(f64, f64, f64)> {
    let first_look = |start: Rigid| {
        let motion = member.refined(typical, start, POINTS / FIRST, FIRST_ROUNDS);
        (member.distance(typical, &motion, POINTS / FIRST), motion)
    };
    let at_most = (1.0 - 0.5 * GAIN) * first_look(STAY).0;
    let as_turned = |turn| {
        let motion = member.turned_to(typical, turn);
        (member.distance(typical, &motion, POINTS / FIRST), motion, turn)
    };
    let mut nearest: Vec<(f64, Rigid, &Matrix3)> = turns.iter().map(as_turned).collect();
    nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
    let looks = nearest.into_iter().take(REFINED).map(|(_, motion, turn)| (first_look(motion), turn));
    let mut gains: Vec<((f64, Rigid), &Matrix3)> = looks.filter(|((distance, _), _)| *distance < at_most).collect();
    if gains.is_empty() {
        return None;
    }
    gains.sort_by(|a, b| a.0.0.total_cmp(&b.0.0));
    let second_look = |start: Rigid| {
        let motion = member.refined(typical, start, POINTS / SECOND, SECOND_ROUNDS);
        member.distance(typical, &motion, 1)
    };
    let distance = second_look(STAY);
    let best = gains.iter().take(LOOKED_AT).map(|((_, motion), turn)| (second_look(*motion), *turn));
    let (turned, turn) = best.min_by(|a, b| a.0.total_cmp(&b.0))?;
    (turned < (1.0 - GAIN) * distance).then(|| (distance, turned, angle(turn)))
}

/// The rotations of a cube with these axes, but for the identity.
fn turns(axes: &Matrix3) -> Vec<Matrix3> {
    let mut found = Vec::new();
    for order in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
        for signs in 0..8 {
            let sign = |row: usize| if signs >> row & 1 == 1 { -1.0 } else { 1.0 };
            let of_cube: Matrix3 =
                std::array::from_fn(|i| std::array::from_fn(|j| if order[i] == j { sign(i) } else { 0.0 }));
            let is_identity = signs == 0 && order == [0, 1, 2];
            if determinant(&of_cube) > 0.0 && !is_identity {
                found.push(product(&transposed(axes), &product(&of_cube, axes)));
            }
        }
    }
    found
}

/// The angle of a rotation, degrees.
fn angle(turn: &Matrix3) -> f64 {
    (0.5 * (turn[0][0] + turn[1][1] + turn[2][2] - 1.0)).clamp(-1.0, 1.0).acos().to_degrees()
}

#[cfg(test)]
mod tests {
    use ndarray::Array2;
    use spharm_monitor::Silent;

    use super::*;
    use crate::Rotation;
    use crate::samples::blob;
    use crate::{Similarity, Transform as Pose, mean};

    /// Lumps that differ a little, each in a pose.
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
        // About each axis of the first-order ellipsoid in space and in the parameters, as an alignment may end.
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
            assert!(found.warnings[0].to_string().starts_with("member 5: its surface is "), "{found:?}");
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

    #[test]
    fn the_turns_are_those_of_a_cube() {
        let found = turns(&IDENTITY);
        assert_eq!(found.len(), 23);
        let mut angles: Vec<f64> = found.iter().map(|turn| angle(turn).round()).collect();
        angles.sort_by(f64::total_cmp);
        let count = |degrees: f64| angles.iter().filter(|angle| **angle == degrees).count();
        assert_eq!((count(90.0), count(120.0), count(180.0)), (6, 8, 9));
    }
}
