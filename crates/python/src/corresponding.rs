//! Defines groups of surfaces whose vertices correspond.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use rayon::prelude::*;
use serde_json::{Value, json};
use spharm::correspond::{
    CorrespondParams, CorrespondWarning, Group as Inner, GroupFiles, IDENTICAL_TO, Joining, MemberOrigin, MemberReport,
    NewMember,
};
use spharm::model::made;
use spharm::pose::PoseParams;
use spharm::shape::groupwise::{GroupwiseReport, StageReport};
use spharm::shape::{Rotation, Similarity, Transform};
use spharm::{Error, Kind, Model as InnerModel, Stage};

use crate::arrays::{FacesOut, Positions, PositionsOut, mesh_arrays, positions, rows};
use crate::models::Model;
use crate::run::{run, run_owned};
use crate::sources::{Given, Source, named, sources};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Group>()?;
    Ok(())
}

/// Returns a similarity as JSON. If the similarity contains a reflection, the transform also replaces each direction of
/// the sphere by its opposite, so that normals still point outwards.
pub(crate) fn transform(similarity: &Similarity) -> Value {
    Transform { rotation: Rotation::IDENTITY, antipodal: similarity.mirrors(), similarity: *similarity }.to_json()
}

/// A group of surfaces, the members, whose vertices correspond. Objects of this class are immutable.
#[pyclass(frozen, module = "spharm_rs._core")]
pub(crate) struct Group {
    inner: Arc<Inner>,
    names: Vec<String>,
    /// The group's settings, as needed to add new members.
    params: CorrespondParams,
    /// Whether each member was mirrored before it was aligned.
    mirrored: Vec<bool>,
    /// Warnings, each with the index of the member that it concerns.
    warnings: Vec<(usize, String)>,
}

/// Points carried to another member, their distances from the source's surface, and whether each point has a
/// counterpart on both members.
type Carried<'py> = (PositionsOut<'py>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<bool>>);
/// A new member: its model, its transform, the positions of its vertices, whether each vertex has a counterpart on the
/// surface, and the report.
type Member<'py> = (Model, String, PositionsOut<'py>, Bound<'py, PyArray1<bool>>, String, Vec<String>);

#[pymethods]
impl Group {
    #[getter]
    fn models(&self) -> Vec<Model> {
        self.inner.models.iter().map(|inner| Model { inner: inner.clone() }).collect()
    }

    #[getter]
    fn mean(&self) -> Model {
        let template = &self.inner.template;
        let mean = made(template.mean.clone(), Kind::Surface, "shape correspond");
        Model { inner: InnerModel { sphere: Some(template.sphere.clone()), ..mean } }
    }

    /// Returns the transforms of all members, as a JSON array.
    #[getter]
    fn transforms(&self) -> String {
        json!(self.inner.similarities.iter().map(transform).collect::<Vec<_>>()).to_string()
    }

