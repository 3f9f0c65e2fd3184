//! Groups made to correspond; of one surface its pose, and a template registered to it.

use std::path::PathBuf;
use std::sync::Arc;

use numpy::ndarray::{Array2, Array3};
use numpy::{IntoPyArray, PyArray1, PyArray2, PyArray3};
use pyo3::prelude::*;
use rayon::prelude::*;
use serde_json::{Value, json};
use spharm::correspond::{CorrespondParams, Group as Inner, Joining, MemberReport, NewMember, correspond as make};
use spharm::io::read_mesh;
use spharm::model::made;
use spharm::pose::{PoseParams, PoseSurface, pose as find_pose};
use spharm::register::{RegisterParams, Subject, Template, register as move_template};
use spharm::shape::groupwise::{GroupwiseParams, GroupwiseReport, StageReport};
use spharm::shape::{Rotation, Similarity, Transform};
use spharm::{Error, Kind, Mesh, Model as InnerModel, Stage};

use crate::arrays::{Faces, FacesOut, Positions, PositionsOut, mesh, mesh_arrays, positions, rows};
use crate::errors::Failure;
use crate::models::Model;
use crate::run::{run, run_owned};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<Group>()?;
    module.add_function(wrap_pyfunction!(shape_correspond, module)?)?;
    module.add_function(wrap_pyfunction!(shape_pose, module)?)?;
    module.add_function(wrap_pyfunction!(shape_register, module)?)?;
    Ok(())
}

/// A surface as it comes from Python: a file, or vertices and triangles.
#[derive(FromPyObject)]
enum Given<'py> {
    File(PathBuf),
    Arrays(Positions<'py>, Faces<'py>),
}

/// A surface off the interpreter. Files are read when they are needed, so that a group doesn't have to fit in memory.
enum Source {
    File(PathBuf),
    Mesh(Box<Mesh>),
}

impl Given<'_> {
    fn source(self, what: &str) -> PyResult<Source> {
        Ok(match self {
            Self::File(path) => Source::File(path),
            Self::Arrays(vertices, faces) => Source::Mesh(Box::new(mesh(what, &vertices, &faces)?)),
        })
    }
}

impl Source {
    fn read(&self) -> Result<Mesh, Error> {
        match self {
            Self::File(path) => Ok(read_mesh(path)?),
            Self::Mesh(mesh) => Ok(Mesh::clone(mesh)),
        }
    }
}

fn sources(given: Vec<Given<'_>>, names: &[String]) -> PyResult<Vec<Source>> {
    given.into_iter().zip(names).map(|(given, name)| given.source(name)).collect()
}

/// Says which surface an error is of by its name.
fn named(names: &[String], error: Error) -> Failure {
    match error {
        Error::Member { index, source } => Failure::Member { name: names[index].clone(), error: source },
        error => Failure::Library(error),
    }
}

/// How a group is made to correspond: the keyword arguments of `spharm_rs.shape.correspond`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Settings {
    max_degree: usize,
    rounds: usize,
    refine: bool,
    scale: bool,
    mirror: bool,
    subdivisions: Option<u32>,
    memory: Option<usize>,
}

impl Settings {
    fn params(&self, template: Option<Mesh>) -> CorrespondParams {
        let &Self { max_degree, rounds, refine, scale, mirror, subdivisions, memory } = self;
        CorrespondParams {
            template,
            subdivisions,
            rounds,
            refinement: refine.then(GroupwiseParams::default),
            pose: PoseParams { scale, mirror, ..PoseParams::default() },
            memory,
            ..CorrespondParams::up_to(max_degree)
        }
    }
}

/// What a similarity does, as JSON; the parameters of one that mirrors are mirrored with it, so that outsides stay outside.
fn transform(similarity: &Similarity) -> Value {
    Transform { rotation: Rotation::IDENTITY, antipodal: similarity.mirrors(), similarity: *similarity }.to_json()
}

/// A group whose members correspond. It doesn't change.
#[pyclass(frozen, module = "spharm_rs._core")]
pub(crate) struct Group {
    inner: Arc<Inner>,
    names: Vec<String>,
    pose: PoseParams,
}

