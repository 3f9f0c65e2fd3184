//! Aligns a group of surfaces.
//!
//! First, all members are aligned to the most typical member: the one whose lengths along the principal axes have the
//! least total distance from those of the other members. If another member is nearer to the others in the resulting
//! poses, all members are aligned to that member instead. A member with two nearly equally good poses gets the pose in
//! which it is nearer to the other members. This choice is repeated until no pose changes, because the ends of a nearly
//! symmetric body may differ by so little that only members in the right pose reveal the difference. Finally, each
//! member moves towards all others, or towards [`OTHERS`] of them, at once. No mean surface is computed, since it would
//! have no member's shape. As in a generalised Procrustes analysis (J. Gower, Psychometrika 40, 1975), the distances
//! between the members decrease. These distances are those of nearest points instead of corresponding points. Distances
//! are weighted such that a part that only some members have doesn't rotate these members. The group keeps the position
//! of the typical member.

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor, Stage};

use super::surface::{Density, PoseSurface, View};
use super::warning::{CLOSE, GroupPoseWarning};
use super::{Pose, PoseParams, PoseSearch, differ, icp, nearest};
use crate::geometry::{dot, scale, sub};
use crate::kabsch::kabsch;
use crate::similarity::Similarity;

/// A member moves towards at most this number of other members at once. In a larger group, these members are evenly
/// spaced in the list of members.
pub const OTHERS: usize = 8;
/// Number of rounds in which all members move towards each other.
const ROUNDS: usize = 5;
/// In the rounds in which members move towards each other, the excluded share of the area is [`PoseParams::trimmed`]
/// times this factor. The factor is less than 1, since parts in which members differ most, such as the tips of
/// processes, aren't necessarily outliers. After alignment with this factor, the residual of the landmarks of vertebrae
/// is 1.14 times the residual after a fit to the landmarks themselves. With a factor of 1, this ratio would be 1.25.
const OUTLYING: f64 = 0.25;
/// Largest number of other members used to compare two poses of a member.
const JUDGES: usize = 32;
/// Largest number of sweeps. In a sweep, each member chooses the better of its two best poses if their distances are
/// close (see [`CLOSE`]).
const SWEEPS: usize = 10;
/// A pose is doubtful if the distance in the second-best pose is below this multiple of the distance in the best pose.
pub const DOUBTFUL: f64 = 1.1;
/// A member is treated as an outlier (such as a surface of another kind) if its distance from the others exceeds this
/// multiple of the median over the members.
pub const OF_ANOTHER_KIND: f64 = 3.0;

/// The poses of a group.
#[derive(Debug, Clone, PartialEq)]
pub struct GroupPoses {
    /// For each surface, the map from its own frame to the group's frame.
    pub similarities: Vec<Similarity>,
    /// For each surface, the pose at the template's size, if size explains the differences in the group; see the module
    /// `sizes`. `None` for the template, and for surfaces that are much nearer to the template at their own sizes.
    pub at_one_size: Vec<Option<Similarity>>,
    /// Index of the most typical surface, counted from 0. The group keeps the position of this surface.
    pub template: usize,
    /// For each member, the median of its distances from the others, as defined by [`Pose::distance`], in the group's
    /// unit.
    pub distances: Vec<f64>,
    /// Warnings about members whose poses should be checked.
    pub warnings: Vec<GroupPoseWarning>,
}

/// Aligns a group of surfaces, as described at the top of this module. This takes about 30 ms per surface on two
/// threads, and several times as long if the sizes differ. With `scale`, all members are scaled to the geometric mean
/// of their sizes.
///
/// # Errors
///
/// [`Interrupted`] if the monitor asks to stop.
pub fn group_poses(
    surfaces: &[PoseSurface],
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<GroupPoses, Interrupted> {
    let count = surfaces.len();
    if count < 2 {
        let similarities = vec![Similarity::default(); count];
        let at_one_size = vec![None; count];
        let (distances, warnings) = (vec![0.0; count], Vec::new());
        return Ok(GroupPoses { similarities, at_one_size, template: 0, distances, warnings });
    }
    monitor.begin(Stage::counted("pose", "surfaces"), 0);
    let mut found = Group { surfaces, params, monitor }.aligned(params.scale)?;
    // If size explains the difference from the typical member for at least half of the other members, the group is
    // aligned at one size. The reason is that if bodies of different sizes are compared at their own sizes, wrong poses
    // may be nearly as good as the right ones.
    let explained = found.at_one_size.iter().flatten().count();
    if 2 * explained >= count - 1 && explained > 0 {
        let scaling = PoseParams { scale: true, ..*params };
        let scaled = Group { surfaces, params: &scaling, monitor }.aligned(false)?;
        found = Group { surfaces, params, monitor }.at_own_sizes(scaled)?;
    } else {
        found.at_one_size.fill(None);
    }
    monitor.end();
    Ok(found)
}

pub(super) struct Group<'a> {
    pub(super) surfaces: &'a [PoseSurface],
    pub(super) params: &'a PoseParams,
    pub(super) monitor: &'a dyn Monitor,
}

