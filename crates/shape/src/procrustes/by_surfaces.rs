//! Aligns a group by its surfaces: the surfaces determine the poses, and the parameters are then aligned in these
//! poses.
//!
//! The members' [surfaces are aligned](spharm_surface::pose::group_poses) first, with scale and mirror images if
//! requested. Then the Procrustes analysis rotates only the parameters. Surfaces keep their positions relative to each
//! other: the origin is the centre of the mean. Members aren't centred individually.
//!
//! Because surfaces are sampled at points, poses are accurate only to a thousandth of a surface's size. A joint
//! alignment, which searches the rotations of space and of the parameters together, has no sampling error. Its result
//! is used if it reduces the members' distances at equal directions below the distances between their surfaces in the
//! sampled poses. The surfaces then fit each other at least as well as in the sampled poses, because the distance
//! between two surfaces is at most their distance at equal directions.

use rayon::prelude::*;
use spharm_harmonics::Coefficients;
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_surface::pose::{GroupPoses, PoseParams, PoseSurface, group_poses, improved, pose};

use super::{Group, Journal, Procrustes, ProcrustesParams, ProcrustesWarning, brought_together};
use crate::align::{AlignParams, Method};
use crate::error::ShapeError;
use crate::evaluated::{Evaluated, in_pose};
use crate::group::{mean_of, spread_of};
use crate::surface_poses::GAIN;
use crate::transform::{SQRT_4_PI, Similarity, Transform};

/// Sampling error of the distance between two surfaces, as a fraction of the surfaces' size.
const ROUNDING: f64 = 1e-3;
/// If the members' distance at equal directions is less than this multiple of the distance between their surfaces,
/// equal directions may correspond. The joint alignment is then tried.
const NEAR: f64 = 2.0;
/// A group is treated as a mix of two sides, such as left and right, if the mirror images of at least this fraction of
/// its members are nearer than the members themselves. If there are fewer such members, each is reported individually.
const SIDES: f64 = 0.25;

/// Aligns a group by its surfaces. If a member is a point or a line, it has no pose, and the group is aligned by the
/// joint search of both rotations instead.
pub(super) fn together(
    members: &[Coefficients],
    params: &ProcrustesParams,
    mut journal: Option<&mut Journal>,
    monitor: &dyn Monitor,
) -> Result<Procrustes, ShapeError> {
    let lowest = members.iter().map(Coefficients::max_degree).min().unwrap_or(0);
    let degree = params.align.max_degree.map_or(lowest, |degree| degree.min(lowest));
    let evaluated = Evaluated::new(degree)?;
    let one = |member: &Coefficients| -> Result<Option<PoseSurface>, ShapeError> {
        monitor.check()?;
        evaluated.surface(member.values().view())
    };
    let surfaces: Vec<Result<Option<PoseSurface>, ShapeError>> = members.par_iter().map(one).collect();
    let surfaces = surfaces.into_iter().collect::<Result<Vec<_>, _>>()?;
    let joint =
        ProcrustesParams { align: AlignParams { method: Method::Joint, ..params.align.clone() }, ..params.clone() };
    let without = |(member, surface): (usize, &Option<PoseSurface>)| surface.is_none().then_some(member);
    let flat: Vec<usize> = surfaces.iter().enumerate().filter_map(without).collect();
    if !flat.is_empty() {
        let mut result = brought_together(members, &joint, journal, monitor)?;
        let warnings = flat.into_iter().map(|member| ProcrustesWarning::NoArea { member });
        result.report.warnings.splice(0..0, warnings);
        return Ok(result);
    }
    let surfaces: Vec<PoseSurface> = surfaces.into_iter().flatten().collect();
    let of_pose = PoseParams { scale: params.align.scale, mirror: params.align.mirror, ..PoseParams::default() };
    let found = group_poses(&surfaces, &of_pose, monitor)?;
    let mut warnings: Vec<ProcrustesWarning> = found.warnings.iter().copied().map(ProcrustesWarning::Pose).collect();
    if !params.align.mirror {
        warnings.extend(mirrored(&surfaces, &found, &of_pose, monitor)?);
    }
    let of = |(motion, own): (&Similarity, &PoseSurface)| in_pose(*motion, own, &surfaces[found.template]);
    let motions: Vec<Transform> = found.similarities.iter().zip(&surfaces).map(of).collect();
    let apply = |(member, motion): (&Coefficients, &Transform)| motion.apply(member, &OnlyCancel(monitor));
    let posed: Vec<Result<Coefficients, ShapeError>> = members.par_iter().zip(&motions).map(apply).collect();
    let posed = posed.into_iter().collect::<Result<Vec<_>, _>>()?;
    let under = ProcrustesParams {
        align: AlignParams { scale: false, mirror: false, ..params.align.clone() },
        ..params.clone()
    };
    let mut result = brought_together(&posed, &under, journal.as_deref_mut(), monitor)?;
    // The distance between two members is sqrt(2) times the members' spread about the mean.
    let apart = |spread: f64| 2.0_f64.sqrt() * spread;
    let size = surfaces[found.template].size();
    let square: f64 = found.distances.iter().map(|distance| distance * distance).sum();
    let bound = (square / found.distances.len() as f64).sqrt().max(ROUNDING * size);
    if apart(result.report.spread_after) < NEAR * bound {
        let mut exact = brought_together(members, &joint, journal, monitor)?;
        if apart(exact.report.spread_after) <= bound {
            exact.report.warnings.splice(0..0, warnings);
            return Ok(exact);
        }
    }
    // The alignment centred each member separately. The members' positions relative to the common centre are now
    // restored.
    let centres: Vec<[f64; 3]> =
        posed.iter().map(|member| std::array::from_fn(|c| member.values()[[0, c]] / SQRT_4_PI)).collect();
    let count = centres.len() as f64;
    let centre: [f64; 3] = std::array::from_fn(|c| centres.iter().map(|own| own[c]).sum::<f64>() / count);
    let off = |own: &[f64; 3]| (0..3).map(|c| (own[c] - centre[c]).powi(2)).sum::<f64>().sqrt();
    for ((transform, motion), (rmsd, own)) in
        result.transforms.iter_mut().zip(&motions).zip(result.report.rmsd.iter_mut().zip(&centres))
    {
        let turned = Similarity { translation: [0.0; 3], ..transform.similarity };
        let about_all = Similarity { translation: turned.apply(centre).map(|v| -v), ..turned };
        transform.antipodal = motion.antipodal;
        transform.similarity = motion.similarity.then(&about_all);
        *rmsd = rmsd.hypot(off(own));
    }
    let report = &mut result.report;
    report.spread_after = (report.rmsd.iter().map(|rmsd| rmsd * rmsd).sum::<f64>() / count).sqrt();
    report.spread_before = spread_as_given(members, degree, &under, monitor)?;
    report.warnings.splice(0..0, warnings);
    Ok(result)
}