/// Carried points, their distances from the source, and whether both members have them.
type Carried<'py> = (PositionsOut<'py>, Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<bool>>);
/// A new member: its model, transform, places, whether each is reached, and the report.
type Member<'py> = (Model, String, PositionsOut<'py>, Bound<'py, PyArray1<bool>>, String);

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

    /// Each member's transform, as JSON.
    #[getter]
    fn transforms(&self) -> String {
        json!(self.inner.similarities.iter().map(transform).collect::<Vec<_>>()).to_string()
    }

    /// Places, (N, n, 3).
    #[getter]
    fn places<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray3<f64>> {
        let (members, n) = self.size();
        let values: Vec<f64> = self.inner.places.iter().flatten().flatten().copied().collect();
        Array3::from_shape_vec((members, n, 3), values).expect("n places a member").into_pyarray(py)
    }

    /// Whether each place has a counterpart, (N, n).
    #[getter]
    fn reached<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray2<bool>> {
        let values: Vec<bool> = self.inner.reached.iter().flatten().copied().collect();
        Array2::from_shape_vec(self.size(), values).expect("n places a member").into_pyarray(py)
    }

    /// Directions without counterparts, (n).
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
        let name = |index: usize| self.names[index].clone();
        let text = |warning: &spharm::correspond::CorrespondWarning| {
            format!("{}: {}", name(warning.member()), warning.of_member(name))
        };
        self.inner.report.warnings.iter().map(text).collect()
    }

    /// How it was found, as JSON.
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
            "refinement": report.refinement.as_ref().map(refinement),
            "seconds": seconds,
        });
        report.to_string()
    }

    /// Points on one member at the same places of another, their distances from the first, and whether both have them.
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

    /// New members, of surfaces that are prepared for together.
    #[pyo3(signature = (surfaces, names, *, threads = None, progress = None))]
    fn add<'py>(
        &self,
        py: Python<'py>,
        surfaces: Vec<Given<'py>>,
        names: Vec<String>,
        threads: Option<usize>,
        progress: Option<Bound<'py, PyAny>>,
    ) -> PyResult<Vec<Member<'py>>> {
        let surfaces = sources(surfaces, &names)?;
        let (group, pose) = (Arc::clone(&self.inner), self.pose);
        let found = run_owned(py, threads, progress.as_ref(), move |monitor| {
            let joining = Joining::new(group.template.clone(), pose, RegisterParams::default(), monitor)?;
            monitor.begin(Stage::counted("new members", "surfaces"), surfaces.len() as u64);
            let one = |(index, source): (usize, &Source)| {
                let found = source.read().and_then(|surface| joining.add(&surface, monitor));
                monitor.step(1);
                found.map_err(|error| Error::Member { index, source: Box::new(error) })
            };
            // All of them before the first error is looked for, so that it is always the same one.
            let found: Vec<Result<NewMember, Error>> = surfaces.par_iter().enumerate().map(one).collect();
            monitor.end();
            found.into_iter().collect::<Result<Vec<_>, _>>().map_err(|error| named(&names, error))
        })?;
        let out = |NewMember { model, similarity, places, reached, report }| {
            let report: MemberReport = report;
            let (similarity, report) = (transform(&similarity).to_string(), json!(report).to_string());
            (Model { inner: model }, similarity, positions(py, places), reached.into_pyarray(py), report)
        };
        Ok(found.into_iter().map(out).collect())
    }
}

