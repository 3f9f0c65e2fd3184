//! Aligns a group of surfaces: generalised Procrustes analysis over rotations of the parameters and of space.
//!
//! In generalised Procrustes analysis (J. Gower, "Generalized Procrustes analysis", Psychometrika 40, 1975), every
//! surface is aligned to the mean, and then the mean is recomputed. These rounds are repeated until the spread,
//! `sqrt(sum |a_i - mean|^2 / n / 4 pi)`, stops falling. All surfaces are first aligned to a template by the [joint
//! search](mod@crate::align). Then the pose of each surface is refined from its current value. Once the group has
//! converged, each pose is searched anew. Because of local optima, several templates are tried, and the result with the
//! smallest spread is kept. The report lists the spreads of all templates. Members are centred at the origin. With
//! `scale` all members are first scaled to the root mean square size of the group, so that the group doesn't shrink.
//!
//! The mean of a group has no natural pose. At the end, all surfaces are rotated together into the [frame](crate::foe)
//! of the mean's first-order ellipsoid. The result therefore doesn't depend on the poses of the input.
//!
//! Memory: `96 n (L+1)^2` bytes for n surfaces of degree L in addition to the input. For n = 1,000 and L = 29, this is
//! 86 MB. Each thread needs the memory of [`align`](mod@crate::align), plus 0.6 MB with [`Method::Surfaces`]. Surfaces
//! are aligned on all threads. Sums are computed in the order of the members, so the result doesn't depend on the
//! number of threads.

mod by_surfaces;
mod journal;
mod mirrored;
mod sides;

use std::sync::{Mutex, PoisonError};

use ndarray::{Array2, ArrayView2};
use rayon::prelude::*;
use spharm_harmonics::Coefficients;
use spharm_monitor::{Monitor, OnlyCancel, Stage};

pub use self::journal::Journal;
use crate::align::{Method, nothing_to_turn, undetermined};
use crate::error::ShapeError;
use crate::extent::surface;
use crate::foe::{EllipsoidFrame, LEAST_RATIO};
use crate::group::{Member, Pose, Round, mean_of, spread_of};
use crate::matrix3::product;
use crate::pair::{Plan, Unit, object_only};
pub use crate::procrustes_report::{Procrustes, ProcrustesParams, ProcrustesReport, ProcrustesWarning, TemplateEnd};
use crate::refine::{Space, Target};
use crate::rotation::Rotation;
use crate::surface_poses::surface_poses;
use crate::templates::templates;
use crate::transform::{SQRT_4_PI, Similarity, Transform};
use crate::units::other_units;

/// Minimum number of members of a group.
const LEAST: usize = 3;
/// Number of members that are aligned between two writes to the journal.
const KEPT: usize = 64;

/// Aligns a group of surfaces; see the [module](self). The coefficients of each member are (K, 3).
///
/// # Errors
///
/// [`ShapeError::TooFewMembers`] if there are fewer than three members; [`ShapeError::Member`] if a member isn't a
/// valid surface; [`ShapeError::Setting`] if a setting is out of range, or the method is
/// [`Method::FirstOrderEllipsoid`]; [`ShapeError::Interrupted`] if the monitor cancels.
pub fn procrustes(
    members: &[Coefficients],
    params: &ProcrustesParams,
    monitor: &dyn Monitor,
) -> Result<Procrustes, ShapeError> {
    procrustes_with(members, params, None, monitor)
}

/// Aligns a group like [`procrustes`], and saves its progress in a journal. A later run resumes from the journal, and
/// its result is bitwise the same as without the interruption. The journal must have been opened by [`Journal::open`]
/// with the same members and settings.
///
/// # Errors
///
/// The errors of [`procrustes`]; [`ShapeError::Journal`] if the file can't be written.
pub fn procrustes_with(
    members: &[Coefficients],
    params: &ProcrustesParams,
    journal: Option<&mut Journal>,
    monitor: &dyn Monitor,
) -> Result<Procrustes, ShapeError> {
    if members.len() < LEAST {
        return Err(ShapeError::TooFewMembers { found: members.len(), least: LEAST });
    }
    for (index, member) in members.iter().enumerate() {
        surface(member).map_err(|source| ShapeError::Member { index, source: Box::new(source) })?;
    }
    if params.align.method == Method::FirstOrderEllipsoid {
        return Err(ShapeError::Setting {
            name: "the method",
            found: "first-order ellipsoids".to_owned(),
            expected: "use the joint search or fixed parameters for a group",
        });
    }
    let mut found = if params.align.method == Method::Surfaces {
        by_surfaces::together(members, params, journal, monitor)?
    } else {
        brought_together(members, params, journal, monitor)?
    };
    found.report.warnings.splice(0..0, other_units(members).into_iter().map(ProcrustesWarning::Unit));
    Ok(found)
}