/// Returns the spread of the input members after they were centred, without any other alignment.
fn spread_as_given(
    members: &[Coefficients],
    degree: usize,
    params: &ProcrustesParams,
    monitor: &dyn Monitor,
) -> Result<f64, ShapeError> {
    let still = ProcrustesParams {
        align: AlignParams { method: Method::FixedParameters, ..params.align.clone() },
        ..params.clone()
    };
    let given = Group::new(members, degree, &still, None, &OnlyCancel(monitor))?.as_given();
    Ok(spread_of(&given, &mean_of(&given)))
}

/// Returns warnings about members whose mirror images are much nearer to the typical member than the members
/// themselves. Members and their mirror images are compared at the typical member's size, because a difference in size
/// adds to both distances. Each is compared in its best pose, because a member's pose in the group may be wrong.
fn mirrored(
    surfaces: &[PoseSurface],
    found: &GroupPoses,
    params: &PoseParams,
    monitor: &dyn Monitor,
) -> Result<Vec<ProcrustesWarning>, ShapeError> {
    let typical = found.template;
    let unmirrored = PoseParams { scale: true, mirror: false, ..*params };
    let either = PoseParams { mirror: true, ..unmirrored };
    let one = |member: usize| -> Result<Option<ProcrustesWarning>, ShapeError> {
        let (moving, fixed) = (&surfaces[member], &surfaces[typical]);
        if member == typical {
            return Ok(None);
        }
        let best = pose(moving, fixed, &either, monitor)?;
        if !best.similarity.mirrors() {
            return Ok(None);
        }
        let motion = found.similarities[member].then(&found.similarities[typical].inverse());
        let (_, in_group) = improved(moving, fixed, &motion, &unmirrored);
        let rmsd = in_group.min(pose(moving, fixed, &unmirrored, monitor)?.distance);
        let much = best.distance < (1.0 - GAIN) * rmsd;
        Ok(much.then_some(ProcrustesWarning::Mirrored { member, rmsd, mirrored: best.distance }))
    };
    let warnings: Vec<Result<_, ShapeError>> = (0..surfaces.len()).into_par_iter().map(one).collect();
    let named: Vec<ProcrustesWarning> =
        warnings.into_iter().collect::<Result<Vec<_>, ShapeError>>()?.into_iter().flatten().collect();
    Ok(sides(named, surfaces.len()))
}

/// If many members are mirror images of the others, replaces the warnings with a single warning that the group mixes
/// two sides, such as left and right.
fn sides(named: Vec<ProcrustesWarning>, of: usize) -> Vec<ProcrustesWarning> {
    let other: Vec<usize> = named.iter().filter_map(ProcrustesWarning::member).collect();
    if other.len() < 2 || (other.len() as f64) < SIDES * of as f64 {
        return named;
    }
    let root = |square: f64| (square / other.len() as f64).sqrt();
    let (mut as_they_are, mut matched) = (0.0, 0.0);
    for warning in &named {
        if let ProcrustesWarning::Mirrored { rmsd, mirrored, .. } = warning {
            (as_they_are, matched) = (as_they_are + rmsd * rmsd, matched + mirrored * mirrored);
        }
    }
    let smaller = 2 * other.len() < of || 2 * other.len() == of && !other.contains(&0);
    let members = if smaller { other.clone() } else { (0..of).filter(|member| !other.contains(member)).collect() };
    vec![ProcrustesWarning::Sides { members, of, spread: root(as_they_are), mirrored: root(matched) }]
}
