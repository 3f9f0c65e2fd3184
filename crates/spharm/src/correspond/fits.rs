//! Models of all members over one sphere, and their refinement by the group.

use ndarray::ArrayView2;
use serde_json::json;
use spharm_harmonics::{Coefficients, Directions};
use spharm_model::Model;
use spharm_monitor::{Monitor, OnlyCancel};
use spharm_register::untangle::untangle;
use spharm_register::{RegisterParams, Subject, Template};
use spharm_shape::groupwise::{Flow, GroupwiseParams, GroupwiseReport, groupwise};
use spharm_surface::geometry::{Vec3, add, sub};
use spharm_surface::locator::{Place, SphereLocator};
use spharm_surface::{Kind, Mesh, Similarity, Sphere, Target};
use spharm_transform::{Transform, TransformParams};

use super::params::CorrespondParams;
use super::subjects::Subjects;
use super::together::mesh_of;
use crate::model::signed;
use crate::{Error, Fit, FitParams, fit_many};

/// Accuracy of the models at carried directions, relative to the coefficients.
const ACCURACY: f64 = 1e-9;

/// The places of all members, and models of them.
pub(super) struct Fitted {
    pub(super) places: Vec<Vec<Vec3>>,
    pub(super) coefficients: Vec<Coefficients>,
    /// Root mean square distance of each model from its places.
    pub(super) rms: Vec<f64>,
}

impl Fitted {
    pub(super) fn new(
        sphere: &Sphere,
        places: Vec<Vec<Vec3>>,
        params: &CorrespondParams,
        monitor: &dyn Monitor,
    ) -> Result<Self, Error> {
        let settings =
            FitParams { memory: params.memory, surface_distance: false, ..FitParams::lsq(params.max_degree) };
        let read = |index: usize| {
            let mesh = mesh_of(places[index].clone(), &sphere.faces);
            Ok::<_, Error>(Target::from_mesh(&mesh, sphere)?)
        };
        let done = |_: usize, fit: Fit| Ok((fit.coefficients, fit.report.msd.sqrt() * fit.report.scale.unwrap_or(1.0)));
        let (fits, _) = fit_many(sphere, places.len(), &read, &settings, &done, monitor)?;
        let (coefficients, rms) = fits.into_iter().unzip();
        Ok(Self { places, coefficients, rms })
    }

    /// Refines by the group: places move along the surfaces, are projected onto them, and fitted again. Returns how, and the
    /// number of triangles of each member that are turned over; `reached` follows the places.
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
        let members: Vec<ArrayView2<'_, f64>> = self.coefficients.iter().map(|own| own.values().view()).collect();
        let found = groupwise(&members, &sphere, Some(&weights), settings, monitor)?;
        let over = SphereLocator::new(&mesh_of(sphere.directions.as_slice().to_vec(), &sphere.faces))?;
        // Of a template nothing but its triangles is needed.
        let no_drift = RegisterParams { drift: Vec::new(), ..params.register.clone() };
        let shape = mesh_of(self.places[0].clone(), &sphere.faces);
        let template = Template::new(&shape, Some(masked), &no_drift, &OnlyCancel(monitor))?;
        let refined = subjects.each(|index, mesh: Mesh| {
            monitor.check()?;
            let (places, there) = self.carried(index, &found.flows[index], &sphere, &over, &reached[index])?;
            let subject = Subject::new(&similarities[index].apply_mesh(&mesh))?;
            let free: Vec<bool> = there.iter().map(|there| !there).collect();
            let rounds = params.register.untangle_rounds;
            let (places, turned) = untangle(&template, &places, &free, &subject, rounds, &OnlyCancel(monitor))?;
            Ok((places, there, turned.len()))
        })?;
        let (mut places, mut turned) = (Vec::with_capacity(refined.len()), Vec::with_capacity(refined.len()));
        for ((moved, there, count), reached) in refined.into_iter().zip(reached.iter_mut()) {
            places.push(moved);
            turned.push(count);
            *reached = there;
        }
        *self = Self::new(&sphere, places, params, &OnlyCancel(monitor))?;
        Ok((found.report, turned))
    }

    /// The places of a member at the directions to which a flow carries those of the sphere, and whether they are reached: the
    /// model there, and what it leaves of the places, linear within triangles. So places stay where nothing is carried, and
    /// have no kinks where something is.
    fn carried(
        &self,
        index: usize,
        flow: &Flow,
        sphere: &Sphere,
        over: &SphereLocator,
        reached: &[bool],
    ) -> Result<(Vec<Vec3>, Vec<bool>), Error> {
        let carried = flow.apply(sphere.directions.as_slice())?;
        let before = self.model_at(index, &sphere.directions)?;
        let after = self.model_at(index, &Directions::from_vertices(&carried)?)?;
        let left: Vec<Vec3> =
            self.places[index].iter().zip(&before).map(|(place, model)| sub(*place, *model)).collect();
        let of = |(at, model): (&Place, &Vec3)| {
            let corners = over.corners(at).map(|v| v as usize);
            let left = std::array::from_fn(|k| (0..3).map(|i| at.barycentric[i] * left[corners[i]][k]).sum());
            (add(*model, left), (0..3).all(|i| at.barycentric[i] == 0.0 || reached[corners[i]]))
        };
        Ok(over.locate_all(&carried)?.iter().zip(&after).map(of).unzip())
    }

    fn model_at(&self, index: usize, directions: &Directions) -> Result<Vec<Vec3>, Error> {
        let own = &self.coefficients[index];
        let params = TransformParams { max_degree: own.max_degree(), accuracy: ACCURACY, channels: 3 };
        let values = Transform::new(directions, &params)?.synthesis(own.values().view())?;
        Ok(values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect())
    }

    /// Moves the models as their places were.
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
            let transform = json!({
                "orthogonal": similarity.orthogonal,
                "scale": similarity.scale,
                "translation": similarity.translation,
            });
            model.provenance.other.insert("to_group".to_owned(), transform);
            model
        };
        self.coefficients.iter().zip(similarities).map(model).collect()
    }
}
