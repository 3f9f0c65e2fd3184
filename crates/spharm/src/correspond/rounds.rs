//! Computes poses, runs the rounds of registration, and assembles the group.

use std::time::Instant;

use rayon::prelude::*;
use spharm_monitor::{Monitor, OnlyCancel, Stage};
use spharm_register::{Registered, Subject, Template, register};
use spharm_surface::geometry::Vec3;
use spharm_surface::pose::{
    GroupPoseWarning, GroupPoses, Pose, PoseParams, PoseSearch, PoseSurface, ScaledPose, group_poses, pose,
};
use spharm_surface::{AxesDiffer, Mesh, Similarity, Sphere};

use super::fits::Fitted;
use super::frames::to_final;
use super::guide::{GuideLandmarks, Guided, PoseByLandmarks, Verdict};
use super::params::CorrespondParams;
use super::report::{CorrespondReport, CorrespondWarning, MemberReport, UNREACHED, close};
use super::subjects::Subjects;
use super::template::MappedTemplate;
use super::together::{mean as mean_of, mesh_of, spread, together, weights};
use super::{Group, GroupTemplate};
use crate::Error;

/// Largest share of the template's directions that may lack a counterpart on a member without a warning.
const LACKING: f64 = 0.05;

/// Poses of the subjects, the index of the subject that is the first template, and warnings about poses.
struct Posed {
    /// Maps from the surfaces to the frames in which corresponding points are found. The maps include scaling if the
    /// differences in the group are explained by size (see
    /// [`GroupPoses::at_one_size`](spharm_surface::pose::GroupPoses::at_one_size)).
    similarities: Vec<Similarity>,
    distances: Vec<f64>,
    /// Area and absolute volume of each surface, in the surface's own unit.
    sizes: Vec<[f64; 2]>,
    template: Option<usize>,
    warnings: Vec<CorrespondWarning>,
    axes: Option<AxesDiffer>,
}

