//! The motion that brings one surface onto another, by the surfaces alone.
//!
//! A pose that is decided by distances at equal directions depends on how each surface was mapped to the sphere. Here
//! nothing but the surfaces counts, whatever their topology and triangles. With d the distance of a point from the
//! other surface,
//!
//! ```text
//! distance^2 = mean of the least 1 - trimmed of { d(x_i, B)^2, d(y_j, A)^2 },   x_i on A, y_j on B
//! ```
//!
//! over points even in area is least at the pose that is looked for. It has many local minima, so the search starts
//! from a covering of all rotations, laid out by both surfaces' principal axes, so that the outcome doesn't depend on
//! the pose that a surface comes in. All 3,900 are looked at by 256 points of each surface; the best 32, which differ
//! by 15 degrees or more, are improved by nearest points both ways, the best 6 of their ends on 1,024 points, and 2 on
//! 4,096. A part of the area that has no counterpart, such as a process that is cut off, is left out by `trimmed`.
//!
//! Symmetric and nearly symmetric surfaces have several equally good poses: [`Pose::second`] is the distance of the
//! second best.
//!
//! The same bits come out for any number of threads.

mod covering;
mod grid;
mod group;
mod icp;
mod level;
mod surface;

use std::sync::OnceLock;

use rayon::prelude::*;
use spharm_monitor::{Interrupted, Monitor};

pub use self::group::{DOUBTFUL, GroupPoseWarning, GroupPoses, OF_ANOTHER_KIND, OTHERS, group_poses};
use self::surface::Density;
pub use self::surface::PoseSurface;
use crate::geometry::{scale, sub};
use crate::kabsch::kabsch;
use crate::matrix3::{Matrix3, angle_between, product, times, transposed};
use crate::similarity::Similarity;

/// What a pose may be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PoseParams {
    /// Whether the moving surface is scaled to the fixed one's size; `false` by default.
    pub scale: bool,
    /// Whether mirror images are matched too; `false` by default.
    pub mirror: bool,
    /// Share of the points that may lie anywhere, from 0 to less than 1; 0.1 by default.
    pub trimmed: f64,
}

impl Default for PoseParams {
    fn default() -> Self {
        Self { scale: false, mirror: false, trimmed: 0.1 }
    }
}

/// How a surface comes onto another.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Pose {
    /// The motion.
    pub similarity: Similarity,
    /// Root mean square distance of the surfaces after it, both ways, of all points but the trimmed ones, in the fixed
    /// surface's unit.
    pub distance: f64,
    /// The same after the best motion whose rotation is another by more than [`DISTINCT`]; infinite where every start
    /// came to the same end.
    pub second: f64,
    /// That motion.
    pub other: Option<Similarity>,
}

/// Rotations that differ by less, in radians, are the same optimum: 15 degrees.
pub const DISTINCT: f64 = 0.261_799_387_799_149_4;

/// Rotations of the covering that are improved, of those that bring the surfaces nearest as they are.
const STARTS: usize = 32;

/// Relative decrease of the sum of squared distances below which a round is the last, however far surfaces still slide.
const GAIN: f64 = 2e-3;

/// How starts become ends: points, rounds, and how many go on.
struct Stage {
    density: Density,
    rounds: usize,
    tangential: f64,
    /// Rest relative to the fixed surface's size.
    rest: f64,
    /// Ends that are candidates for the next stage.
    candidates: usize,
    /// Those that go on, of the candidates measured by the points of the next stage; and the one whose distance is the
    /// least where nothing is trimmed.
    go_on: usize,
}

/// Candidates farther than the best by this factor don't go on: few points don't tell nearer ones apart, of which a
/// square rod has eight.
const CANDIDATE: f64 = 1.5;
/// Trimmed distances within this factor count as equal; untrimmed ones decide between them.
const EQUAL: f64 = 1.03;
/// Rounds in which surfaces of one size come nearer, by few points.
const SETTLING: usize = 4;

// Distances between points stop surfaces from sliding: at a weight of 0.03, a third of nearly round bodies didn't
// converge.
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

/// Finds the motion that brings `moving` onto `fixed`, see the [module](self). Some 30 ms of two threads.
///
/// # Errors
///
/// [`Interrupted`].
pub fn pose(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Pose, Interrupted> {
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
    })
}

