//! Adds members to a group without changing the group.

use spharm_harmonics::Coefficients;
use spharm_model::Model;
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_register::{Registered, Subject, Template, register};
use spharm_shape::groupwise::{FinishedGroup, GroupwiseParams};
use spharm_surface::geometry::Vec3;
use spharm_surface::pose::{
    CLOSE, GroupPoseWarning, NEARER_MIRRORED, OF_ANOTHER_KIND, Pose, PoseParams, PoseSearch, PoseSurface, pose,
};
use spharm_surface::{Kind, Mesh, Similarity, Sphere};

use super::GroupTemplate;
use super::fits::{Fitted, record_motion};
use super::frames::to_final;
use super::params::CorrespondParams;
use super::report::{CorrespondWarning, MemberReport};
use super::rounds::of_cover;
use super::subjects::Subjects;
use super::together::{to_mean, weights};
use crate::Error;

/// A surface that was added to a group.
#[derive(Debug, Clone)]
pub struct NewMember {
    /// Model of the surface, in the group's frame and over the group's sphere.
    pub model: Model,
    /// Similarity from the surface's own frame to the group's frame.
    pub similarity: Similarity,
    /// Points on the surface that correspond to the sphere's n directions, in the group's frame.
    pub places: Vec<Vec3>,
    /// Whether each of the n directions has a counterpart on the surface.
    pub reached: Vec<bool>,
    /// Report on the registration of the surface.
    pub report: MemberReport,
    /// Warnings, each of which is a reason to check the surface. They refer to the surface as member 0.
    pub warnings: Vec<CorrespondWarning>,
}

/// Maximum number of the group's members with which a new member is compared by distance from the mean.
const USUAL: usize = 8;

/// Number of subdivisions of the icosphere on which models are evaluated for comparisons with surfaces. With coarser
/// triangles, such as those between the directions of a group of low degree, the models would be smaller than their
/// surfaces.
const FINE: u32 = 5;

/// A group prepared for new members: data that are computed once and used for all of them.
pub struct Joining {
    group: GroupTemplate,
    template: Template,
    pose: PoseSurface,
    /// Median distances of the group's members from the mean; `None` if no members were given.
    usual: Option<FromMean>,
    params: CorrespondParams,
    /// Statistics of a refined group, used to refine the points of new members.
    finished: Option<FinishedGroup>,
}

impl Joining {
    /// Prepares a group for new members. `members` are the coefficients of the group's members, or of a few hundred of
    /// them. If the group was refined and there are at least three `members`, new members' points are refined by the
    /// mean and the modes of `members`. To find warnings, new members are compared with some of `members`. The settings
    /// of poses and registration are taken from `params`.
    ///
    /// # Errors
    ///
    /// [`Error::Setting`] if given poses are to be scaled or mirrored; [`Error::Register`] if the template can't be
    /// prepared; [`Error::NoArea`] if the mean has no area; [`Error::Shape`] if the group's statistics can't be
    /// computed; [`Error::is_interrupted`] if the monitor stopped the call.
    pub fn new(
        group: GroupTemplate,
        members: &[Coefficients],
        params: &CorrespondParams,
        monitor: &dyn Monitor,
    ) -> Result<Self, Error> {
        params.check_poses()?;
        let mean = Model::without_sphere(group.mean.clone(), Kind::Surface);
        let degree = group.mean.max_degree();
        let shape = mean.reconstruct(&group.sphere, degree)?;
        let template = Template::new(&shape, Some(&group.masked), &params.register, &OnlyCancel(monitor))?;
        let surface = surface_of(&group.mean)?;
        let params = CorrespondParams {
            pose: params.pose,
            keep_poses: params.keep_poses,
            register: params.register.clone(),
            ..CorrespondParams::up_to(degree)
        };
        let finished = if group.refined && members.len() > 2 {
            let views: Vec<_> = members.iter().map(|member| member.values().view()).collect();
            let weights: Vec<f64> = group.masked.iter().map(|masked| if *masked { 0.0 } else { 1.0 }).collect();
            let settings = GroupwiseParams::default();
            Some(FinishedGroup::new(&views, &group.sphere, Some(&weights), &settings, &OnlyCancel(monitor))?)
        } else {
            None
        };
        let usual = FromMean::usual(members, &surface, monitor)?;
        Ok(Self { group, template, pose: surface, usual, params, finished })
    }