/// Aligns a validated group. With [`Method::Surfaces`], the poses found from the surfaces must already be applied to
/// the members.
fn brought_together(
    members: &[Coefficients],
    params: &ProcrustesParams,
    journal: Option<&mut Journal>,
    monitor: &dyn Monitor,
) -> Result<Procrustes, ShapeError> {
    let degrees = || members.iter().map(Coefficients::max_degree);
    let (lowest, highest) = (degrees().min().unwrap_or(0), degrees().max().unwrap_or(0));
    let degree = params.align.max_degree.map_or(lowest, |degree| degree.min(lowest));
    let mut warnings = Vec::new();
    if lowest != highest && params.align.max_degree.is_none_or(|degree| degree > lowest) {
        warnings.push(ProcrustesWarning::DegreesDiffer { lowest, highest });
    }
    let mut group = Group::new(members, degree, params, journal, monitor)?;
    let order = templates(members.len(), params.templates, || {
        let round = group.brought_to(0)?;
        Ok::<_, ShapeError>(round.members.into_iter().map(|member| member.rows).collect())
    })?;
    let mut best: Option<Round> = None;
    let mut ends = Vec::new();
    for template in order {
        let start = group.brought_to(template)?;
        let (round, rounds, change) = group.settle(start)?;
        ends.push(TemplateEnd { template, spread: round.spread, rounds });
        // Spreads that agree within ten times the tolerance are treated as equal. Of starts with equal spreads, the
        // first one is kept.
        let much = 10.0 * params.tolerance;
        if best.as_ref().is_none_or(|best| round.spread < best.spread * (1.0 - much)) {
            best = Some(round);
            warnings.retain(|warning| !matches!(warning, ProcrustesWarning::NotConverged { .. }));
            warnings.extend(change.map(|change| ProcrustesWarning::NotConverged { change }));
        }
    }
    let Some(best) = best else { return Err(ShapeError::TooFewMembers { found: 0, least: LEAST }) };
    let polished = group.polished(best)?;
    warnings.extend(group.of_members(&polished));
    // With [`Method::Surfaces`], mirror images were detected while the poses were determined.
    if !params.align.mirror && params.align.method != Method::Surfaces {
        let (mirrored, unclear) = group.mirrored(&polished)?;
        warnings.extend(mirrored);
        if unclear {
            warnings.extend(group.sides(&polished)?);
        }
    }
    monitor.end();
    group.finished(members, polished, ends, warnings)
}

/// State shared by all starts of a group's alignment.
struct Group<'a> {
    units: Vec<Unit>,
    /// Norm by which each member's coefficients of norm 1 are multiplied: the same for all members if sizes are
    /// removed, otherwise the norm before scaling.
    sizes: Vec<f64>,
    plan: Option<Plan>,
    degree: usize,
    params: &'a ProcrustesParams,
    /// Whether mirror images are matched.
    mirror: bool,
    journal: Mutex<Option<&'a mut Journal>>,
    monitor: &'a dyn Monitor,
}

impl<'a> Group<'a> {
    fn new(
        members: &[Coefficients],
        degree: usize,
        params: &'a ProcrustesParams,
        journal: Option<&'a mut Journal>,
        monitor: &'a dyn Monitor,
    ) -> Result<Self, ShapeError> {
        let units: Vec<Unit> = members.iter().map(|member| Unit::new(member, degree)).collect();
        // Spreads are sums of squares, which must neither overflow nor underflow.
        for (index, Unit { norm, .. }) in units.iter().enumerate() {
            if *norm > 0.0 && !(1e-100..=1e100).contains(norm) {
                let source = Box::new(ShapeError::Range { largest: *norm });
                return Err(ShapeError::Member { index, source });
            }
        }
        let square: f64 = units.iter().map(|unit| unit.norm * unit.norm).sum();
        let common = (square / units.len() as f64).sqrt();
        let size = |unit: &Unit| if params.align.scale && unit.norm > 0.0 { common } else { unit.norm };
        let sizes = units.iter().map(size).collect();
        let joint = params.align.method != Method::FixedParameters;
        let plan = if joint { Some(params.align.plan(degree)?) } else { None };
        monitor.begin(Stage::counted("align", "surfaces"), 0);
        let mirror = params.align.mirror;
        Ok(Self { units, sizes, plan, degree, params, mirror, journal: Mutex::new(journal), monitor })
    }