impl Group<'_> {
    /// Aligns the members to the most typical one and to each other. If `common` is set, the members are then scaled
    /// from the typical member's size to the geometric mean of all sizes.
    fn aligned(&self, common: bool) -> Result<GroupPoses, Interrupted> {
        let Self { surfaces, params, .. } = *self;
        let (group, count) = (self, surfaces.len());
        let mut template = group.typical();
        let mut poses = group.to(template)?;
        let first: Vec<Similarity> = poses.iter().map(|pose| pose.similarity).collect();
        let nearest = group.nearest(&first);
        if nearest != template {
            template = nearest;
            poses = group.to(template)?;
        }
        let (mut motions, doubts) = group.decided(&poses)?;
        if params.search == PoseSearch::Any {
            motions = group.turned(&motions, template)?;
        }
        // Outliers are excluded from the rounds below, so that they don't affect the other members.
        let as_decided = group.distances(&motions);
        let usual = OF_ANOTHER_KIND * median(as_decided.clone());
        let alike: Vec<bool> = as_decided.iter().map(|distance| *distance <= usual).collect();
        // A group of two needs no rounds, since one member has already been aligned to the other.
        for _ in 0..if count > 2 { ROUNDS } else { 0 } {
            motions = group.closer(&motions, &alike)?;
            let back = motions[template].inverse();
            motions.iter_mut().for_each(|motion| *motion = motion.then(&back));
        }
        let at_one_size = group.at_one_size(&motions, template)?;
        if common {
            let common = surfaces.iter().map(|surface| surface.size().ln()).sum::<f64>() / count as f64;
            let factor = common.exp() / surfaces[template].size();
            let centre = surfaces[template].centre;
            let translation = sub(centre, scale(centre, factor));
            let larger = Similarity { scale: factor, translation, ..Similarity::default() };
            motions.iter_mut().for_each(|motion| *motion = motion.then(&larger));
        }
        motions.iter_mut().for_each(|motion| motion.orthogonal = kabsch(&motion.orthogonal, true));
        let distances = group.distances(&motions);
        let median = median(distances.clone());
        let mut far: Vec<usize> = (0..count).filter(|member| distances[*member] > OF_ANOTHER_KIND * median).collect();
        let mut others = doubts;
        if group.searches_near() {
            others.extend(group.elsewhere(template, &poses)?);
        }
        if !params.mirror {
            for warning in group.mirrored(&motions, template)? {
                let doubtful = |of: &GroupPoseWarning| matches!(of, GroupPoseWarning::Doubtful { .. });
                others.retain(|other| other.member() != warning.member() || !(doubtful(other) && doubtful(&warning)));
                others.push(warning);
            }
        }
        // An outlier has no right pose, so other warnings about it are dropped, unless another pose or the mirror image
        // explains its distance from the others.
        others.retain(|warning| warning.explains_distance() || !far.contains(&warning.member()));
        let explained: Vec<usize> =
            others.iter().filter(|of| of.explains_distance()).map(GroupPoseWarning::member).collect();
        far.retain(|member| !explained.contains(member));
        let named = far.iter().map(|&member| GroupPoseWarning::Far { member, distance: distances[member], median });
        let warnings = named.chain(others).collect();
        Ok(GroupPoses { similarities: motions, at_one_size, template, distances, warnings })
    }

    /// Returns whether only poses near the given ones are considered.
    pub(super) fn searches_near(&self) -> bool {
        self.params.search == PoseSearch::Near
    }

    /// Returns the member whose lengths along the principal axes are most typical.
    fn typical(&self) -> usize {
        let described: Vec<[f64; 3]> = self.surfaces.iter().map(|surface| surface.lengths).collect();
        let from_all = |a: &[f64; 3]| described.iter().map(|b| dot(sub(*a, *b), sub(*a, *b)).sqrt()).sum::<f64>();
        let sums: Vec<f64> = described.iter().map(from_all).collect();
        least(&sums)
    }

    /// Aligns all members to the member `template`, and returns their poses.
    fn to(&self, template: usize) -> Result<Vec<Pose>, Interrupted> {
        let one = |member: usize| -> Result<Pose, Interrupted> {
            let found = if member == template {
                Ok(Pose {
                    similarity: Similarity::default(),
                    distance: 0.0,
                    second: f64::INFINITY,
                    other: None,
                    at_one_size: None,
                })
            } else {
                nearest(&self.surfaces[member], &self.surfaces[template], self.params, self.monitor)
            };
            self.monitor.step(1);
            found
        };
        let found: Vec<Result<Pose, Interrupted>> = (0..self.surfaces.len()).into_par_iter().map(one).collect();
        found.into_iter().collect()
    }

    /// Returns a warning for each member that fits the member `template` much better in another pose than in the one
    /// found near the given pose.
    fn elsewhere(&self, template: usize, poses: &[Pose]) -> Result<Vec<GroupPoseWarning>, Interrupted> {
        let params = PoseParams { search: PoseSearch::Any, ..*self.params };
        let one = |(member, near): (usize, &Pose)| -> Result<Option<GroupPoseWarning>, Interrupted> {
            if member == template {
                return Ok(None);
            }
            let best = nearest(&self.surfaces[member], &self.surfaces[template], &params, self.monitor)?;
            let warning = GroupPoseWarning::Elsewhere { member, distance: near.distance, best: best.distance };
            let elsewhere = differ(&best.similarity, &near.similarity);
            Ok((elsewhere && CLOSE * best.distance < near.distance).then_some(warning))
        };
        let found: Vec<Result<Option<GroupPoseWarning>, Interrupted>> = poses.par_iter().enumerate().map(one).collect();
        Ok(found.into_iter().collect::<Result<Vec<_>, _>>()?.into_iter().flatten().collect())
    }

    /// Returns the member with the least distance from the others in the given poses.
    fn nearest(&self, motions: &[Similarity]) -> usize {
        least(&self.distances(motions))
    }

    /// Returns at most `most` members other than `member`, evenly spaced in the list of members.
    fn others(&self, member: usize, most: usize) -> impl Iterator<Item = usize> {
        let count = self.surfaces.len();
        let taken = most.min(count - 1);
        (0..taken).map(move |k| (member + 1 + k * (count - 1) / taken) % count)
    }

    /// Returns at most `most` members other than `member`, spread over the list of members. If two kinds of members
    /// alternate in the list, members of both kinds are returned.
    fn spread(&self, member: usize, most: usize) -> impl Iterator<Item = usize> {
        let count = self.surfaces.len();
        let taken = most.min(count - 1);
        let wide = (count - 1) / taken >= 2;
        (0..taken).map(move |k| (member + 1 + k * (count - 1) / taken + usize::from(wide && k % 2 == 1)) % count)
    }

    pub(super) fn distances(&self, motions: &[Similarity]) -> Vec<f64> {
        let of = |member: usize| self.distance_of(member, &motions[member], motions);
        (0..motions.len()).into_par_iter().map(of).collect()
    }

    /// Returns the median of a member's distances from the other members, for a given pose of the member. The median
    /// isn't affected by outliers among the other members.
    fn distance_of(&self, member: usize, motion: &Similarity, motions: &[Similarity]) -> f64 {
        let view = self.surfaces[member].view(Density::Some);
        let others: Vec<usize> = self.others(member, OTHERS).collect();
        let distance = |other: &usize| {
            let (to, fixed) = (motion.then(&motions[*other].inverse()), self.surfaces[*other].view(Density::Some));
            motions[*other].scale * icp::distance(view, fixed, &to, self.params.trimmed)
        };
        median(others.par_iter().map(distance).collect())
    }

    /// Returns the mean squared distance of a member in a given pose from at most `most` other members in their poses.
    /// No distances are trimmed, because the part in which two ends of a body differ may be as small as the trimmed
    /// share. Distances are capped at twice their median, to limit the effect of surfaces of other kinds.
    pub(super) fn judged(&self, member: usize, motion: &Similarity, motions: &[Similarity], most: usize) -> f64 {
        let moving = &self.surfaces[member];
        let distance = |other: &usize| {
            let (fixed, own) = (&self.surfaces[*other], &motions[*other]);
            own.scale * super::sizes::whole(moving, fixed, Density::Some, &motion.then(&own.inverse()))
        };
        let others: Vec<usize> = self.spread(member, most).collect();
        let found: Vec<f64> = others.par_iter().map(distance).collect();
        let cap = 2.0 * median(found.clone());
        found.iter().map(|distance| distance.min(cap).powi(2)).sum::<f64>() / found.len() as f64
    }

    /// Chooses a pose for each member: of two nearly equally good poses, the one in which the member is nearer to the
    /// others. Also returns a warning for each member whose two poses remain nearly equally good.
    fn decided(&self, poses: &[Pose]) -> Result<(Vec<Similarity>, Vec<GroupPoseWarning>), Interrupted> {
        let close = |pose: &Pose| pose.other.filter(|_| pose.second < CLOSE * pose.distance);
        let mut motions: Vec<Similarity> = poses.iter().map(|pose| pose.similarity).collect();
        let mut others: Vec<Option<Similarity>> = poses.iter().map(close).collect();
        for _ in 0..SWEEPS {
            let mut changed = false;
            for (member, other) in others.iter_mut().enumerate() {
                let Some(other) = other else { continue };
                self.monitor.check()?;
                let [own, turned] =
                    [&motions[member], &*other].map(|motion| self.judged(member, motion, &motions, JUDGES));
                if turned < own {
                    std::mem::swap(&mut motions[member], other);
                    changed = true;
                }
            }
            if !changed {
                break;
            }
        }
        let doubt = |(member, other): (usize, &Option<Similarity>)| {
            let [own, turned] =
                [&motions[member], other.as_ref()?].map(|motion| self.judged(member, motion, &motions, JUDGES).sqrt());
            let near = self.searches_near();
            let doubt = GroupPoseWarning::Doubtful { member, distance: own, second: turned, near };
            (turned < DOUBTFUL * own).then_some(doubt)
        };
        let doubts = others.iter().enumerate().filter_map(doubt).collect();
        Ok((motions, doubts))
    }

    /// Returns a member's pose after one step towards other members.
    pub(super) fn step(&self, member: usize, motion: &Similarity, others: &[(View<'_>, Similarity)]) -> Similarity {
        let rounds = icp::Rounds {
            most: 1,
            rest: 0.0,
            gain: 0.0,
            trimmed: OUTLYING * self.params.trimmed,
            tangential: 0.05,
            scale: self.params.scale,
        };
        icp::step_to_all(self.surfaces[member].view(Density::Some), others, motion, &rounds)
    }

    /// Returns the points and poses of those members for which `chosen` is true, among the members with which `member`
    /// is compared.
    pub(super) fn seen(
        &self,
        member: usize,
        motions: &[Similarity],
        chosen: impl Fn(usize) -> bool,
    ) -> Vec<(View<'_>, Similarity)> {
        let others = self.others(member, OTHERS).filter(|other| chosen(*other));
        others.map(|other| (self.surfaces[other].view(Density::Some), motions[other])).collect()
    }

    /// Returns the poses after each member has moved one step towards the other members for which `alike` is true.
    fn closer(&self, motions: &[Similarity], alike: &[bool]) -> Result<Vec<Similarity>, Interrupted> {
        let one = |member: usize| -> Result<Similarity, Interrupted> {
            self.monitor.check()?;
            Ok(self.step(member, &motions[member], &self.seen(member, motions, |other| alike[other])))
        };
        let found: Vec<Result<Similarity, Interrupted>> = (0..motions.len()).into_par_iter().map(one).collect();
        found.into_iter().collect()
    }
}

/// Returns the index of the smallest number. In case of ties, this is the first one.
fn least(numbers: &[f64]) -> usize {
    (1..numbers.len()).fold(0, |least, i| if numbers[i] < numbers[least] { i } else { least })
}

/// Returns the median of one or more numbers. For an even count, this is the larger of the two middle numbers.
pub(super) fn median(mut numbers: Vec<f64>) -> f64 {
    numbers.sort_by(f64::total_cmp);
    numbers[numbers.len() / 2]
}
