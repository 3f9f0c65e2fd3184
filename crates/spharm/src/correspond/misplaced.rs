//! Finds landmarks of members that aren't at the same places as the corresponding landmarks of the other members.

mod few;
mod left_out;

use rayon::prelude::*;
use spharm_monitor::number;
use spharm_surface::Similarity;
use spharm_surface::geometry::{Vec3, bounds, diagonal, dot, sub};
use spharm_surface::nearest::TriangleTree;

use super::Group;
use super::together::{mean, mesh_of, motion};
use crate::Error;

/// Minimum distance of a misplaced landmark from its usual place, as a multiple of a median distance over the members.
/// The median is that of the same landmark or that of a typical landmark, whichever is larger.
const UNUSUAL: f64 = 5.0;
/// Minimum distance of a misplaced landmark from its usual place, as a fraction of the mean surface's extent.
const FAR: f64 = 0.02;
/// Landmarks aren't compared if they are farther from their member's surface than this fraction of the mean surface's
/// extent.
const OFF: f64 = 0.05;
/// Two landmarks are treated as swapped if exchanging their names reduces their distances from their usual places to
/// this fraction or less.
const MENDED: f64 = 0.3;
/// Minimum number of members for comparing landmarks with their usual places. With fewer members, median distances are
/// often much too small.
const LEAST: usize = 4;
/// Minimum numbers for a wrong pose to be considered: of a member's landmarks, and of those among them that are at
/// unusual places. With fewer landmarks, an exchange of names may look like a rotation.
const OF_POSE: [usize; 2] = [4, 3];
/// Maximum number of landmarks that a message lists.
const LISTED: usize = 5;

/// Probable cause of landmarks at unusual places.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum LandmarkCause {
    /// Wrong names or positions of the member's landmarks.
    Landmarks,
    /// Wrong names of landmarks of this or another member: the group is too small to tell which.
    SomeMember,
    /// A wrong pose of the member, or landmarks in another coordinate system: another pose brings its landmarks to
    /// their usual places.
    Pose,
    /// Wrong names or positions of guiding landmarks, which are far from their places in a registration without them.
    Guiding,
}

/// Warning that a member's landmarks are far from their usual places: the median places over all members.
#[derive(Debug, Clone, PartialEq)]
pub struct MisplacedLandmarks {
    /// Index of the member, counted from 0.
    pub member: usize,
    /// Pairs of landmarks that seem to be swapped: each is near the usual place of the other.
    pub swapped: Vec<[usize; 2]>,
    /// Landmarks, other than the swapped ones, that are far from their usual places.
    pub far: Vec<usize>,
    /// Largest distance of these landmarks from their usual places, in the group's unit. In a group of fewer than four
    /// members: largest distance between the members' positions of the same landmark.
    pub distance: f64,
    /// Median over the members of the distance of the same landmark from its usual place. For swaps in a group of fewer
    /// than four members: the largest distance after the exchange. For a wrong pose: the largest distance in the pose
    /// computed from the landmarks. For guiding landmarks: median over all members and landmarks.
    pub usual: f64,
    /// Probable cause.
    pub cause: LandmarkCause,
}

impl MisplacedLandmarks {
    /// Returns the warning's message without the member's number. `name` returns the name of the landmark with a given
    /// index.
    #[must_use]
    pub fn of_member(&self, name: impl Fn(usize) -> String) -> String {
        let mut found: Vec<String> = Vec::new();
        for [a, b] in self.swapped.iter().take(LISTED) {
            found.push(format!("the landmarks {} and {} seem to be swapped", name(*a), name(*b)));
        }
        let mut far: Vec<String> = self.far.iter().copied().take(LISTED).map(&name).collect();
        if self.far.len() > LISTED {
            far.push(format!("{} more", self.far.len() - LISTED));
        }
        let (far, distance, usual) = (far.join(", "), number(self.distance), number(self.usual));
        if !far.is_empty() {
            found.push(format!("landmarks far from their positions on the other members: {far}"));
        }
        let found = found.join("; ");
        match self.cause {
            LandmarkCause::Landmarks => format!(
                "{found}; the largest distance from a landmark's position on the other members is {distance} (median over \
                 members: {usual}); check the names and positions of the landmarks"
            ),
            LandmarkCause::SomeMember => format!(
                "{found}, on this surface or on another; the largest distance between the members' landmarks is \
                 {distance}, but only {usual} if the names are swapped back; check the names of the landmarks"
            ),
            LandmarkCause::Pose => format!(
                "the pose is probably wrong, or the landmarks are in another coordinate system (LPS, RAS): the \
                 landmarks are up to {distance} away from their positions on the other members, but at most {usual} in \
                 the pose computed from the landmarks; check the coordinate systems, or guide the registration by the \
                 landmarks (--guide, in Python guide=True)"
            ),
            LandmarkCause::Guiding => format!(
                "landmarks far from the positions predicted by the other landmarks: {far}; the largest distance is \
                 {distance} (median: {usual}); check the names and positions of the landmarks on this surface and on \
                 the template"
            ),
        }
    }

