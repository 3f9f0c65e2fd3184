//! Fits models to the corresponding points of all members, and refines the correspondence by the group's statistics.

use ndarray::{Array2, ArrayView1, ArrayView2};
use serde_json::json;
use spharm_harmonics::{Coefficients, Directions};
use spharm_model::Model;
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_register::untangle::untangle;
use spharm_register::{RegisterParams, Subject, Template};
use spharm_shape::groupwise::{Flow, GroupwiseParams, GroupwiseReport, groupwise};
use spharm_surface::geometry::Vec3;
use spharm_surface::locator::SphereLocator;
use spharm_surface::{Kind, Mesh, Similarity, Sphere, Target};
use spharm_transform::{Transform, TransformParams};

use super::params::CorrespondParams;
use super::signals::beside;
use super::subjects::Subjects;
use super::together::mesh_of;
use crate::model::signed;
use crate::{Error, Fit, FitParams, Objective, fit_many};

/// Accuracy of the models' values at directions moved by a flow, relative to the models' coefficients.
const ACCURACY: f64 = 1e-9;

/// Corresponding points of all members, and a model fitted to the points of each member.
pub(super) struct Fitted {
    pub(super) places: Vec<Vec<Vec3>>,
    pub(super) coefficients: Vec<Coefficients>,
    /// Root mean square distance of each model from its member's points.
    pub(super) rms: Vec<f64>,
}

impl Fitted {
    pub(super) fn new(
        sphere: &Sphere,
        places: Vec<Vec<Vec3>>,
        params: &CorrespondParams,
        monitor: &dyn Monitor,
    ) -> Result<Self, Error> {
        let settings = of_fits(params);
        let read = |index: usize| {
            let mesh = mesh_of(places[index].clone(), &sphere.faces);
            Ok::<_, Error>(Target::from_mesh(&mesh, sphere)?)
        };
        let rms = |fit: &Fit| fit.report.msd.map_or(f64::NAN, f64::sqrt) * fit.report.scale.unwrap_or(1.0);
        let done = |_: usize, fit: Fit| Ok((fit.coefficients.clone(), rms(&fit)));
        let (fits, _) = fit_many(sphere, places.len(), &read, &settings, &done, monitor)?;
        let (coefficients, rms) = fits.into_iter().unzip();
        Ok(Self { places, coefficients, rms })
    }

    /// Refines the correspondence by the group's statistics: each member's points move along its surface, are projected
    /// onto it and are fitted again. Returns a report and the number of flipped triangles of each member. Updates
    /// `reached`, which states for each point of each member whether it has a counterpart on the member's surface. The
    /// corners of flipped triangles are marked as having no counterpart.
    pub(super) fn refine(
        &mut self,
        subjects: &Subjects<'_>,
        similarities: &[Similarity],
        (masked, reached): (&[bool], &mut [Vec<bool>]),
        settings: &GroupwiseParams,
        params: &CorrespondParams,
        monitor: &dyn Monitor,
    ) -> Result<(GroupwiseReport, Vec<usize>), Error> {
        let sphere = Sphere::icosphere(params.subdivisions());
        let weights: Vec<f64> = masked.iter().map(|masked| if *masked { 0.0 } else { 1.0 }).collect();
        let channels = match &params.signals {
            None => self.coefficients.iter().map(|own| own.values().clone()).collect(),
            Some(signals) => {
                let over = (&sphere, &self.places[..], masked);
                let found = signals.fitted(subjects, similarities, over, &of_fits(params), &OnlyCancel(monitor))?;
                let pairs = self.coefficients.iter().zip(&found);
                pairs.map(|(own, signals)| beside(own, signals)).collect::<Result<Vec<_>, _>>()?
            }
        };
        let members: Vec<ArrayView2<'_, f64>> = channels.iter().map(|own| own.view()).collect();
        let found = groupwise(&members, &sphere, Some(&weights), settings, monitor)?;
        // Only the template's triangles are used here, so the template is prepared without `drift`.
        let no_drift = RegisterParams { drift: Vec::new(), ..params.register.clone() };
        let shape = mesh_of(self.places[0].clone(), &sphere.faces);
        let template = Template::new(&shape, Some(masked), &no_drift, &OnlyCancel(monitor))?;
        let turned =
            self.follow(&found.flows, subjects, similarities, (&sphere, &template, reached), params, monitor)?;
        Ok((found.report, turned))
    }

