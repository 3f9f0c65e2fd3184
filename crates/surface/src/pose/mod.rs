//! Finds the motion that brings one surface onto another, from the two surfaces alone.
//!
//! The surfaces can have any topology and triangles. A pose based on distances between points that have the same
//! direction on the sphere would depend on the mapping of each surface to the sphere; the pose found here doesn't. With
//! d the distance of a point from the other surface, the pose minimises
//!
//! ```text
//! distance^2 = mean of the least 1 - trimmed of { d(x_i, B)^2, d(y_j, A)^2 },   x_i on A, y_j on B
//! ```
//!
//! over points that are spread evenly over the area. This function has many local minima, so the search starts from a
//! set of 3,900 rotations that covers all rotations. The rotations are relative to both surfaces' principal axes, so
//! the result doesn't depend on a surface's initial pose. All rotations are evaluated with 256 points of each surface.
//! The best 32 rotations that differ by at least 15 degrees are improved by iterative closest points in both
//! directions. The best 6 of the results are improved further with 1,024 points, and the best 2 of these with 4,096
//! points. `trimmed` is the share of the area that is excluded because it may have no counterpart, such as a process
//! that is cut off on one surface.
//!
//! Symmetric and nearly symmetric surfaces have several poses that are equally or nearly equally good; see
//! [`Pose::second`].
//!
//! If the surfaces are already the right way round, such as scans in one coordinate system, [`PoseSearch::Near`] only
//! improves the given poses. In this case, a body that looks nearly the same after a half turn isn't turned.
//!
//! The result is bitwise the same for any number of threads.

mod changes;
mod coarse;
mod covering;
mod fixed;
mod grid;
mod group;
mod icp;
mod level;
mod sizes;
mod surface;
mod warning;

use std::sync::OnceLock;

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

pub use self::changes::NEARER_MIRRORED;
pub use self::fixed::FixedSurface;
pub use self::group::{DOUBTFUL, GroupPoses, OF_ANOTHER_KIND, OTHERS, group_poses};
pub use self::sizes::{ScaledPose, at_one_size};
use self::surface::Density;
pub use self::surface::PoseSurface;
pub use self::warning::{CLOSE, GroupPoseWarning, IN_DOUBT, NearerMirrored};
use crate::geometry::{scale, sub};
use crate::kabsch::kabsch;
use crate::matrix3::{Matrix3, angle_between, product, times, transposed};
use crate::similarity::Similarity;

/// The poses from which a search starts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum PoseSearch {
    /// All rotations: the surfaces may have any poses.
    #[default]
    Any,
    /// A few poses, for surfaces that are already the right way round: the given pose, the given pose with coinciding
    /// centres and, if mirror images are allowed, the mirror image (x to -x).
    Near,
}

/// Settings of a pose search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseParams {
    /// The poses from which the search starts; all rotations by default.
    pub search: PoseSearch,
    /// Whether to scale the moving surface to the size of the fixed surface; `false` by default.
    pub scale: bool,
    /// Whether mirror images of the moving surface are allowed; `false` by default.
    pub mirror: bool,
    /// Share of the points to exclude as outliers, at least 0 and less than 1; 0.1 by default.
    pub trimmed: f64,
}

impl Default for PoseParams {
    fn default() -> Self {
        Self { search: PoseSearch::Any, scale: false, mirror: false, trimmed: 0.1 }
    }
}

/// The best pose of a surface on another surface, and the second best.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// The motion of the best pose.
    pub similarity: Similarity,
    /// Root mean square distance between the surfaces in both directions, in the fixed surface's unit. It is the
    /// distance in the best pose at the surfaces' own sizes. Points that [`PoseParams::trimmed`] excludes are ignored.
    pub distance: f64,
    /// Distance in the second best pose: the best of the poses whose rotations differ from the best pose's rotation by
    /// more than [`DISTINCT`]. Infinite if all starts led to the same optimum, or if only poses near the given one were
    /// searched.
    pub second: f64,
    /// The motion with the distance `second`, if a second-best pose was found.
    pub other: Option<Similarity>,
    /// The pose at the fixed surface's size, if size explains the difference between the surfaces; see [`at_one_size`].
    /// In this case, `similarity` is this pose with the moving surface scaled back to its own size about its centre.
    /// The distance after `similarity` may then be larger than `distance`.
    pub at_one_size: Option<ScaledPose>,
}