    /// Merges `more`, a warning about swapped landmarks of the same member, into this warning. Swapped landmarks are
    /// removed from the list `far`.
    fn add_swaps(&mut self, more: Self) {
        let named = |k: &usize| more.far.contains(k) || more.swapped.iter().flatten().any(|swapped| swapped == k);
        let rest = self.far.iter().copied().filter(|k| !named(k));
        let mut far: Vec<usize> = more.far.iter().copied().chain(rest).collect();
        far.sort_unstable();
        let larger = if self.distance > more.distance { &*self } else { &more };
        let (distance, usual) = (larger.distance, larger.usual);
        *self = Self { far, distance, usual, ..more };
    }
}

/// Comparable positions of a member's landmarks; `None` if unknown.
type Positions = Vec<Option<Vec3>>;

/// Positions of all members' landmarks in a common frame or on the mean surface, and their medians, the usual places.
struct Compared {
    positions: Vec<Positions>,
    places: Vec<Option<Vec3>>,
}

impl Group {
    /// Compares the landmarks of each member with the same landmarks of the other members, at corresponding points.
    /// `landmarks` has the p landmarks of each member, in the member's own frame. Returns a warning for each member
    /// with landmarks that are much farther from their usual places than on most members. Landmarks far from their
    /// surfaces aren't compared. In a group of fewer than four members, returns at most one warning about swaps, which
    /// may concern any member. If there are no other warnings, returns warnings about guiding landmarks that the other
    /// guiding landmarks contradict.
    ///
    /// # Errors
    ///
    /// [`Error::Setting`] if there aren't p landmarks for each member, or a landmark isn't finite.
    pub fn misplaced_landmarks(&self, landmarks: &[Vec<Vec3>]) -> Result<Vec<MisplacedLandmarks>, Error> {
        let refused = |expected, found: String| Error::Setting { what: "comparing landmarks", expected, found };
        let count = landmarks.first().map_or(0, Vec::len);
        if landmarks.len() != self.places.len() || landmarks.iter().any(|own| own.len() != count) {
            let found = landmarks.iter().map(Vec::len).collect::<Vec<_>>();
            return Err(refused("the same number of landmarks for each member", format!("{found:?}")));
        }
        let not_finite = || refused("finite coordinates", "NaN or infinity".to_owned());
        let in_space = self.in_space(landmarks);
        if !in_space.iter().flatten().flatten().all(|value| value.is_finite()) {
            return Err(not_finite());
        }
        let mean = mean(&self.places);
        let extent = diagonal(bounds(mean.iter().copied()));
        let far = FAR * extent;
        let mut found: Vec<MisplacedLandmarks> = if self.places.len() < LEAST {
            few::swapped(&in_space, far).into_iter().collect()
        } else {
            let of = |(member, own): (usize, &Vec<Vec3>)| self.on_mean(member, own, &mean, extent);
            let positions = in_space.par_iter().enumerate().map(of).collect::<Option<Vec<_>>>();
            self.at_unusual_places(positions.ok_or_else(not_finite)?, in_space, far)
        };
        if found.is_empty()
            && let Some(guide) = &self.report.guide
        {
            found = left_out::contradicted(&guide.by_member, extent);
        }
        Ok(found)
    }