    /// Returns the positions of the n corresponding vertices on each of the N members, as an (N, n, 3) array.
    #[getter]
    fn places<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let (members, n) = self.size();
        let values: Vec<f64> = self.inner.places.iter().flatten().flatten().copied().collect();
        Array3::from_shape_vec((members, n, 3), values).expect("each member has n places").into_pyarray(py)
    }

    /// Returns an (N, n) boolean array: whether each of the N members' surfaces has a counterpart of each of the n
    /// vertices.
    #[getter]
    fn reached<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<bool>> {
        let values: Vec<bool> = self.inner.reached.iter().flatten().copied().collect();
        Array2::from_shape_vec(self.size(), values).expect("each member has n places").into_pyarray(py)
    }

    /// Returns, for each vertex of the template, whether it has no counterparts on the members, as a boolean array.
    #[getter]
    fn masked<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<bool>> {
        self.inner.template.masked.clone().into_pyarray(py)
    }

    #[getter]
    fn sphere<'py>(&self, py: Python<'py>) -> (PositionsOut<'py>, FacesOut<'py>) {
        mesh_arrays(py, self.inner.template.sphere.to_mesh())
    }

    #[getter]
    fn warnings(&self) -> Vec<String> {
        let moved = self.names.iter().zip(&self.inner.similarities);
        let members: Vec<(&str, bool)> = moved.map(|(name, moved)| (name.as_str(), moved.mirrors())).collect();
        let of_group = self.inner.report.of_group(&members);
        let of_members = self.warnings.iter().map(|(member, text)| format!("{}: {text}", self.names[*member]));
        of_group.into_iter().chain(of_members).collect()
    }

    /// Returns, for each direction, whether the template's nearest vertex has counterparts on the members.
    fn kept_at(&self, directions: Positions<'_>) -> PyResult<Vec<bool>> {
        Ok(self.inner.template.kept_at(&rows("directions", directions.as_array())?))
    }

    /// Writes the group to a folder. `names` are used as the names of the members' files.
    fn write(&self, py: Python<'_>, folder: PathBuf, names: Vec<String>, overwrite: bool) -> PyResult<()> {
        let of = |(member, name): (usize, &String)| MemberOrigin {
            name: name.clone(),
            input: None,
            mirrored: self.mirrored.get(member) == Some(&true),
            axes: None,
            warnings: self.warnings.iter().filter(|(of, _)| *of == member).map(|(_, text)| text.clone()).collect(),
        };
        let origins: Vec<MemberOrigin> = names.iter().enumerate().map(of).collect();
        run(py, Some(1), None, |_| Ok(self.inner.write(&folder, &origins, overwrite)?))
    }

    /// Reads a group from a folder. Also returns the names of its members. If `names` are given, they replace the names
    /// in the folder.
    #[staticmethod]
    fn read(py: Python<'_>, folder: PathBuf, names: Option<Vec<String>>) -> PyResult<(Self, Vec<String>)> {
        let (inner, own, mirrored, warnings) = run(py, Some(1), None, |_| {
            let files = GroupFiles::open(&folder)?;
            let (mut mirrored, mut warnings) = (Vec::new(), Vec::new());
            for (member, name) in files.names().iter().enumerate() {
                let origin = GroupFiles::origin(&folder, name)?.unwrap_or_default();
                mirrored.push(origin.mirrored);
                warnings.extend(origin.warnings.into_iter().map(|text| (member, text)));
            }
            Ok((files.group()?, files.names().to_vec(), mirrored, warnings))
        })?;
        let names = names.unwrap_or(own);
        let scale = inner.similarities.iter().any(|own| own.scale != 1.0);
        let mirror = inner.similarities.iter().zip(&mirrored).any(|(own, first)| own.mirrors() != *first);
        let given = |own: &Similarity| *own == Similarity::default() || *own == Similarity::reflection();
        let kept = inner.similarities.iter().all(given);
        let pose = PoseParams { scale, mirror: mirror && !kept, ..PoseParams::default() };
        let params = of_new_members(&inner, pose, kept);
        Ok((Self { inner: Arc::new(inner), names: names.clone(), params, mirrored, warnings }, names))
    }

    /// Returns the report on the correspondence, as JSON.
    #[getter]
    fn report(&self) -> String {
        let report = &self.inner.report;
        let seconds: serde_json::Map<String, Value> =
            report.seconds.iter().map(|(name, seconds)| ((*name).to_owned(), json!(seconds))).collect();
        let report = json!({
            "template": report.template.map(|index| &self.names[index]),
            "changes": report.changes,
            "spread": self.inner.template.spread,
            "members": report.members,
            "guide": report.guide,
            "refinement": report.refinement.as_ref().map(refinement),
            "seconds": seconds,
        });
        report.to_string()
    }

    /// Carries points on member `source` to the corresponding points on member `target`. Also returns the distances of
    /// the given points from the source's surface, and whether each point has a counterpart on both members.
    fn carry<'py>(
        &self,
        py: Python<'py>,
        points: Positions<'py>,
        source: usize,
        target: usize,
    ) -> PyResult<Carried<'py>> {
        let points = rows("points", points.as_array())?;
        let group = &*self.inner;
        let found = run(py, Some(1), None, |_| Ok(group.carry(&points, source, target)?))?;
        let off: Vec<f64> = found.iter().map(|carried| carried.off).collect();
        let reached: Vec<bool> = found.iter().map(|carried| carried.reached).collect();
        let places = found.into_iter().map(|carried| carried.point).collect();
        Ok((positions(py, places), off.into_pyarray(py), reached.into_pyarray(py)))
    }

    /// Returns warnings about landmarks that seem to be swapped or misplaced, each with the index of its member.
    /// `landmarks` has the landmarks of each member, in the member's own frame, and `labels` their names.
    fn misplaced_landmarks(
        &self,
        py: Python<'_>,
        landmarks: Vec<Positions<'_>>,
        labels: Vec<String>,
    ) -> PyResult<Vec<(usize, String)>> {
        let landmarks = landmarks.iter().map(|own| rows("landmarks", own.as_array())).collect::<PyResult<Vec<_>>>()?;
        let group = &*self.inner;
        let found = run(py, None, None, |_| Ok(group.misplaced_landmarks(&landmarks)?))?;
        let name = |landmark: usize| labels.get(landmark).cloned().unwrap_or_else(|| landmark.to_string());
        Ok(found.into_iter().map(|warning| (warning.member, warning.of_member(name))).collect())
    }

    /// Adds surfaces to the group as new members, without changing the existing members. The group is prepared only
    /// once for all surfaces.
    #[pyo3(signature = (surfaces, names, *, mirrored, threads = None, progress = None))]
    fn add<'py>(
        &self,
        py: Python<'py>,
        surfaces: Vec<Given<'py>>,
        names: Vec<String>,
        mirrored: bool,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Vec<Member<'py>>> {
        let surfaces = sources(surfaces, &names)?;
        let (group, params) = (Arc::clone(&self.inner), self.params.clone());
        let found = run_owned(py, threads, progress.as_ref(), move |monitor| {
            let members: Vec<_> = group.models.iter().map(|model| model.coefficients.clone()).collect();
            let joining = Joining::new(group.template.clone(), &members, &params, monitor)?;
            monitor.begin(Stage::counted("new members", "surfaces"), surfaces.len() as u64);
            let one = |(index, source): (usize, &Source)| {
                let add = if mirrored { Joining::add_mirrored } else { Joining::add };
                let found = source.read().and_then(|surface| add(&joining, &surface, monitor));
                monitor.step(1);
                found.map_err(|error| Error::Member { index, source: Box::new(error) })
            };
            // Compute all members before returning an error, so that the first error in order is returned, regardless
            // of the timing of the threads.
            let found: Vec<Result<NewMember, Error>> = surfaces.par_iter().enumerate().map(one).collect();
            monitor.end();
            found.into_iter().collect::<Result<Vec<_>, _>>().map_err(|error| named(&names, error))
        })?;
        let out = |NewMember { model, similarity, places, reached, report, warnings }| {
            let report: MemberReport = report;
            let same = self.inner.report.members.iter().position(|member| member.same_surface(&report));
            let same = same.map(|member| format!("{IDENTICAL_TO}{}", self.names[member]));
            let (similarity, report) = (transform(&similarity).to_string(), json!(report).to_string());
            // The closure is never called: only the warning about identical members mentions another member, and this
            // warning is issued only for new groups.
            let warnings = warnings.iter().map(|of: &CorrespondWarning| of.of_member(|_| String::new()));
            let warnings = same.into_iter().chain(warnings);
            let (places, reached) = (positions(py, places), reached.into_pyarray(py));
            (Model { inner: model }, similarity, places, reached, report, warnings.collect())
        };
        Ok(found.into_iter().map(out).collect())
    }
}