    /// Aligns every member to a template by a search of all rotations.
    fn brought_to(&self, template: usize) -> Result<Round, ShapeError> {
        let target = Target::new(self.units[template].rows.clone());
        self.round(|index| self.searched(index, &target, self.mirror))
    }

    /// Applies to each member the pose that `pose` returns for its index, and computes the new mean and spread.
    fn round(&self, pose: impl Fn(usize) -> Pose + Sync) -> Result<Round, ShapeError> {
        let poses = self.each(pose)?;
        let member =
            |(index, pose): (usize, Pose)| Member::new(&self.units[index], self.sizes[index], pose, self.plan.as_ref());
        let members: Vec<Member> = poses.into_par_iter().enumerate().map(member).collect();
        let mean = mean_of(&members);
        Ok(Round { spread: spread_of(&members, &mean), members, mean })
    }

    /// Returns one pose per member. Poses that are still in the journal are used first. The remaining poses are
    /// computed by `pose` and added to the journal.
    fn each(&self, pose: impl Fn(usize) -> Pose + Sync) -> Result<Vec<Pose>, ShapeError> {
        let (count, mut journal) = (self.units.len(), self.journal.lock().unwrap_or_else(PoisonError::into_inner));
        let mut poses = journal.as_mut().map_or_else(Vec::new, |journal| journal.take(count));
        self.monitor.step(poses.len() as u64);
        while poses.len() < count {
            let end = if journal.is_some() { count.min(poses.len() + KEPT) } else { count };
            let one = |index: usize| -> Result<Pose, ShapeError> {
                let pose = pose(index);
                // An interrupted search returns an invalid pose, so check for interruption before the pose is used.
                self.monitor.check()?;
                self.monitor.step(1);
                Ok(pose)
            };
            let found: Result<Vec<Pose>, ShapeError> = (poses.len()..end).into_par_iter().map(one).collect();
            let found = found?;
            if let Some(journal) = journal.as_mut() {
                journal.add(&found)?;
            }
            poses.extend(found);
        }
        Ok(poses)
    }

    fn space(&self, mirror: bool) -> Space {
        if self.params.align.method == Method::Surfaces { Space::Fixed } else { Space::free(mirror) }
    }

    fn searched(&self, index: usize, target: &Target, mirror: bool) -> Pose {
        let unit = &self.units[index];
        if unit.norm == 0.0 || target.rows.iter().flatten().all(|&v| v == 0.0) {
            return Pose { fit: nothing_to_turn(), antipodal: false };
        }
        match &self.plan {
            Some(plan) => {
                let found = plan.search(unit, target, self.space(mirror), &OnlyCancel(self.monitor));
                Pose { fit: found.fit, antipodal: found.antipodal }
            }
            None => Pose { fit: object_only(&unit.rows, &target.rows, mirror), antipodal: false },
        }
    }

    /// Refines the pose of every member once against the mean. If `anew` is set, also searches each pose anew, and
    /// keeps the pose that is nearer to the mean.
    fn to_mean(&self, round: &Round, anew: bool) -> Result<Round, ShapeError> {
        let target = round.target();
        let mirror = self.mirror;
        self.round(|index| {
            let now = &round.members[index].pose;
            let (Some(plan), true) = (&self.plan, self.units[index].norm > 0.0) else {
                return self.searched(index, &target, mirror);
            };
            let other = now.antipodal.then(|| self.units[index].antipodal());
            let unit = other.as_ref().unwrap_or(&self.units[index]);
            let fit = plan.continued(unit, &target, now.fit.rotation, self.space(mirror), &OnlyCancel(self.monitor));
            let continued = Pose { fit, antipodal: now.antipodal };
            let searched = anew.then(|| self.searched(index, &target, mirror));
            // A pose found by the new search replaces the member's pose only if it is nearer by more than rounding
            // error.
            searched.filter(|pose| pose.fit.distance < fit.distance * (1.0 - 1e-9)).unwrap_or(continued)
        })
    }