    /// Compares the members' landmarks in a group of at least four members, both by the landmarks' `positions` on the
    /// mean surface and by their positions `in_space`, in the group's frame.
    fn at_unusual_places(
        &self,
        positions: Vec<Positions>,
        in_space: Vec<Vec<Vec3>>,
        far: f64,
    ) -> Vec<MisplacedLandmarks> {
        let count = positions.first().map_or(0, Vec::len);
        let known = in_space.into_iter().map(|own| own.into_iter().map(Some).collect::<Positions>());
        let in_space = Compared::new(known.collect(), count);
        let mut found = Compared::new(positions, count).misplaced(far);
        // Corresponding points follow the guiding landmarks, so only positions in space show swapped landmarks of the
        // template.
        for more in in_space.misplaced(far) {
            if more.swapped.is_empty() {
                continue;
            }
            match found.iter_mut().find(|of| of.member == more.member) {
                Some(of) if of.swapped.is_empty() => of.add_swaps(more),
                Some(_) => {}
                None => found.push(more),
            }
        }
        found.sort_by_key(|of| of.member);
        // In a guided group, poses already agree with the landmarks, so a wrong pose isn't considered.
        if self.report.guide.is_none() {
            for of in &mut found {
                if let Some(pose) = in_space.of_pose(of) {
                    *of = pose;
                }
            }
        }
        found
    }

    /// Returns the positions of the members' landmarks in the group's frame.
    fn in_space(&self, landmarks: &[Vec<Vec3>]) -> Vec<Vec<Vec3>> {
        let of = |(own, similarity): (&Vec<Vec3>, &Similarity)| -> Vec<Vec3> {
            own.iter().map(|landmark| similarity.apply(*landmark)).collect()
        };
        landmarks.iter().zip(&self.similarities).map(of).collect()
    }

    /// Returns the positions on the mean surface that correspond to a member's landmarks in the group's frame; `None`
    /// if a landmark isn't finite. A position is `None` if it is a guess: the landmark is far from the surface,
    /// compared with the surface's `extent`, or the member has no counterpart of the template there.
    fn on_mean(&self, member: usize, landmarks: &[Vec3], mean: &[Vec3], extent: f64) -> Option<Positions> {
        let faces = &self.template.sphere.faces;
        let tree = TriangleTree::new(&mesh_of(self.places[member].clone(), faces));
        let position = |landmark: &Vec3| {
            let found = tree.nearest(*landmark)?;
            let corners = faces[found.triangle as usize].map(|v| v as usize);
            let place: Vec3 = std::array::from_fn(|k| (0..3).map(|i| found.barycentric[i] * mean[corners[i]][k]).sum());
            let known = found.distance <= OFF * extent && corners.iter().all(|v| self.reached[member][*v]);
            Some(known.then_some(place))
        };
        landmarks.iter().map(position).collect()
    }
}

impl Compared {
    fn new(positions: Vec<Positions>, count: usize) -> Self {
        let place = |landmark: usize| {
            let of = |axis: usize| median(positions.iter().filter_map(|own| Some(own[landmark]?[axis])));
            Some([of(0)?, of(1)?, of(2)?])
        };
        Self { places: (0..count).map(place).collect(), positions }
    }

    /// Returns the distance between a member's landmark number `from` and the usual place of landmark number `to`.
    fn distance(&self, member: usize, from: usize, to: usize) -> Option<f64> {
        Some(length(sub(self.positions[member][from]?, self.places[to]?)))
    }