pub(super) fn run(subjects: &Subjects<'_>, params: &CorrespondParams, monitor: &dyn Monitor) -> Result<Group, Error> {
    let mut seconds = Vec::new();
    let mut mark = Instant::now();
    let mut lap = |name: &'static str| {
        seconds.push((name, mark.elapsed().as_secs_f64()));
        mark = Instant::now();
    };
    let Posed { mut similarities, distances, sizes, template, mut warnings, axes } = poses(subjects, params, monitor)?;
    for (index, similarity) in similarities.iter_mut().enumerate() {
        if let Some(reflection) = params.reflection(index) {
            *similarity = reflection.then(similarity);
        }
    }
    lap("poses");
    let first = match (&params.template, template) {
        (Some(given), _) => given.clone(),
        (None, index) => {
            let index = index.unwrap_or(0);
            similarities[index].apply_mesh(&(subjects.read)(index)?)
        }
    };
    let mapped = MappedTemplate::new(&first, params.subdivisions(), params.max_degree, monitor)?;
    lap("template");
    let MappedTemplate { mesh: mut shape, masked, changes } = mapped;
    let sphere = Sphere::icosphere(params.subdivisions());
    let guided = Guided::new(params.guide.as_ref(), &shape, template, &similarities)?;
    let (mut registered, mut left_out) = (Vec::new(), Vec::new());
    let mut places: Vec<Vec<Vec3>> = Vec::new();
    for round in 0..params.rounds {
        (registered, left_out) =
            register_all(subjects, &similarities, (&shape, &masked, guided.as_ref()), params, round, monitor)?;
        places = registered.iter().map(|found| found.vertices.clone()).collect();
        let (motions, mean) = together(&mut places, &sphere.faces, &masked);
        similarities = similarities.iter().zip(&motions).map(|(own, motion)| own.then(motion)).collect();
        shape = mesh_of(mean, &sphere.faces);
    }
    lap("registration");
    let of = |((found, distance), [area, volume]): ((&Registered, &f64), &[f64; 2])| MemberReport {
        turned: found.turned,
        without_counterpart: without_counterpart(found, &masked),
        area: *area,
        volume: *volume,
        ..MemberReport::new(*distance, &found.cover)
    };
    let mut members: Vec<MemberReport> = registered.iter().zip(&distances).zip(&sizes).map(of).collect();
    let mut reached: Vec<Vec<bool>> = registered.into_iter().map(|found| found.reached).collect();
    let mut fitted = Fitted::new(&sphere, places, params, monitor)?;
    lap("fits");
    let mut refinement = None;
    if let Some(settings) = &params.refinement {
        let mut settings = settings.clone();
        settings.held.extend(guided.iter().flat_map(|guided| guided.places()));
        let (report, turned) =
            fitted.refine(subjects, &similarities, (&masked, &mut reached), &settings, params, monitor)?;
        members.iter_mut().zip(turned).for_each(|(member, turned)| member.turned = turned);
        refinement = Some(report);
        lap("refinement");
    }
    let mut motions = to_final(&similarities, &mut fitted.places, (&sphere.faces, &masked), params);
    members.iter_mut().zip(&fitted.rms).for_each(|(member, rms)| member.model_rms = *rms);
    for (index, motion) in motions.iter().enumerate() {
        members[index].in_unit_of(motion.scale);
        left_out.iter_mut().skip(index).take(1).flatten().for_each(|distance| *distance *= motion.scale);
    }
    warnings.extend(of_cover(&members, &masked));
    let mean = if params.keep_poses {
        mean_of(&fitted.places)
    } else {
        let (aligned, mean) = together(&mut fitted.places, &sphere.faces, &masked);
        motions.iter_mut().zip(&aligned).for_each(|(motion, aligned)| *motion = motion.then(aligned));
        mean
    };
    // With `keep_poses`, the composition of the two motions is known exactly. Without scaling, its scale is known to be
    // exactly 1. The known values are used, because they have no rounding errors.
    let moved = |(index, (own, motion)): (usize, (&Similarity, &Similarity))| match params {
        CorrespondParams { keep_poses: true, .. } => params.reflection(index).unwrap_or_default(),
        CorrespondParams { pose: PoseParams { scale: false, .. }, .. } => Similarity { scale: 1.0, ..own.then(motion) },
        _ => own.then(motion),
    };
    similarities = similarities.iter().zip(&motions).enumerate().map(moved).collect();
    fitted.moved(&motions)?;
    let weights = weights(&fitted.places, &sphere.faces, &masked);
    let spread = spread(&fitted.places, &mean, &weights);
    let template_of_group =
        GroupTemplate { mean: fitted.mean()?, sphere, masked, spread, refined: refinement.is_some() };
    let guide = guided.map(|guided| guided.report(&fitted.places, &similarities, &left_out));
    let report = CorrespondReport { template, changes, members, warnings, axes, guide, refinement, seconds };
    Ok(Group {
        models: fitted.models(&template_of_group.sphere, &similarities),
        places: fitted.places,
        similarities,
        reached,
        template: template_of_group,
        report,
    })
}