/// Motions in the order of their untrimmed distances: two poses may differ in a part as small as the trimmed share,
/// such as the knob at one end of a rod.
fn in_whole_order(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    density: Density,
    found: Vec<(Similarity, f64)>,
) -> Vec<(Similarity, f64)> {
    if found.len() < 2 {
        return found;
    }
    let ranked = found.into_par_iter().map(|end| (end, whole(moving, fixed, density, &end.0)));
    let mut ranked: Vec<((Similarity, f64), f64)> = ranked.collect();
    ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
    ranked.into_iter().map(|(end, _)| end).collect()
}

/// Untrimmed distance, as the surfaces are or scaled to one size, whichever is less: a larger body hides bumps of a
/// smaller one, and a body that is cut off must not be scaled up.
fn whole(moving: &PoseSurface, fixed: &PoseSurface, density: Density, motion: &Similarity) -> f64 {
    let (a, b) = (moving.view(density), fixed.view(density));
    let [as_it_is, of_one_size] =
        [*motion, of_size(motion, moving, fixed)].map(|motion| icp::distance(a, b, &motion, 0.0));
    as_it_is.min(of_one_size)
}

/// A motion that also scales one surface to the size of the other, and brings it nearer.
fn of_size(motion: &Similarity, moving: &PoseSurface, fixed: &PoseSurface) -> Similarity {
    let size = fixed.size() / moving.size();
    let translation = sub(motion.apply(moving.centre), scale(times(&motion.orthogonal, moving.centre), size));
    let start = Similarity { scale: size, translation, ..*motion };
    let rounds = icp::Rounds {
        most: SETTLING,
        rest: 1e-3 * fixed.size(),
        gain: GAIN,
        trimmed: 0.0,
        tangential: STAGES[0].tangential,
        scale: true,
    };
    icp::improved(moving.view(Density::Few), fixed.view(Density::Few), start, &rounds)
}

/// Returns the local optimum that a motion leads to, and its distance, as [`Pose`] has them.
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

/// Returns the root mean square distance of two surfaces after a motion, both ways, without the farthest share
/// `trimmed` of the points, in the fixed one's unit. Some 2 ms.
#[must_use]
pub fn distance(moving: &PoseSurface, fixed: &PoseSurface, motion: &Similarity, trimmed: f64) -> f64 {
    icp::distance(moving.view(Density::All), fixed.view(Density::All), motion, trimmed)
}

/// Improves motions, and returns the best distinct ones, the best first.
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

/// Motions that are nearly as good as the best, `least` of them or more, in the order of their distances by the points
/// of a density.
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

/// The best of some motions that are different optima, the best first.
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

/// Whether two motions are different optima.
fn differ(a: &Similarity, b: &Similarity) -> bool {
    a.mirrors() != b.mirrors() || angle_between(&a.orthogonal, &b.orthogonal) > DISTINCT
}

/// The best of the covering's rotations, laid out from axes to axes, centre onto centre.
fn starts(
    moving: &PoseSurface,
    fixed: &PoseSurface,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Vec<(Similarity, f64)>, Interrupted> {
    static COVERING: OnceLock<Vec<Matrix3>> = OnceLock::new();
    monitor.check()?;
    let size = if params.scale { fixed.size() / moving.size() } else { 1.0 };
    let signs: &[f64] = if params.mirror { &[1.0, -1.0] } else { &[1.0] };
    let turns = COVERING.get_or_init(covering::covering);
    let (a, b) = (moving.view(Density::Few), fixed.view(Density::Few));
    let look = |(turn, sign): (&Matrix3, f64)| {
        let turn = turn.map(|row| row.map(|v| sign * v));
        let orthogonal = product(&transposed(&fixed.axes), &product(&turn, &moving.axes));
        let translation = sub(fixed.centre, scale(times(&orthogonal, moving.centre), size));
        let start = Similarity { orthogonal, scale: size, translation };
        (start, icp::mean_distance(a, b, &start))
    };
    let all = (0..turns.len() * signs.len()).into_par_iter().with_min_len(64);
    let found = all.map(|i| look((&turns[i % turns.len()], signs[i / turns.len()]))).collect();
    Ok(distinct(found, STARTS * signs.len()))
}

#[cfg(test)]
mod tests;