    /// Adds the mirror image (x to -x) of a surface, as [`add`](Self::add) adds the surface itself. The similarity
    /// includes the reflection.
    ///
    /// # Errors
    ///
    /// The errors of [`add`](Self::add).
    pub fn add_mirrored(&self, surface: &Mesh, monitor: &dyn Monitor) -> Result<NewMember, Error> {
        let reflection = Similarity::reflection();
        let mut member = self.add(&reflection.apply_mesh(surface), monitor)?;
        member.similarity = reflection.then(&member.similarity);
        record_motion(&mut member.model, &member.similarity);
        Ok(member)
    }

    /// Brings a surface into correspondence with the group, and returns it as a new member. The group isn't changed.
    ///
    /// # Errors
    ///
    /// [`Error::NoArea`] if the surface has no area; [`Error::Register`] if the template can't be registered to the
    /// surface; the errors of [`fit_many`](crate::fit_many); [`Error::is_interrupted`] if the monitor stopped the call.
    pub fn add(&self, surface: &Mesh, monitor: &dyn Monitor) -> Result<NewMember, Error> {
        let quiet = OnlyCancel(monitor);
        let moving = PoseSurface::new(surface).ok_or(Error::NoArea)?;
        let posed = pose(&moving, &self.pose, &self.params.pose, &quiet)?;
        let posed_at = posed.at_one_size.map_or(posed.similarity, |scaled| scaled.similarity);
        let subject = Subject::new(&posed_at.apply_mesh(surface))?;
        let Registered { vertices, reached, cover, mut turned } =
            register(&self.template, &subject, &[], &self.params.register, &quiet)?;
        let faces = &self.group.sphere.faces;
        let mut places = vec![vertices];
        let of_mean = &self.template.mesh().vertices;
        let areas = weights(std::slice::from_ref(of_mean), faces, &self.group.masked);
        let mut similarity = posed_at.then(&to_mean(of_mean, &mut places[0], &areas));
        let mut fitted = Fitted::new(&self.group.sphere, places, &self.params, &quiet)?;
        let mut reached = [reached];
        if let Some(finished) = &self.finished {
            let (flow, _) = finished.refine(fitted.coefficients[0].values().view(), &quiet)?;
            let subjects = Subjects { count: 1, read: &|_| Ok(surface.clone()) };
            let on = (&self.group.sphere, &self.template, &mut reached[..]);
            turned = fitted.follow(&[flow], &subjects, &[similarity], on, &self.params, &quiet)?[0];
        }
        let on = (&faces[..], &self.group.masked[..]);
        let mut motion = to_final(&[similarity], &mut fitted.places, on, &self.params)[0];
        let unit = motion.scale;
        if self.params.keep_poses {
            similarity = Similarity::default();
        } else {
            if self.finished.is_some() || unit != 1.0 {
                motion = motion.then(&to_mean(of_mean, &mut fitted.places[0], &areas));
            }
            similarity = similarity.then(&motion);
            if !self.params.pose.scale {
                similarity.scale = 1.0;
            }
        }
        if motion != Similarity::default() {
            fitted.moved(&[motion])?;
        }
        let [reached] = reached;
        let without = reached.iter().zip(&self.group.masked).filter(|(reached, masked)| !**reached && !**masked);
        let mut report = MemberReport {
            turned,
            without_counterpart: without.count(),
            model_rms: fitted.rms[0],
            area: moving.area,
            volume: moving.volume.abs(),
            ..MemberReport::new(posed.distance, &cover)
        };
        report.in_unit_of(unit);
        let own = FromMean::of(&fitted.coefficients[0], &self.pose, &quiet)?;
        let mut warnings = self.doubts(surface, &posed, own, &quiet)?;
        warnings.extend(of_cover(&[report], &self.group.masked));
        let mut models = fitted.models(&self.group.sphere, &[similarity]);
        let (Some(model), Some(places)) = (models.pop(), fitted.places.into_iter().next()) else {
            return Err(Error::NoArea);
        };
        Ok(NewMember { model, similarity, places, reached, report, warnings })
    }