impl Pose {
    /// Returns the distances in this pose and in the second-best pose, if the second-best pose is nearly as good, up to
    /// the factor [`DOUBTFUL`]. For this comparison, a distance in this pose below `least` is replaced by `least`. If
    /// size explains the difference between the surfaces, the distances are those after scaling the moving surface to
    /// the size of the fixed surface.
    #[must_use]
    pub fn doubt(&self, least: f64) -> Option<(f64, f64)> {
        let (distance, second) =
            self.at_one_size.map_or((self.distance, self.second), |scaled| (scaled.distance, scaled.second));
        (second < DOUBTFUL * distance.max(least)).then_some((distance, second))
    }
}

/// Angle, in radians, up to which two rotations are treated as the same optimum. The angle is 15 degrees.
pub const DISTINCT: f64 = 0.261_799_387_799_149_4;

/// Number of starts that the search improves: the rotations of the covering with the smallest distances.
const STARTS: usize = 32;

/// Relative decrease of the sum of squared distances below which rounds end, even if the surfaces still slide along
/// each other.
const GAIN: f64 = 2e-3;

/// A stage of the search, with the number of points and rounds, and the number of results for the next stage.
struct Stage {
    density: Density,
    rounds: usize,
    tangential: f64,
    /// Movement of the points at which rounds end, relative to the fixed surface's size.
    rest: f64,
    /// Number of results that are candidates for the next stage.
    candidates: usize,
    /// Number of candidates that enter the next stage: those with the smallest distances, measured with the next
    /// stage's points. In addition, the candidate with the smallest untrimmed distance among the remaining ones enters
    /// the next stage.
    go_on: usize,
}

/// Candidates whose distance exceeds this multiple of the best distance don't enter the next stage. If the distances
/// differ by less than this factor, measurements with few points can't show which candidate is best. For example, a
/// square rod has eight such candidates.
const CANDIDATE: f64 = 1.5;
/// Trimmed distances within this factor are treated as equal. In this case, the untrimmed distances decide which pose
/// is better.
const EQUAL: f64 = 1.03;

// The point-to-point terms (`tangential`) stop surfaces from sliding along each other. Their weight in the first stage
// is large, because with a weight of 0.03 a third of nearly round bodies didn't converge.
const STAGES: [Stage; 3] = [
    Stage { density: Density::Few, rounds: 12, tangential: 0.2, rest: 1e-3, candidates: 24, go_on: 6 },
    Stage { density: Density::Some, rounds: 10, tangential: 2e-3, rest: 1e-4, candidates: 4, go_on: 2 },
    Stage { density: Density::All, rounds: 30, tangential: 1e-3, rest: 1e-5, candidates: 3, go_on: 3 },
];

impl Stage {
    fn settings(&self, fixed: &PoseSurface, params: &PoseParams) -> icp::Rounds {
        icp::Rounds {
            most: self.rounds,
            rest: self.rest * fixed.size(),
            gain: GAIN,
            trimmed: params.trimmed,
            tangential: self.tangential,
            scale: params.scale,
        }
    }
}