    /// Moves the points of each member by that member's flow, projects them onto its surface and fits them again. See
    /// [`refine`](Self::refine).
    pub(super) fn follow(
        &mut self,
        flows: &[Flow],
        subjects: &Subjects<'_>,
        similarities: &[Similarity],
        (sphere, template, reached): (&Sphere, &Template, &mut [Vec<bool>]),
        params: &CorrespondParams,
        monitor: &dyn Monitor,
    ) -> Result<Vec<usize>, Error> {
        let over = SphereLocator::new(&mesh_of(sphere.directions.as_slice().to_vec(), &sphere.faces))?;
        let at_sphere = self.transform(&sphere.directions)?;
        let refined = subjects.each(|index, mesh: Mesh| {
            monitor.check()?;
            let at = (&at_sphere, &over);
            let (places, mut there) = self.carried(index, &flows[index], sphere, at, &reached[index])?;
            let subject = Subject::new(&similarities[index].apply_mesh(&mesh))?;
            let free: Vec<bool> = there.iter().map(|there| !there).collect();
            let rounds = params.register.untangle_rounds;
            let (places, turned) = untangle(template, &places, &free, &subject, rounds, &OnlyCancel(monitor))?;
            let corners = turned.iter().flat_map(|face| sphere.faces[*face as usize]);
            corners.for_each(|v| there[v as usize] = false);
            Ok((places, there, turned.len()))
        })?;
        let (mut places, mut turned) = (Vec::with_capacity(refined.len()), Vec::with_capacity(refined.len()));
        for ((moved, there, count), reached) in refined.into_iter().zip(reached.iter_mut()) {
            places.push(moved);
            turned.push(count);
            *reached = there;
        }
        *self = Self::new(sphere, places, params, &OnlyCancel(monitor))?;
        Ok(turned)
    }

    /// Returns a member's points at the directions to which a flow carries the sphere's directions. Also returns, for
    /// each of these points, whether it is interpolated only from points marked in `reached`. A point is the sum of the
    /// model's value and the model's residual, which is interpolated linearly within triangles. Therefore points don't
    /// move if the flow is zero. Linear interpolation of the points themselves would cause kinks.
    fn carried(
        &self,
        index: usize,
        flow: &Flow,
        sphere: &Sphere,
        (at_sphere, over): (&Transform, &SphereLocator),
        reached: &[bool],
    ) -> Result<(Vec<Vec3>, Vec<bool>), Error> {
        let model = self.coefficients[index].values().view();
        let carried = flow.apply(sphere.directions.as_slice())?;
        let before = at_sphere.synthesis(model)?;
        // Columns 0 to 2 contain the model's residual. Column 3 is 1 for the points that aren't marked in `reached`,
        // and 0 for all other points.
        let left = Array2::from_shape_fn((before.nrows(), 4), |(v, k)| match k {
            3 => f64::from(u8::from(!reached[v])),
            _ => self.places[index][v][k] - before[[v, k]],
        });
        let left = over.interpolate(left.view(), &carried)?;
        let after = self.transform(&Directions::from_vertices(&carried)?)?.synthesis(model)?;
        let of = |(model, left): (ArrayView1<'_, f64>, ArrayView1<'_, f64>)| {
            (std::array::from_fn(|k| model[k] + left[k]), left[3] == 0.0)
        };
        Ok(after.rows().into_iter().zip(left.rows()).map(of).unzip())
    }

    /// Plans the transform that evaluates the models at the given directions.
    fn transform(&self, directions: &Directions) -> Result<Transform, Error> {
        let max_degree = self.coefficients.first().map_or(0, Coefficients::max_degree);
        Ok(Transform::new(directions, &TransformParams { max_degree, accuracy: ACCURACY, channels: 3 })?)
    }

    /// Applies to each model the motion that was applied to its points.
    pub(super) fn moved(&mut self, motions: &[Similarity]) -> Result<(), Error> {
        for (own, motion) in self.coefficients.iter_mut().zip(motions) {
            *own = spharm_shape::transform_object(own, motion)?;
        }
        Ok(())
    }

    pub(super) fn mean(&self) -> Result<Coefficients, Error> {
        Ok(spharm_shape::mean(&self.coefficients)?)
    }

    pub(super) fn models(&self, sphere: &Sphere, similarities: &[Similarity]) -> Vec<Model> {
        let model = |(own, similarity): (&Coefficients, &Similarity)| {
            let mut model = signed(Model::new(sphere.clone(), own.clone(), Kind::Surface), "shape correspond");
            record_motion(&mut model, similarity);
            model
        };
        self.coefficients.iter().zip(similarities).map(model).collect()
    }
}

/// Stores the similarity to the group's frame in a member's model.
pub(super) fn record_motion(model: &mut Model, similarity: &Similarity) {
    model.provenance.other.insert("to_group".to_owned(), json!(similarity));
}

/// Returns the settings of the fits over the group's sphere. The fits use only the corresponding points, which lie on
/// the surfaces. The flat triangles between these points lie inside curved surfaces: with 642 points, a fit of the
/// triangles would lose 1 % of the volume.
fn of_fits(params: &CorrespondParams) -> FitParams {
    FitParams {
        memory: params.memory,
        objective: Objective::Vertices,
        surface_distance: false,
        ..FitParams::lsq(params.max_degree)
    }
}
