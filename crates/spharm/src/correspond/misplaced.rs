//! Finds landmarks of members that aren't at the places of the same landmarks on the other members.

use rayon::prelude::*;
use spharm_monitor::number;
use spharm_surface::Similarity;
use spharm_surface::geometry::{Vec3, bounds, dot, sub};
use spharm_surface::nearest::TriangleTree;

use super::Group;
use super::together::{mean, mesh_of};
use crate::Error;

/// Minimum distance of a misplaced landmark from its usual place, relative to the median distance over the members, of
/// the same landmark and of a typical landmark.
const UNUSUAL: f64 = 5.0;
/// Minimum distance of a misplaced landmark from its usual place, as a fraction of the mean surface's extent.
const FAR: f64 = 0.02;
/// Largest distance of a landmark from its member's surface at which it is compared, as a fraction of the mean
/// surface's extent.
const OFF: f64 = 0.05;
/// Largest ratio of the distances of two landmarks after and before their names are exchanged, if they are swapped.
const MENDED: f64 = 0.3;
/// Minimum number of members: median distances over fewer members are often much too small.
const LEAST: usize = 4;
/// Maximum number of landmarks that a message lists.
const LISTED: usize = 5;

/// Warning that landmarks of a member aren't at their usual places, the median places on all members.
#[derive(Debug, Clone, PartialEq)]
pub struct MisplacedLandmarks {
    /// Index of the member, counted from 0.
    pub member: usize,
    /// Pairs of landmarks that seem to be swapped: each is near the usual place of the other.
    pub swapped: Vec<[usize; 2]>,
    /// Further landmarks that are far from their usual places.
    pub far: Vec<usize>,
    /// Largest distance of these landmarks from their usual places, in the group's unit.
    pub distance: f64,
    /// Median over the members of the distance of the same landmark from its usual place.
    pub usual: f64,
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
        if !self.far.is_empty() {
            let mut names: Vec<String> = self.far.iter().take(LISTED).map(|landmark| name(*landmark)).collect();
            if self.far.len() > LISTED {
                names.push(format!("{} more", self.far.len() - LISTED));
            }
            found.push(format!("landmarks far from their positions on the other members: {}", names.join(", ")));
        }
        format!(
            "{}; the largest distance is {} (median over members: {}); check the names and positions of the landmarks",
            found.join("; "),
            number(self.distance),
            number(self.usual)
        )
    }

    /// Adds a warning with swaps for the same member. Landmarks that the swaps explain are no longer listed as far.
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

/// Comparable positions of all members' landmarks, and the usual places of the landmarks.
struct Compared {
    positions: Vec<Positions>,
    places: Vec<Option<Vec3>>,
}

impl Group {
    /// Compares the landmarks of each member with the same landmarks of the other members, at corresponding points.
    /// `landmarks` has the p landmarks of each member, in the member's own frame. Returns a warning for each member
    /// with landmarks that are much farther from their usual places than on most members. Landmarks far from their
    /// surfaces aren't compared, and a group of fewer than four members gives no warnings.
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
        if self.places.len() < LEAST {
            return Ok(Vec::new());
        }
        let mean = mean(&self.places);
        let (low, high) = bounds(mean.iter().copied());
        let extent = length(sub(high, low));
        let positions = landmarks.par_iter().enumerate().map(|(member, own)| self.on_mean(member, own, &mean, extent));
        let positions = positions
            .collect::<Option<Vec<_>>>()
            .ok_or_else(|| refused("finite coordinates", "NaN or infinity".to_owned()))?;
        let far = FAR * extent;
        let mut found = Compared::new(positions, count).misplaced(far);
        // Landmarks that guide take the corresponding points along, so swapped landmarks of the template are only
        // visible in space.
        for more in Compared::new(self.in_space(landmarks), count).misplaced(far) {
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
        Ok(found)
    }

    /// Returns the positions of the members' landmarks in the group's frame.
    fn in_space(&self, landmarks: &[Vec<Vec3>]) -> Vec<Positions> {
        let of = |(own, similarity): (&Vec<Vec3>, &Similarity)| -> Positions {
            own.iter().map(|landmark| Some(similarity.apply(*landmark))).collect()
        };
        landmarks.iter().zip(&self.similarities).map(of).collect()
    }

    /// Returns the positions on the mean surface that correspond to a member's landmarks; `None` if a landmark isn't
    /// finite. A position is `None` if it is a guess: the landmark is far from the surface, compared with the surface's
    /// `extent`, or the member has no counterpart of the template there.
    fn on_mean(&self, member: usize, landmarks: &[Vec3], mean: &[Vec3], extent: f64) -> Option<Positions> {
        let faces = &self.template.sphere.faces;
        let tree = TriangleTree::new(&mesh_of(self.places[member].clone(), faces));
        let position = |landmark: &Vec3| {
            let found = tree.nearest(self.similarities[member].apply(*landmark))?;
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

    /// Returns the distance of a member's landmark `from` the usual place of the landmark `to`.
    fn distance(&self, member: usize, from: usize, to: usize) -> Option<f64> {
        Some(length(sub(self.positions[member][from]?, self.places[to]?)))
    }

    /// Returns warnings for landmarks that are farther than `far`, and much farther than usual, from their places.
    fn misplaced(&self, far: f64) -> Vec<MisplacedLandmarks> {
        let of_landmark = |k: usize| median((0..self.positions.len()).filter_map(|member| self.distance(member, k, k)));
        let usual: Vec<f64> = (0..self.places.len()).map(|k| of_landmark(k).unwrap_or(f64::INFINITY)).collect();
        // The median of a single landmark may be small by chance if there are few members.
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
            Some(MisplacedLandmarks { member, swapped, far: alone, distance, usual: usual[farthest] })
        };
        (0..self.positions.len()).filter_map(of_member).collect()
    }
}

fn length(v: Vec3) -> f64 {
    dot(v, v).sqrt()
}

/// Returns the median, the upper one of an even number of values; `None` without values.
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
        assert!(text.starts_with("the landmarks L0 and L3 seem to be swapped; the largest distance is 10.0"), "{text}");
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
        let swaps = MisplacedLandmarks { member: 1, swapped: vec![[0, 3]], far: vec![5], distance: 4.0, usual: 0.1 };
        let mut found =
            MisplacedLandmarks { member: 1, swapped: vec![], far: vec![2, 3, 5], distance: 6.0, usual: 0.2 };
        found.add_swaps(swaps.clone());
        let both = MisplacedLandmarks { far: vec![2, 5], distance: 6.0, usual: 0.2, ..swaps.clone() };
        assert_eq!(found, both);
        found = MisplacedLandmarks { swapped: vec![], far: vec![0], distance: 3.0, ..both };
        found.add_swaps(swaps.clone());
        assert_eq!(found, swaps);
    }

    #[test]
    fn landmarks_of_no_member_have_no_place() {
        let given = vec![vec![None]; 3];
        assert!(Compared::new(given, 1).misplaced(0.2).is_empty());
    }
}