    /// Returns warnings for landmarks farther than `far`, and much farther than is usual, from their usual places.
    fn misplaced(&self, far: f64) -> Vec<MisplacedLandmarks> {
        let of_landmark = |k: usize| median((0..self.positions.len()).filter_map(|member| self.distance(member, k, k)));
        let usual: Vec<f64> = (0..self.places.len()).map(|k| of_landmark(k).unwrap_or(f64::INFINITY)).collect();
        // If there are few members, the median distance of a single landmark may be small by chance. Therefore the
        // usual distance of a landmark is at least the median over all landmarks.
        let typical = median(usual.iter().copied().filter(|u| u.is_finite())).unwrap_or(0.0);
        let least = |k: usize| far.max(UNUSUAL * usual[k].max(typical));
        let of_member = |member: usize| -> Option<MisplacedLandmarks> {
            let off = |k: usize| self.distance(member, k, k).filter(|off| *off > least(k));
            let mut left: Vec<(usize, f64)> = (0..usual.len()).filter_map(|k| Some((k, off(k)?))).collect();
            let (farthest, distance) = left.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1))?;
            let (mut swapped, mut alone) = (Vec::new(), Vec::new());
            while let Some((k, own)) = (!left.is_empty()).then(|| left.remove(0)) {
                let mended = |(l, other): &(usize, f64)| {
                    let exchanged = self.distance(member, k, *l)? + self.distance(member, *l, k)?;
                    Some(exchanged / (own + other))
                };
                let ratios = left.iter().enumerate().filter_map(|(index, with)| Some((index, mended(with)?)));
                match ratios.min_by(|a, b| a.1.total_cmp(&b.1)).filter(|(_, ratio)| *ratio <= MENDED) {
                    Some((index, _)) => swapped.push([k, left.remove(index).0]),
                    None => alone.push(k),
                }
            }
            let (usual, cause) = (usual[farthest], LandmarkCause::Landmarks);
            Some(MisplacedLandmarks { member, swapped, far: alone, distance, usual, cause })
        };
        (0..self.positions.len()).filter_map(of_member).collect()
    }

    /// Returns a warning about a member's pose if another pose brings the member's landmarks near their usual places
    /// without an exchange of names.
    fn of_pose(&self, found: &MisplacedLandmarks) -> Option<MisplacedLandmarks> {
        let pairs = self.positions[found.member].iter().copied().zip(self.places.iter().copied());
        let (own, places): (Vec<Vec3>, Vec<Vec3>) = pairs.filter_map(|(own, place)| Some((own?, place?))).unzip();
        let [least, unusual] = OF_POSE;
        if own.len() < least || 2 * found.swapped.len() + found.far.len() < unusual {
            return None;
        }
        let posed = motion(&own, &places, None, true, false);
        let before: Vec<f64> = own.iter().zip(&places).map(|(own, place)| length(sub(*own, *place))).collect();
        let after: Vec<f64> =
            own.iter().zip(&places).map(|(own, place)| length(sub(posed.apply(*own), *place))).collect();
        let squares = |distances: &[f64]| distances.iter().map(|distance| distance * distance).sum::<f64>();
        let largest = |distances: &[f64]| distances.iter().copied().fold(0.0, f64::max);
        (squares(&after) <= MENDED * MENDED * squares(&before)).then(|| MisplacedLandmarks {
            member: found.member,
            swapped: Vec::new(),
            far: Vec::new(),
            distance: largest(&before),
            usual: largest(&after),
            cause: LandmarkCause::Pose,
        })
    }
}

fn length(v: Vec3) -> f64 {
    dot(v, v).sqrt()
}

