//! Guides a group's registration by landmarks, and measures the error at landmarks that are left out.

use rayon::prelude::*;
use serde::Serialize;
use spharm_monitor::Monitor;
use spharm_register::{Guide, RegisterParams, Registered, Subject, Template, register};
use spharm_surface::geometry::{Vec3, cross, dot, sub};
use spharm_surface::io::landmarks::FarGuide;
use spharm_surface::pose::{PoseParams, PoseSurface, at_one_size, differ, distance as distance_of, improved};
use spharm_surface::{Mesh, Place, Similarity};

use super::together::motion;
use crate::Error;

/// Minimum number of landmarks that determine a surface's rotation.
const TURN: usize = 3;
/// Number of parts into which landmarks are divided, so that each part can be left out once.
const PARTS: usize = 5;

/// Corresponding points of all members, known before the registration.
#[derive(Debug, Clone, PartialEq)]
pub struct GuideLandmarks {
    /// The p landmarks of each member, in the member's own frame.
    pub members: Vec<Vec<Vec3>>,
    /// The p landmarks of the given template, in the template's frame; `None` if no template is given.
    pub template: Option<Vec<Vec3>>,
}

/// Distances between guiding landmarks and their corresponding points, averaged over the members, in the group's unit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct GuideReport {
    /// Distance of each of the p landmarks from its corresponding point, in the finished group.
    pub guided: Vec<f64>,
    /// Distance of each of the p landmarks from its corresponding point when the landmark is left out of the last
    /// registration. This distance estimates the error of the correspondence away from landmarks.
    pub left_out: Vec<f64>,
    /// The distances of the left-out landmarks for each member, before averaging.
    #[serde(skip)]
    pub by_member: Vec<Vec<f64>>,
}

impl GuideLandmarks {
    pub(super) fn check(&self, count: usize, template: bool) -> Result<(), Error> {
        let refused = |expected, found: String| Err(Error::Setting { what: "guiding by landmarks", expected, found });
        if self.members.len() != count {
            let found = format!("{} sets of landmarks for {count} surfaces", self.members.len());
            return refused("landmarks for each of the surfaces", found);
        }
        let all = || self.members.iter().chain(&self.template);
        let p = self.members.first().map_or(0, Vec::len);
        if p == 0 {
            return refused("at least 1 landmark", "none".to_owned());
        }
        if let Some(other) = all().find(|points| points.len() != p) {
            return refused("the same number of landmarks for each surface", format!("{p} and {}", other.len()));
        }
        if let Some(point) = all().flatten().find(|point| !point.iter().all(|value| value.is_finite())) {
            return refused("finite coordinates", format!("{point:?}"));
        }
        match (&self.template, template) {
            (None, true) => refused("landmarks for the template", "none".to_owned()),
            (Some(_), false) => refused("a template for the given template landmarks", "none".to_owned()),
            _ => Ok(()),
        }
    }

    /// Returns an error if a landmark of a member is too far from the member's surface to guide the registration.
    /// `surface` is in the member's own frame.
    pub(super) fn check_near(&self, member: usize, surface: &Mesh) -> Result<(), Error> {
        let far = self.members.get(member).and_then(|points| FarGuide::of(points, surface));
        far.map_or(Ok(()), |far| Err(Error::FarGuide(far)))
    }

    /// Returns the template's landmarks, in the frame in which the template is mapped.
    fn of_template(&self, template: Option<usize>, similarities: &[Similarity]) -> Vec<Vec3> {
        match (template, &self.template) {
            (None, Some(given)) => given.clone(),
            (index, _) => self.of_member(index.unwrap_or(0), similarities),
        }
    }

    fn of_member(&self, index: usize, similarities: &[Similarity]) -> Vec<Vec3> {
        self.members[index].iter().map(|point| similarities[index].apply(*point)).collect()
    }

    /// Computes a member's pose from its landmarks `own` and the template's landmarks `theirs`. Improves the pose by
    /// comparing the member's surface `moving` with the template's surface `fixed`. Then compares the pose with
    /// `found`, the pose computed from the surfaces alone.
    pub(super) fn judge(
        &self,
        (moving, own): (&PoseSurface, &[Vec3]),
        (fixed, theirs): (&PoseSurface, &[Vec3]),
        found: &Similarity,
        params: &PoseParams,
    ) -> Verdict {
        if own.len() < TURN || flat(own) || flat(theirs) {
            return Verdict::Undetermined;
        }
        // Landmarks in a plane don't distinguish a body from its mirror image. For such landmarks, the pose computed
        // from the surfaces determines whether the member is reflected.
        let by_landmarks = if in_a_plane(own) || in_a_plane(theirs) {
            let before = if found.mirrors() { Similarity::reflection() } else { Similarity::default() };
            let own: Vec<Vec3> = own.iter().map(|point| before.apply(*point)).collect();
            before.then(&motion(&own, theirs, None, params.scale, false))
        } else {
            motion(own, theirs, None, params.scale, params.mirror)
        };
        let (similarity, distance) = improved(moving, fixed, &by_landmarks, params);
        if !differ(&similarity, found) {
            return Verdict::Confirmed;
        }
        let scaled = at_one_size(moving, fixed, &similarity, params);
        let at_own_size = |scaled: Similarity| {
            let own = scaled.with_scale(1.0, moving.centre);
            (own, distance_of(moving, fixed, &own, params.trimmed))
        };
        let (similarity, distance) = scaled.map_or((similarity, distance), at_own_size);
        Verdict::Other(Box::new(PoseByLandmarks { similarity, at_one_size: scaled, distance }))
    }
}