/// Finds the motion that brings `moving` onto `fixed`; see the [module](self). It takes about 35 ms on two threads, or
/// 65 ms if the sizes differ.
///
/// # Errors
///
/// [`Interrupted`] if the monitor asks to stop.
pub fn pose(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Pose, Interrupted> {
    let found = nearest(moving, fixed, params, monitor)?;
    let Some(scaled) = sizes::searched_at_one_size(moving, fixed, &found.similarity, params, monitor)? else {
        return Ok(found);
    };
    let similarity = scaled.similarity.with_scale(1.0, moving.centre);
    Ok(Pose { similarity, at_one_size: Some(scaled), ..found })
}

/// Finds the motion that minimises the distance between the surfaces.
fn nearest(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Pose, Interrupted> {
    if params.search == PoseSearch::Near {
        return near(moving, fixed, params, monitor);
    }
    let mut found = starts(moving, fixed, params, monitor)?;
    for (stage, next) in STAGES.iter().zip(STAGES[1..].iter().map(Some).chain([None])) {
        found = staged(moving, fixed, &found, stage, params, monitor)?;
        if let Some(next) = next.filter(|_| found.len() > stage.go_on) {
            found = measured(moving, fixed, &found, stage.go_on, next.density, params, monitor)?;
            let rest = found.split_off(stage.go_on.min(found.len()));
            found.extend(in_whole_order(moving, fixed, stage.density, rest).first());
        }
    }
    let equal = found.iter().take_while(|end| end.1 <= EQUAL * found[0].1).count();
    let mut rest = found.split_off(equal);
    let mut found = in_whole_order(moving, fixed, Density::Some, found);
    rest.extend(found.drain(1..));
    found.extend(in_whole_order(moving, fixed, Density::Some, rest));
    let ((similarity, distance), other) = (found[0], found.get(1));
    Ok(Pose {
        similarity: Similarity { orthogonal: kabsch(&similarity.orthogonal, true), ..similarity },
        distance,
        second: other.map_or(f64::INFINITY, |other| other.1),
        other: other.map(|other| other.0),
        at_one_size: None,
    })
}

/// Improves the given pose, and the pose in which the centres coincide, and returns the better result. With `mirror`,
/// also starts from the mirror image (x to -x).
fn near(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Pose, Interrupted> {
    let centred = |own: Similarity| centred(own.orthogonal, moving, fixed, params);
    let mut starts = vec![Similarity::default(), centred(Similarity::default())];
    if params.mirror {
        starts.push(centred(Similarity::reflection()));
    }
    let one = |start: &Similarity| -> Result<(Similarity, f64), Interrupted> {
        monitor.check()?;
        Ok(improved(moving, fixed, start, params))
    };
    let found: Vec<Result<(Similarity, f64), Interrupted>> = starts.par_iter().map(one).collect();
    let found = found.into_iter().collect::<Result<Vec<_>, _>>()?;
    // A body that nearly equals its mirror image isn't mirrored.
    let better = |best: &(Similarity, f64), end: &(Similarity, f64)| {
        if end.0.mirrors() { EQUAL * end.1 < best.1 } else { end.1 < best.1 }
    };
    let best = found.iter().skip(1).fold(found[0], |best, end| if better(&best, end) { *end } else { best });
    let similarity = Similarity { orthogonal: kabsch(&best.0.orthogonal, true), ..best.0 };
    Ok(Pose { similarity, distance: best.1, second: f64::INFINITY, other: None, at_one_size: None })
}

/// Sorts motions by their untrimmed distances. Trimmed distances can't distinguish poses that differ only in a part as
/// small as the trimmed share, such as the knob at one end of a rod.
fn in_whole_order(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    density: Density,
    found: Vec<(Similarity, f64)>,
) -> Vec<(Similarity, f64)> {
    if found.len() < 2 {
        return found;
    }
    let ranked = found.into_par_iter().map(|end| (end, sizes::whole(moving, fixed, density, &end.0)));
    let mut ranked: Vec<((Similarity, f64), f64)> = ranked.collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
    ranked.into_iter().map(|(end, _)| end).collect()
}

/// Returns the local optimum that is reached from a motion, and its distance, as defined in [`Pose`].
#[must_use]
pub fn improved(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    start: &Similarity,
    params: &PoseParams,
) -> (Similarity, f64) {
    let motion = STAGES[1..].iter().fold(*start, |motion, stage| {
        let (a, b) = (moving.view(stage.density), fixed.view(stage.density));
        icp::improved(a, b, motion, &stage.settings(fixed, params))
    });
    (motion, distance(moving, fixed, &motion, params.trimmed))
}

/// Returns the root mean square distance between two surfaces after a motion, in both directions, in the fixed
/// surface's unit. The share `trimmed` of the points, those with the largest distances, is excluded. The function
/// takes about 2 ms.
#[must_use]
pub fn distance(moving: &PoseSurface, fixed: &PoseSurface, motion: &Similarity, trimmed: f64) -> f64 {
    icp::distance(moving.view(Density::All), fixed.view(Density::All), motion, trimmed)
}

/// Improves motions, and returns the results that are different optima, sorted by distance.
fn staged(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    starts: &[(Similarity, f64)],
    stage: &Stage,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Vec<(Similarity, f64)>, Interrupted> {
    let rounds = stage.settings(fixed, params);
    let (a, b) = (moving.view(stage.density), fixed.view(stage.density));
    let one = |(start, _): &(Similarity, f64)| -> Result<(Similarity, f64), Interrupted> {
        monitor.check()?;
        let motion = icp::improved(a, b, *start, &rounds);
        Ok((motion, icp::distance(a, b, &motion, params.trimmed)))
    };
    let found: Vec<Result<(Similarity, f64), Interrupted>> = starts.par_iter().map(one).collect();
    Ok(distinct(found.into_iter().collect::<Result<Vec<_>, _>>()?, stage.candidates))
}

/// Measures the distance between the surfaces after each motion, with the number of points given by `density`. Returns
/// the motions that are nearly as good as the best one, and at least `least` motions, sorted by the measured distances.
fn measured(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    found: &[(Similarity, f64)],
    least: usize,
    density: Density,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Vec<(Similarity, f64)>, Interrupted> {
    let (a, b) = (moving.view(density), fixed.view(density));
    let near = found.iter().filter(|(_, distance)| *distance <= CANDIDATE * found[0].1).count();
    let one = |(motion, _): &(Similarity, f64)| -> Result<(Similarity, f64), Interrupted> {
        monitor.check()?;
        Ok((*motion, icp::distance(a, b, motion, params.trimmed)))
    };
    let found: Vec<Result<(Similarity, f64), Interrupted>> = found[..near.max(least)].par_iter().map(one).collect();
    let mut found = found.into_iter().collect::<Result<Vec<_>, _>>()?;
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    Ok(found)
}

/// Returns the best motions that are different optima, at most `most`, sorted by distance.
fn distinct(mut found: Vec<(Similarity, f64)>, most: usize) -> Vec<(Similarity, f64)> {
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    let mut distinct: Vec<(Similarity, f64)> = Vec::with_capacity(most);
    for end in found {
        if distinct.len() == most {
            break;
        }
        if distinct.iter().all(|other| differ(&other.0, &end.0)) {
            distinct.push(end);
        }
    }
    distinct
}

/// Returns whether two motions are different optima: one of them is a reflection, or their rotations differ by more
/// than [`DISTINCT`].
#[must_use]
pub fn differ(a: &Similarity, b: &Similarity) -> bool {
    a.mirrors() != b.mirrors() || angle_between(&a.orthogonal, &b.orthogonal) > DISTINCT
}

/// Returns the motion with a given rotation that moves the centre of `moving` onto the centre of `fixed`. If scaling is
/// allowed, the motion also scales `moving` to the size of `fixed`.
fn centred(orthogonal: Matrix3, moving: &PoseSurface, fixed: &PoseSurface, params: &PoseParams) -> Similarity {
    let size = if params.scale { fixed.size() / moving.size() } else { 1.0 };
    let translation = sub(fixed.centre, scale(times(&orthogonal, moving.centre), size));
    Similarity { orthogonal, scale: size, translation }
}

/// Returns the motions from which the search starts: the best of a fixed set of rotations (`covering`). Each rotation
/// is applied between the principal axes of the two surfaces, and the centre of one surface is moved onto that of the
/// other.
fn starts(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Vec<(Similarity, f64)>, Interrupted> {
    static COVERING: OnceLock<Vec<Matrix3>> = OnceLock::new();
    monitor.check()?;
    let signs: &[f64] = if params.mirror { &[1.0, -1.0] } else { &[1.0] };
    let turns = COVERING.get_or_init(covering::covering);
    let look = |(turn, sign): (&Matrix3, f64)| {
        let turn = turn.map(|row| row.map(|v| sign * v));
        let orthogonal = product(&transposed(&fixed.axes), &product(&turn, &moving.axes));
        let start = centred(orthogonal, moving, fixed, params);
        (start, coarse::mean_distance(moving, fixed, &start))
    };
    let all = (0..turns.len() * signs.len()).into_par_iter().with_min_len(64);
    let found = all.map(|i| look((&turns[i % turns.len()], signs[i / turns.len()]))).collect();
    Ok(distinct(found, STARTS * signs.len()))
}

#[cfg(test)]
mod tests;