    /// Returns a warning if a new surface or its pose is doubtful. A surface is doubtful if its model's distance from
    /// the mean, `of_model`, is much larger than the distances of the members' models. Its pose is doubtful if another
    /// pose, or the mirror image of the surface, is nearer to the mean than the surface in its pose `posed`. If the
    /// surface differs from the mean mainly in size, it is compared with the mean after scaling.
    fn doubts(
        &self,
        surface: &Mesh,
        posed: &Pose,
        of_model: FromMean,
        monitor: &dyn Monitor,
    ) -> Result<Vec<CorrespondWarning>, Error> {
        let warnings = |warning| Ok(vec![CorrespondWarning::Pose(warning)]);
        let far = self.usual.and_then(|usual| of_model.far(&usual));
        let (distance, any) = posed.compared(&self.params.pose);
        let searched = |surface: &Mesh| -> Result<f64, Error> {
            let surface = PoseSurface::new(surface).ok_or(Error::NoArea)?;
            Ok(pose(&surface, &self.pose, &any, monitor)?.distance)
        };
        let best = if self.params.pose.search == PoseSearch::Near { searched(surface)? } else { distance };
        if !self.params.pose.mirror {
            // All poses of the mirror image are searched, so the best of them is compared with the best of all poses of
            // the surface.
            let mirrored = searched(&Similarity::reflection().apply_mesh(surface))?;
            // If a surface is much farther from the mean than the group's members are, its mirror image may be nearer
            // to the mean by chance. It must therefore be much nearer to cause a warning.
            let nearer = if far.is_some() { 1.0 / CLOSE } else { NEARER_MIRRORED };
            if mirrored < nearer * best {
                return warnings(GroupPoseWarning::Mirrored { member: 0, distance: best, mirrored });
            }
        }
        if let Some((distance, median)) = far {
            return warnings(GroupPoseWarning::Far { member: 0, distance, median });
        }
        if CLOSE * best < distance {
            return warnings(GroupPoseWarning::Elsewhere { member: 0, distance, best });
        }
        Ok(Vec::new())
    }
}

/// Distances of a model in the group's frame from the mean: at the model's own size, and at the mean's size. If the
/// sizes in a group differ, only the distance at the mean's size reveals a body of a different shape.
#[derive(Clone, Copy)]
struct FromMean {
    own: f64,
    at_one_size: f64,
}

impl FromMean {
    fn of(model: &Coefficients, mean: &PoseSurface, monitor: &dyn Monitor) -> Result<Self, Error> {
        let shape = surface_of(model)?;
        let distance = |scale: bool| -> Result<f64, Error> {
            let near = PoseParams { search: PoseSearch::Near, scale, ..PoseParams::default() };
            Ok(pose(&shape, mean, &near, &OnlyCancel(monitor))?.distance)
        };
        Ok(Self { own: distance(false)?, at_one_size: distance(true)? })
    }

    /// Returns the usual distances: the median of each of the two over at most [`USUAL`] members, evenly spaced in the
    /// list.
    fn usual(members: &[Coefficients], mean: &PoseSurface, monitor: &dyn Monitor) -> Result<Option<Self>, Error> {
        let some = members.iter().step_by(members.len().div_ceil(USUAL).max(1));
        let found = some.map(|member| Self::of(member, mean, monitor)).collect::<Result<Vec<_>, Error>>()?;
        let median = |of: fn(&Self) -> f64| {
            let mut distances: Vec<f64> = found.iter().map(of).collect();
            distances.sort_unstable_by(f64::total_cmp);
            distances.get(distances.len() / 2).copied()
        };
        Ok(median(|own| own.own).zip(median(|own| own.at_one_size)).map(|(own, at_one_size)| Self { own, at_one_size }))
    }

    /// Returns the first of the model's two distances that is much larger than usual, and the corresponding usual
    /// distance. Returns `None` if neither distance is much larger.
    fn far(&self, usual: &Self) -> Option<(f64, f64)> {
        let pairs = [(self.own, usual.own), (self.at_one_size, usual.at_one_size)];
        pairs.into_iter().find(|(distance, usual)| *usual > 0.0 && *distance > OF_ANOTHER_KIND * usual)
    }
}

/// Returns the surface of a model, prepared for poses.
fn surface_of(model: &Coefficients) -> Result<PoseSurface, Error> {
    let model = Model::without_sphere(model.clone(), Kind::Surface);
    let degree = model.coefficients.max_degree();
    PoseSurface::new(&model.reconstruct(&Sphere::icosphere(FINE), degree)?).ok_or(Error::NoArea)
}