fn of_new_members(group: &Inner, pose: PoseParams, keep_poses: bool) -> CorrespondParams {
    CorrespondParams::up_to(group.template.mean.max_degree()).with_pose(pose).with_keep_poses(keep_poses)
}

impl Group {
    /// Wraps a group for Python, together with the settings that it was made with.
    pub(crate) fn new(inner: Inner, names: Vec<String>, params: CorrespondParams) -> Self {
        let of = |warning: &CorrespondWarning| (warning.member(), warning.of_member(|other| names[other].clone()));
        let warnings = inner.report.warnings.iter().map(of).collect();
        let mirrored = params.mirrored;
        let params = of_new_members(&inner, params.pose, params.keep_poses);
        Self { inner: Arc::new(inner), names, params, mirrored, warnings }
    }

    /// Returns the number of members and the number of corresponding vertices.
    fn size(&self) -> (usize, usize) {
        (self.inner.places.len(), self.inner.template.masked.len())
    }
}

fn refinement(found: &GroupwiseReport) -> Value {
    let stage = |stage: &StageReport| {
        json!({
            "max_degree": stage.stage.max_degree,
            "field_degree": stage.stage.field_degree,
            "steps": stage.steps,
            "evaluations": stage.evaluations,
            "cost": stage.cost,
            "variance": stage.variance,
            "converged": stage.converged,
            "log_area": {
                "rms": stage.distortion.rms,
                "most": stage.distortion.most,
                "within_eight": stage.distortion.within_eight,
            },
        })
    };
    json!({ "stages": found.stages.iter().map(stage).collect::<Vec<_>>(), "moved": found.moved })
}