/// Result of comparing a pose that was computed from the surfaces alone with the pose computed from landmarks.
pub(super) enum Verdict {
    /// The landmarks don't determine the rotation, because they are too few or lie on a line.
    Undetermined,
    /// The landmarks give the same rotation as the surfaces.
    Confirmed,
    /// The landmarks give a different rotation than the surfaces.
    Other(Box<PoseByLandmarks>),
}

/// A pose computed from landmarks.
pub(super) struct PoseByLandmarks {
    pub(super) similarity: Similarity,
    /// The pose at the template's size, as in
    /// [`GroupPoses::at_one_size`](spharm_surface::pose::GroupPoses::at_one_size).
    pub(super) at_one_size: Option<Similarity>,
    /// Distance between the surfaces in this pose.
    pub(super) distance: f64,
}

/// Returns the positions of points relative to the points' mean.
pub(super) fn about_their_mean(points: &[Vec3]) -> Vec<Vec3> {
    let share = 1.0 / points.len() as f64;
    let mean: Vec3 = std::array::from_fn(|k| share * points.iter().map(|point| point[k]).sum::<f64>());
    points.iter().map(|point| sub(*point, mean)).collect()
}

/// Returns whether points are so close to a line that they don't determine the rotation about the line.
fn flat(points: &[Vec3]) -> bool {
    let square = |v: Vec3| dot(v, v);
    let points = about_their_mean(points);
    let Some(&far) = points.iter().max_by(|a, b| square(**a).total_cmp(&square(**b))) else { return true };
    let off = |point: &Vec3| square(*point) - dot(*point, far).powi(2) / square(far).max(f64::MIN_POSITIVE);
    points.iter().map(off).fold(0.0, f64::max) <= 0.01 * square(far)
}

/// Returns whether points are so close to a plane that they don't determine a reflection.
fn in_a_plane(points: &[Vec3]) -> bool {
    let from_middle = about_their_mean(points);
    let pairs =
        || from_middle.iter().enumerate().flat_map(|(i, a)| from_middle[..i].iter().map(move |b| cross(*a, *b)));
    let normal =
        pairs().fold([0.0; 3], |best, normal| if dot(normal, normal) > dot(best, best) { normal } else { best });
    let off = from_middle.iter().map(|point| dot(*point, normal).powi(2)).fold(0.0, f64::max);
    let size = from_middle.iter().map(|point| dot(*point, *point)).fold(0.0, f64::max);
    off <= 0.01 * size * dot(normal, normal)
}

/// Landmarks of all members, with the landmarks' positions on the group's template.
pub(super) struct Guided<'a> {
    landmarks: &'a GuideLandmarks,
    places: Vec<Place>,
}

impl<'a> Guided<'a> {
    /// Finds the landmarks' positions on a mapped template. Returns `None` without landmarks.
    pub(super) fn new(
        landmarks: Option<&'a GuideLandmarks>,
        mapped: &Mesh,
        template: Option<usize>,
        similarities: &[Similarity],
    ) -> Result<Option<Self>, Error> {
        let Some(landmarks) = landmarks else { return Ok(None) };
        let points = landmarks.of_template(template, similarities);
        let places = Place::nearest(mapped, &points).ok_or(Error::NoArea)?;
        Ok(Some(Self { landmarks, places }))
    }

    /// Returns the landmarks' positions on the group's sphere.
    pub(super) fn places(&self) -> &[Place] {
        &self.places
    }

    /// Returns a member's landmarks as guides for registering the template to the member.
    pub(super) fn of(&self, index: usize, similarity: &Similarity) -> Vec<Guide> {
        let pairs = self.places.iter().zip(&self.landmarks.members[index]);
        pairs.map(|(place, point)| Guide { place: *place, point: similarity.apply(*point) }).collect()
    }

    /// Divides a member's p landmarks into parts, and repeats the registration with each part left out. Returns each
    /// landmark's distance from its corresponding point in the registration that leaves its part out.
    pub(super) fn left_out(
        &self,
        guides: &[Guide],
        template: &Template,
        subject: &Subject,
        params: &RegisterParams,
        monitor: &dyn Monitor,
    ) -> Result<Vec<f64>, Error> {
        let parts = PARTS.min(guides.len());
        let of_part = |part: usize| -> Result<Vec<f64>, Error> {
            let kept: Vec<Guide> =
                guides.iter().enumerate().filter(|(k, _)| k % parts != part).map(|(_, guide)| *guide).collect();
            let Registered { vertices, .. } = register(template, subject, &kept, params, monitor)?;
            Ok(guides.iter().map(|guide| apart(guide, &vertices)).collect())
        };
        let found = (0..parts).into_par_iter().map(of_part).collect::<Result<Vec<_>, _>>()?;
        Ok((0..guides.len()).map(|k| found[k % parts][k]).collect())
    }

    /// Returns the distances of landmarks from their corresponding points in a group.
    pub(super) fn report(
        &self,
        places: &[Vec<Vec3>],
        similarities: &[Similarity],
        left_out: &[Vec<f64>],
    ) -> GuideReport {
        let of = |(index, places): (usize, &Vec<Vec3>)| -> Vec<f64> {
            self.of(index, &similarities[index]).iter().map(|guide| apart(guide, places)).collect()
        };
        let found: Vec<Vec<f64>> = places.iter().enumerate().map(of).collect();
        GuideReport { guided: mean(&found), left_out: mean(left_out), by_member: left_out.to_vec() }
    }
}

fn apart(guide: &Guide, vertices: &[Vec3]) -> f64 {
    let off = sub(guide.point, guide.place.of(vertices));
    dot(off, off).sqrt()
}

/// Returns the mean of rows of equal length.
fn mean(rows: &[Vec<f64>]) -> Vec<f64> {
    let width = rows.first().map_or(0, Vec::len);
    (0..width).map(|k| rows.iter().map(|row| row[k]).sum::<f64>() / rows.len() as f64).collect()
}
