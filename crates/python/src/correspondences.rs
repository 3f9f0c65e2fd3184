//! Establishes the correspondence of groups, finds the poses of single surfaces, and registers a template to them.

use std::sync::Arc;

use numpy::{IntoPyArray, PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use serde_json::json;
use spharm::correspond::{CorrespondParams, GuideLandmarks, Signals, correspond as make};
use spharm::pose::{FixedSurface, PoseParams, PoseSearch, PoseSurface};
use spharm::register::{RegisterParams, Subject, Template, register as move_template};
use spharm::shape::Similarity;
use spharm::shape::groupwise::GroupwiseParams;
use spharm::{Error, Mesh};

use crate::arrays::{FacesOut, PositionsOut, mesh_arrays};
use crate::corresponding::{Group, transform};
use crate::errors::Failure;
use crate::run::run_owned;
use crate::sources::{Given, named, sources};

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(shape_correspond, module)?)?;
    module.add_function(wrap_pyfunction!(shape_pose, module)?)?;
    module.add_function(wrap_pyfunction!(shape_register, module)?)?;
    Ok(())
}

/// Keyword arguments of `spharm_rs.shape.correspond`.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
struct Settings {
    max_degree: usize,
    rounds: usize,
    refine: bool,
    /// Poses to consider: "any", "near" or "given".
    pose: String,
    scale: bool,
    mirror: bool,
    /// For each surface, whether it is mirrored before its pose is found; empty if no surface is mirrored.
    mirrored: Vec<bool>,
    subdivisions: Option<u32>,
    memory: Option<usize>,
    /// Landmarks of each member that guide the correspondence.
    guide: Option<Vec<Vec<[f64; 3]>>>,
    /// Index of the member that serves as the template.
    template_member: Option<usize>,
    /// Weights of the signals that guide the correspondence.
    weights: Vec<f64>,
}

impl Settings {
    fn params(self, template: Option<Mesh>, signals: Vec<Vec<Vec<f64>>>) -> CorrespondParams {
        let Self { max_degree, rounds, refine, pose, scale, mirror, mirrored, subdivisions, memory, .. } = self;
        let search = if pose == "any" { PoseSearch::Any } else { PoseSearch::Near };
        let of_template =
            |members: &[Vec<[f64; 3]>]| self.template_member.and_then(|index| members.get(index).cloned());
        let guide = self.guide.map(|members| GuideLandmarks { template: of_template(&members), members });
        let weights = self.weights;
        let read = move |index: usize| Ok(signals.get(index).cloned().unwrap_or_default());
        let signals = (!weights.is_empty()).then(|| Signals { weights, read: Arc::new(read) });
        CorrespondParams::up_to(max_degree)
            .with_template(template)
            .with_guide(guide)
            .with_mirrored(mirrored)
            .with_signals(signals)
            .with_subdivisions(subdivisions)
            .with_rounds(rounds)
            .with_refinement(refine.then(GroupwiseParams::default))
            .with_pose(PoseParams { search, scale, mirror, ..PoseParams::default() })
            .with_keep_poses(pose == "given")
            .with_memory(memory)
    }
}

/// Establishes correspondence between the surfaces of a group.
#[pyfunction]
#[pyo3(signature = (surfaces, names, template, *, settings, signals, threads = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
fn shape_correspond(
    py: Python<'_>,
    surfaces: Vec<Given<'_>>,
    names: Vec<String>,
    template: Option<Given<'_>>,
    settings: Settings,
    signals: Vec<Vec<PyReadonlyArray1<'_, f64>>>,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<Group> {
    let surfaces = sources(surfaces, &names)?;
    let template = template.map(|given| given.source("template")).transpose()?;
    let signals = signals.iter().map(|own| own.iter().map(|values| values.as_array().to_vec()).collect()).collect();
    run_owned(py, threads, progress.as_ref(), move |monitor| {
        let params = settings.params(template.map(|template| template.read()).transpose()?, signals);
        let read =
            |index: usize| surfaces[index].read().map_err(|error| Error::Member { index, source: Box::new(error) });
        let found = make(surfaces.len(), &read, &params, monitor).map_err(|error| named(&names, error))?;
        Ok(Group::new(found, names, params))
    })
}

/// A template that was registered to a surface: its vertices in the frame of the surface; its triangles; whether each
/// vertex has a counterpart on the surface; as JSON, the transform of the surface to the template, and the distances of
/// the surface from the registered template; warnings.
type Registration<'py> = (PositionsOut<'py>, FacesOut<'py>, Bound<'py, PyArray1<bool>>, String, String, Vec<String>);

/// Registers a template to a surface: moves the template's vertices onto the surface.
#[pyfunction]
#[pyo3(signature = (template, surface, masked, *, pose, scale, mirror, threads = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
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
    let (moved, reached, similarity, cover, mirrored) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let (shape, mut surface) = (template.read()?, surface.read()?);
        let (mut similarity, mut mirrored) = (Similarity::default(), None);
        if pose {
            let (fixed, moving) = rayon::join(|| FixedSurface::new(&shape), || PoseSurface::new(&surface));
            let (fixed, moving) =
                (fixed.ok_or_else(|| no_area("template"))?, moving.ok_or_else(|| no_area("surface"))?);
            let params = PoseParams { scale, mirror, ..PoseParams::default() };
            let (found, doubt) = fixed.pose(&moving, &params, monitor).map_err(Error::from)?;
            (similarity, mirrored) = (found.similarity, doubt);
            surface = similarity.apply_mesh(&surface);
        }
        let params = RegisterParams::default();
        let template = Template::new(&shape, masked.as_deref(), &params, monitor)?;
        let found = move_template(&template, &Subject::new(&surface)?, &[], &params, monitor)?;
        let back = similarity.inverse();
        let cover = json!({
            "rms": found.cover.rms * back.scale,
            "most": found.cover.most * back.scale,
            "farthest": found.cover.farthest * back.scale,
            "unreached": found.cover.unreached,
            "turned": found.turned,
        });
        let moved = back.apply_mesh(&shape.with_vertices(found.vertices));
        Ok((moved, found.reached, similarity, cover, mirrored))
    })?;
    let (vertices, faces) = mesh_arrays(py, moved);
    let (reached, warnings) = (reached.into_pyarray(py), mirrored.iter().map(ToString::to_string).collect());
    Ok((vertices, faces, reached, transform(&similarity).to_string(), cover.to_string(), warnings))
}

fn no_area(name: &str) -> Failure {
    Failure::Member { name: name.to_owned(), error: Box::new(Error::NoArea) }
}

/// Finds the transform that moves a surface onto another one. Returns the transform as JSON, the distance between the
/// surfaces after this transform, the distance after the best of the clearly different transforms, and warnings.
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
) -> PyResult<(String, f64, f64, Vec<String>)> {
    let (surface, target) = (surface.source("surface")?, target.source("target")?);
    let (found, mirrored) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        let (surface, target) = (surface.read()?, target.read()?);
        let (moving, fixed) = rayon::join(|| PoseSurface::new(&surface), || FixedSurface::new(&target));
        let (moving, fixed) = (moving.ok_or_else(|| no_area("surface"))?, fixed.ok_or_else(|| no_area("target"))?);
        let params = PoseParams { scale, mirror, ..PoseParams::default() };
        Ok(fixed.pose(&moving, &params, monitor).map_err(Error::from)?)
    })?;
    let warnings = mirrored.iter().map(ToString::to_string).collect();
    Ok((transform(&found.similarity).to_string(), found.distance, found.second, warnings))
}