/// Returns the poses of the surfaces. Surfaces that are to be mirrored are reflected first.
fn poses(subjects: &Subjects<'_>, params: &CorrespondParams, monitor: &dyn Monitor) -> Result<Posed, Error> {
    let surface = |index: usize, mesh: Mesh| {
        monitor.check()?;
        if let Some(guide) = &params.guide {
            guide.check_near(index, &mesh)?;
        }
        let mirrored = params.reflection(index).map(|reflection| reflection.apply_mesh(&mesh));
        let posed = PoseSurface::new(mirrored.as_ref().unwrap_or(&mesh)).ok_or(Error::NoArea)?;
        Ok((posed, mesh.meta.axes()))
    };
    let (surfaces, axes): (Vec<PoseSurface>, Vec<_>) = subjects.each(surface)?.into_iter().unzip();
    let axes = AxesDiffer::of(&axes);
    let landmarks = params.guide.as_ref().map(|guide| reflected(guide, params));
    let mut warnings = same(&surfaces);
    let sizes = surfaces.iter().map(|surface| [surface.area, surface.volume.abs()]).collect();
    let Some(template) = &params.template else {
        let mut found = group_poses(&surfaces, &params.pose, monitor)?;
        if let Some(landmarks) = landmarks {
            turn_by_landmarks(&landmarks, params, &surfaces, &mut found);
        }
        warnings.extend(found.warnings.into_iter().map(CorrespondWarning::Pose));
        // Points of members scaled to one size can't be compared with points of members at their own sizes, so either
        // all members are scaled or none.
        let explained = found.at_one_size.iter().flatten().count();
        let all = explained + 1 == surfaces.len();
        let frames = found.similarities.iter().zip(&found.at_one_size);
        return Ok(Posed {
            similarities: frames.map(|(own, scaled)| scaled.filter(|_| all).unwrap_or(*own)).collect(),
            distances: found.distances,
            sizes,
            template: Some(found.template),
            warnings,
            axes,
        });
    };
    let fixed = PoseSurface::new(template).ok_or(Error::NoArea)?;
    let quiet = OnlyCancel(monitor);
    let found = surfaces.par_iter().map(|moving| pose(moving, &fixed, &params.pose, &quiet));
    let mut found = found.collect::<Result<Vec<_>, _>>()?;
    let mut doubts: Vec<Option<(f64, f64)>> = found.iter().map(|pose| pose.doubt(0.0)).collect();
    if let Some(landmarks) = &landmarks
        && let Some(theirs) = &landmarks.template
    {
        let members = surfaces.iter().zip(&landmarks.members).zip(found.iter_mut().zip(&mut doubts));
        for ((moving, own), (pose, doubt)) in members {
            match landmarks.judge((moving, own), (&fixed, theirs), &pose.similarity, &params.pose) {
                Verdict::Undetermined => continue,
                Verdict::Confirmed => {}
                Verdict::Other(found) => {
                    let PoseByLandmarks { similarity, at_one_size, distance } = *found;
                    let at_one_size =
                        at_one_size.map(|own| ScaledPose { similarity: own, distance, second: f64::INFINITY });
                    *pose = Pose { similarity, at_one_size, distance, ..*pose };
                }
            }
            *doubt = None;
        }
    }
    for (member, doubt) in doubts.into_iter().enumerate() {
        let near = params.pose.search == PoseSearch::Near;
        let doubtful = |(distance, second)| GroupPoseWarning::Doubtful { member, distance, second, near };
        warnings.extend(doubt.map(doubtful).map(CorrespondWarning::Pose));
    }
    let all = found.iter().all(|pose| pose.at_one_size.is_some());
    let frame = |pose: &Pose| match pose.at_one_size.filter(|_| all) {
        Some(scaled) => scaled.similarity,
        None => pose.similarity,
    };
    Ok(Posed {
        similarities: found.iter().map(frame).collect(),
        distances: found.iter().map(|pose| pose.distance).collect(),
        sizes,
        template: None,
        warnings,
        axes,
    })
}

/// Returns the landmarks, with the landmarks of mirrored surfaces reflected.
fn reflected(landmarks: &GuideLandmarks, params: &CorrespondParams) -> GuideLandmarks {
    let mut landmarks = landmarks.clone();
    for (index, points) in landmarks.members.iter_mut().enumerate() {
        if let Some(reflection) = params.reflection(index) {
            points.iter_mut().for_each(|point| *point = reflection.apply(*point));
        }
    }
    landmarks
}

/// Replaces the poses of members for which the landmarks give a different rotation than the surfaces. Drops warnings
/// about these poses, and about doubtful poses that the landmarks confirm.
fn turn_by_landmarks(
    landmarks: &GuideLandmarks,
    params: &CorrespondParams,
    surfaces: &[PoseSurface],
    found: &mut GroupPoses,
) {
    let template = found.template;
    let to_group = found.similarities[template];
    let (fixed, theirs) = (&surfaces[template], &landmarks.members[template]);
    for (index, (moving, own)) in surfaces.iter().zip(&landmarks.members).enumerate() {
        let so_far = found.similarities[index].then(&to_group.inverse());
        match landmarks.judge((moving, own), (fixed, theirs), &so_far, &params.pose) {
            Verdict::Undetermined => {}
            Verdict::Confirmed => {
                let doubtful = |of: &GroupPoseWarning| matches!(of, GroupPoseWarning::Doubtful { .. });
                found.warnings.retain(|warning| warning.member() != index || !doubtful(warning));
            }
            Verdict::Other(by_landmarks) => {
                let PoseByLandmarks { similarity, at_one_size, distance } = *by_landmarks;
                (found.similarities[index], found.distances[index]) = (similarity.then(&to_group), distance);
                found.at_one_size[index] = at_one_size.map(|scaled| scaled.then(&to_group));
                let other = |of: &GroupPoseWarning| matches!(of, GroupPoseWarning::Far { .. });
                found.warnings.retain(|warning| warning.member() != index || other(warning));
            }
        }
    }
}