impl Group {
    /// Members and places.
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

/// Surfaces made to correspond.
#[pyfunction]
#[pyo3(signature = (surfaces, names, template, *, settings, threads = None, progress = None))]
fn shape_correspond(
    py: Python<'_>,
    surfaces: Vec<Given<'_>>,
    names: Vec<String>,
    template: Option<Given<'_>>,
    settings: Settings,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Group> {
    let surfaces = sources(surfaces, &names)?;
    let template = template.map(|given| given.source("template")).transpose()?;
    run_owned(py, threads, progress.as_ref(), move |monitor| {
        let params = settings.params(template.map(|template| template.read()).transpose()?);
        let read =
            |index: usize| surfaces[index].read().map_err(|error| Error::Member { index, source: Box::new(error) });
        let found = make(surfaces.len(), &read, &params, monitor).map_err(|error| named(&names, error))?;
        Ok(Group { inner: Arc::new(found), names, pose: params.pose })
    })
}

/// A registered template, its vertices in the surface's own frame, its triangles, whether each vertex is reached, and the
/// transform that brings the surface to the template and how well it is covered, as JSON.
type Registration<'py> = (PositionsOut<'py>, FacesOut<'py>, Bound<'py, PyArray1<bool>>, String, String);

/// A template moved onto a surface.
#[pyfunction]
#[pyo3(signature = (template, surface, masked, *, pose, scale, mirror, threads = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "they are Python's keyword arguments")]
fn shape_register<'py>(
    py: Python<'py>,
    template: Given<'py>,
    surface: Given<'py>,
    masked: Option<Vec<bool>>,
    pose: bool,
    scale: bool,
    mirror: bool,
    threads: Option<usize>,
    progress: Option<Bound<'py, PyAny>>,
) -> PyResult<Registration<'py>> {
    let (template, surface) = (template.source("template")?, surface.source("surface")?);
    let (moved, reached, similarity, cover) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let (shape, mut surface) = (template.read()?, surface.read()?);
        let mut similarity = Similarity::default();
        if pose {
            let (fixed, moving) = rayon::join(|| PoseSurface::new(&shape), || PoseSurface::new(&surface));
            let (fixed, moving) =
                (fixed.ok_or_else(|| no_area("template"))?, moving.ok_or_else(|| no_area("surface"))?);
            let params = PoseParams { scale, mirror, ..PoseParams::default() };
            similarity = find_pose(&moving, &fixed, &params, monitor).map_err(Error::from)?.similarity;
            surface = similarity.apply_mesh(&surface);
        }
        let params = RegisterParams::default();
        let template = Template::new(&shape, masked.as_deref(), &params, monitor)?;
        let found = move_template(&template, &Subject::new(&surface)?, None, &params, monitor)?;
        let back = similarity.inverse();
        let cover = json!({
            "rms": found.cover.rms * back.scale,
            "most": found.cover.most * back.scale,
            "farthest": found.cover.farthest * back.scale,
            "unreached": found.cover.unreached,
            "turned": found.turned,
        });
        Ok((back.apply_mesh(&shape.with_vertices(found.vertices)), found.reached, similarity, cover))
    })?;
    let (vertices, faces) = mesh_arrays(py, moved);
    Ok((vertices, faces, reached.into_pyarray(py), transform(&similarity).to_string(), cover.to_string()))
}

fn no_area(name: &str) -> Failure {
    Failure::Member { name: name.to_owned(), error: Box::new(Error::NoArea) }
}

/// The transform that brings a surface to another, as JSON, and their distances after it and after the best other one.
#[pyfunction]
#[pyo3(signature = (surface, target, *, scale, mirror, threads = None, progress = None))]
fn shape_pose(
    py: Python<'_>,
    surface: Given<'_>,
    target: Given<'_>,
    scale: bool,
    mirror: bool,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(String, f64, f64)> {
    let (surface, target) = (surface.source("surface")?, target.source("target")?);
    let found = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let (surface, target) = (surface.read()?, target.read()?);
        let (moving, fixed) = rayon::join(|| PoseSurface::new(&surface), || PoseSurface::new(&target));
        let (moving, fixed) = (moving.ok_or_else(|| no_area("surface"))?, fixed.ok_or_else(|| no_area("target"))?);
        let params = PoseParams { scale, mirror, ..PoseParams::default() };
        Ok(find_pose(&moving, &fixed, &params, monitor).map_err(Error::from)?)
    })?;
    Ok((transform(&found.similarity).to_string(), found.distance, found.second))
}