/// Returns the median, or the upper of the two middle values of an even number of values; `None` without values.
fn median(values: impl Iterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.collect();
    values.sort_unstable_by(f64::total_cmp);
    values.get(values.len() / 2).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the positions of four landmarks on five members, which differ a little between members.
    fn positions() -> Vec<Positions> {
        let places = [[0.0, 0.0, 0.0], [10.0, 0.0, 0.0], [0.0, 10.0, 0.0], [0.0, 0.0, 10.0]];
        let of = |member: usize| places.map(|[x, y, z]| Some([x + 0.01 * member as f64, y, z])).to_vec();
        (0..5).map(of).collect()
    }

    #[test]
    fn swapped_and_misplaced_landmarks_are_named() {
        let mut given = positions();
        assert!(Compared::new(given.clone(), 4).misplaced(0.2).is_empty());
        given[1].swap(0, 3);
        given[4][2] = Some([0.0, 5.0, 0.0]);
        given[3][1] = None;
        let found = Compared::new(given, 4).misplaced(0.2);
        let [first, second] = &found[..] else { panic!("{found:?}") };
        assert!(first.member == 1 && first.swapped == [[0, 3]] && first.far.is_empty(), "{first:?}");
        assert!(second.member == 4 && second.swapped.is_empty() && second.far == [2], "{second:?}");
        let text = first.of_member(|landmark| format!("L{landmark}"));
        assert!(text.contains("L0 and L3 seem to be swapped; ") && text.contains("is 10.00 ("), "{text}");
        let text = second.of_member(|landmark| format!("L{landmark}"));
        assert!(text.starts_with("landmarks far from their positions on the other members: L2; "), "{text}");
    }

    #[test]
    fn distances_that_other_landmarks_have_are_no_alarm() {
        let of = |member: usize| [0.0, 10.0, 20.0, 30.0].map(|x| Some([x + 0.5 * member as f64, 0.0, 0.0])).to_vec();
        let mut given: Vec<Positions> = (0..4).map(of).collect();
        for (own, x) in given.iter_mut().zip([30.0, 30.0, 30.0, 31.5]) {
            own[3] = Some([x, 0.0, 0.0]);
        }
        assert!(Compared::new(given.clone(), 4).misplaced(0.2).is_empty());
        given[3][3] = Some([36.0, 0.0, 0.0]);
        let found = Compared::new(given, 4).misplaced(0.2);
        assert!(found.len() == 1 && found[0].member == 3 && found[0].far == [3], "{found:?}");
    }

    #[test]
    fn misplaced_landmarks_are_named_beside_swaps_in_space() {
        let cause = LandmarkCause::Landmarks;
        let swaps =
            MisplacedLandmarks { member: 1, swapped: vec![[0, 3]], far: vec![5], distance: 4.0, usual: 0.1, cause };
        let mut found =
            MisplacedLandmarks { member: 1, swapped: vec![], far: vec![2, 3, 5], distance: 6.0, usual: 0.2, cause };
        found.add_swaps(swaps.clone());
        let both = MisplacedLandmarks { far: vec![2, 5], distance: 6.0, usual: 0.2, ..swaps.clone() };
        assert_eq!(found, both);
        found = MisplacedLandmarks { swapped: vec![], far: vec![0], distance: 3.0, ..both };
        found.add_swaps(swaps.clone());
        assert_eq!(found, swaps);
    }

    #[test]
    fn a_wrong_pose_is_told_from_swapped_names() {
        let places = [[20.0, 1.0, 0.0], [-19.0, 2.0, 1.0], [3.0, 9.0, 0.0], [1.0, -8.0, 2.0], [0.0, 1.0, 6.0]];
        let of = |member: usize| places.map(|[x, y, z]| Some([x + 0.1 * member as f64, y, z])).to_vec();
        let mut given: Vec<Positions> = (0..5).map(of).collect();
        // A half turn about the third axis, at 9/10 of the size.
        given[3] = places.map(|[x, y, z]| Some([-0.9 * x, 0.5 - 0.9 * y, 0.9 * z])).to_vec();
        given[1].swap(0, 3);
        let compared = Compared::new(given, 5);
        let found = compared.misplaced(0.2);
        let [named, turned] = &found[..] else { panic!("{found:?}") };
        assert!(named.swapped == [[0, 3]] && compared.of_pose(named).is_none(), "{named:?}");
        assert!(!turned.swapped.is_empty(), "{turned:?}");
        let turned = compared.of_pose(turned).expect("another pose");
        assert!(turned.member == 3 && turned.cause == LandmarkCause::Pose && turned.swapped.is_empty(), "{turned:?}");
        assert!(turned.distance > 35.0 && turned.usual < 1.0, "{turned:?}");
        let text = turned.of_member(|landmark| format!("L{landmark}"));
        assert!(text.starts_with("the pose is probably wrong") && text.contains("--guide"), "{text}");
        // The conversion from LPS to RAS is also a half turn about the third axis.
        assert!(text.contains("in another coordinate system (LPS, RAS)"), "{text}");
    }

    #[test]
    fn landmarks_of_no_member_have_no_place() {
        let given = vec![vec![None]; 3];
        assert!(Compared::new(given, 1).misplaced(0.2).is_empty());
    }
}