    /// Repeats rounds until the spread stops falling, even after a new search. Returns the last round, the number of
    /// rounds, and, if the maximum number of rounds was reached, the last relative change of the spread.
    fn settle(&self, start: Round) -> Result<(Round, usize, Option<f64>), ShapeError> {
        let (mut round, mut anew, mut change) = (start, false, 0.0);
        for rounds in 1..=self.params.max_rounds {
            let next = self.to_mean(&round, anew)?;
            change = (round.spread - next.spread) / round.spread.max(f64::MIN_POSITIVE);
            let rests = change < self.params.tolerance;
            round = next;
            // A spread as small as the rounding errors of the surfaces can't be reduced further.
            if (rests && (anew || self.plan.is_none())) || round.spread <= 1e-14 * round.size() {
                return Ok((round, rounds, None));
            }
            anew = rests;
        }
        Ok((round, self.params.max_rounds, Some(change)))
    }

    /// Repeats rounds of refinement until no member moves.
    fn polished(&self, mut round: Round) -> Result<Round, ShapeError> {
        for _ in 0..self.params.max_rounds {
            let next = self.to_mean(&round, false)?;
            let moved = next.moved_from(&round);
            round = next;
            if moved < 1e-10 {
                break;
            }
        }
        Ok(round)
    }

    /// Returns warnings about members whose rotations are undetermined.
    fn of_members(&self, round: &Round) -> Vec<ProcrustesWarning> {
        let target = round.target();
        let mean_norm = target.rows.as_flattened().iter().map(|v| v * v).sum::<f64>();
        let of = |index: usize| {
            let (unit, pose) = (&self.units[index], &round.members[index].pose);
            let warning = undetermined(&pose.fit, unit.norm.min(mean_norm), &self.params.align);
            warning.map(|warning| ProcrustesWarning::Member { member: index, warning })
        };
        (0..self.units.len()).filter_map(of).collect()
    }

    /// Returns the members centred, but not rotated.
    fn as_given(&self) -> Vec<Member> {
        let still = |unit: &Unit| Member::new(unit, unit.norm, Pose { fit: nothing_to_turn(), antipodal: false }, None);
        self.units.iter().map(still).collect()
    }

    /// Rotates the mean and all members into the frame of the mean's first-order ellipsoid, and returns the result.
    fn finished(
        &self,
        originals: &[Coefficients],
        round: Round,
        ends: Vec<TemplateEnd>,
        mut warnings: Vec<ProcrustesWarning>,
    ) -> Result<Procrustes, ShapeError> {
        let as_coefficients =
            |rows: &[[f64; 3]]| Coefficients::new(Array2::from_shape_fn((rows.len(), 3), |(k, c)| rows[k][c]));
        let mean = as_coefficients(&round.mean)?;
        let members: Vec<ArrayView2<'_, f64>> = round
            .members
            .iter()
            .map(|member| ArrayView2::from_shape((member.rows.len(), 3), member.rows.as_flattened()))
            .collect::<Result<_, _>>()
            .unwrap_or_default();
        let mirrored: Vec<usize> = warnings.iter().flat_map(|warning| warning.mirrored().iter().copied()).collect();
        let surfaces = surface_poses(&members, &mean, &mirrored, self.monitor)?;
        warnings.extend(surfaces.warnings.into_iter().map(ProcrustesWarning::Surfaces));
        let mut frame = EllipsoidFrame::of(&mean)?;
        if self.plan.is_none() {
            frame.rotation = Rotation::IDENTITY;
        }
        if frame.ratio() < LEAST_RATIO {
            warnings.push(ProcrustesWarning::NearlyRound { ratio: frame.ratio() });
        }
        let mean = frame.transform().apply(&mean, &OnlyCancel(self.monitor))?;
        let transforms = round.members.iter().enumerate().map(|(index, member)| {
            let norm = self.units[index].norm;
            let orthogonal = product(&frame.object.matrix(), &member.pose.fit.orthogonal);
            let scale = if norm > 0.0 { self.sizes[index] / norm } else { 1.0 };
            let similarity = Similarity { orthogonal, scale, translation: [0.0; 3] };
            let centre = std::array::from_fn(|c| originals[index].values()[[0, c]] / SQRT_4_PI);
            let similarity = Similarity { translation: similarity.apply(centre).map(|v| -v), ..similarity };
            Transform {
                rotation: frame.rotation * member.pose.fit.rotation,
                antipodal: member.pose.antipodal,
                similarity,
            }
        });
        let transforms: Vec<Transform> = transforms.collect();
        let given = self.as_given();
        let report = ProcrustesReport {
            degree: self.degree,
            spread_before: spread_of(&given, &mean_of(&given)),
            spread_after: round.spread,
            rmsd: round.distances(),
            surface_distances: surfaces.distances,
            ends,
            warnings,
        };
        Ok(Procrustes { transforms, mean, report })
    }
}

#[cfg(test)]
mod tests;