/// Registers a template to all members. In the last round, each registration is repeated with parts of the guiding
/// landmarks left out. Returns the registrations and the distances of the left-out landmarks.
fn register_all(
    subjects: &Subjects<'_>,
    similarities: &[Similarity],
    (shape, masked, guided): (&Mesh, &[bool], Option<&Guided<'_>>),
    params: &CorrespondParams,
    round: usize,
    monitor: &dyn Monitor,
) -> Result<(Vec<Registered>, Vec<Vec<f64>>), Error> {
    const NAMES: [&str; 2] = ["registration", "registration of the mean"];
    monitor.begin(Stage::counted(NAMES[round.min(1)], "surfaces"), subjects.count as u64);
    let quiet = OnlyCancel(monitor);
    let template = Template::new(shape, Some(masked), &params.register, &quiet)?;
    let registered = subjects.each(|index, mesh| {
        let last = guided.filter(|_| round + 1 == params.rounds);
        let sizes = (shape.vertices.len(), last.map_or(0, |guided| guided.places().len()));
        if let Some(found) = params.resume.as_ref().and_then(|kept| kept.read(round, index, sizes)) {
            monitor.step(1);
            return Ok(found);
        }
        let subject = Subject::new(&similarities[index].apply_mesh(&mesh))?;
        let guides = guided.map_or_else(Vec::new, |guided| guided.of(index, &similarities[index]));
        let found = register(&template, &subject, &guides, &params.register, &quiet)?;
        let apart = last.map(|guided| guided.left_out(&guides, &template, &subject, &params.register, &quiet));
        let apart = apart.transpose()?.unwrap_or_default();
        if let Some(kept) = &params.resume {
            kept.write(round, index, &found, &apart)?;
        }
        monitor.step(1);
        Ok((found, apart))
    })?;
    monitor.end();
    Ok(registered.into_iter().unzip())
}

fn without_counterpart(found: &Registered, masked: &[bool]) -> usize {
    found.reached.iter().zip(masked).filter(|(reached, masked)| !**reached && !**masked).count()
}

/// Returns warnings for members that the template doesn't cover completely, or that lack parts of the template.
pub(super) fn of_cover(members: &[MemberReport], masked: &[bool]) -> Vec<CorrespondWarning> {
    let all = masked.iter().filter(|masked| !**masked).count().max(1) as f64;
    let mut warnings = Vec::new();
    for (member, found) in members.iter().enumerate() {
        if found.unreached > UNREACHED {
            let (share, farthest) = (found.unreached, found.cover_farthest);
            warnings.push(CorrespondWarning::Unreached { member, share, farthest });
        }
        let share = found.without_counterpart as f64 / all;
        if share > LACKING {
            warnings.push(CorrespondWarning::Lacks { member, share });
        }
    }
    warnings
}

/// Returns warnings for members whose area and volume equal those of an earlier member within a relative difference of
/// 1e-6. Such members are taken to be the same surface, possibly moved or mirrored.
fn same(surfaces: &[PoseSurface]) -> Vec<CorrespondWarning> {
    let equal = |a: &PoseSurface, b: &PoseSurface| close(a.area, b.area) && close(a.volume.abs(), b.volume.abs());
    let earlier = |member: usize| {
        let as_member = (0..member).find(|other| equal(&surfaces[member], &surfaces[*other]))?;
        Some(CorrespondWarning::Same { member, as_member })
    };
    (1..surfaces.len()).filter_map(earlier).collect()
}
