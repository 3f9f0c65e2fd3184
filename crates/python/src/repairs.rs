//! Repairs meshes.

use pyo3::prelude::*;
use serde_json::{Value, json};
use spharm::parametrize::{Input, defects};
use spharm::{MappedSurface, Preparation};

use crate::arrays::{Faces, FacesOut, Positions, PositionsOut, mesh, mesh_arrays};
use crate::run::run_owned;

pub(crate) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(repair, module)?)?;
    Ok(())
}

/// Changes to a mesh before it is mapped, as passed from Python: whether to repair the mesh, the largest fraction of
/// its area that the repair may remove or add, the number of voxels of a wrap, and whether to cut handles.
#[derive(Clone, Copy, FromPyObject)]
pub(crate) struct Changes(bool, Option<f64>, Option<usize>, bool);

impl From<Changes> for Preparation {
    fn from(Changes(fix, largest_repair, wrap, cut_handles): Changes) -> Self {
        Self { fix, largest_repair, wrap, cut_handles, ..Self::default() }
    }
}

/// A repaired mesh as returned to Python: vertices, triangles, report as JSON, and a description of the changes.
type Repaired<'py> = (PositionsOut<'py>, FacesOut<'py>, String, String);

#[pyfunction]
#[pyo3(signature = (vertices, faces, *, largest_repair, wrap))]
fn repair<'py>(
    py: Python<'py>,
    vertices: Positions<'py>,
    faces: Faces<'py>,
    largest_repair: Option<f64>,
    wrap: Option<usize>,
) -> PyResult<Repaired<'py>> {
    let given = mesh("surface", &vertices, &faces)?;
    let (mesh, repair, problems) = run_owned(py, Some(1), None, move |monitor| {
        let changes = Preparation { fix: true, largest_repair, wrap, ..Preparation::default() };
        let repaired = changes.apply(Input::Mesh(given), monitor)?;
        let repair = repaired.mesh_repair().copied().unwrap_or_default();
        let mesh = repaired.mesh().cloned().unwrap_or_default();
        let (mut problems, handles) = defects(&mesh);
        problems.extend((handles > 0).then(|| match handles {
            1 => "the surface has a handle (genus 1)".to_owned(),
            _ => format!("the surface has {handles} handles (genus {handles})"),
        }));
        Ok((mesh, repair, problems))
    })?;
    let mut report = json!(repair);
    if let Some(report) = report.as_object_mut() {
        report.insert("problems".to_owned(), json!(problems));
    }
    let (vertices, faces) = mesh_arrays(py, mesh);
    Ok((vertices, faces, report.to_string(), repair.changes()))
}

/// Returns the report on the map of a surface. It includes the reports on the surface's repair and on the handles that
/// were cut.
pub(crate) fn map_report(mapped: &MappedSurface) -> Value {
    let mut report = json!(mapped.parametrized.map.report);
    if let Some(report) = report.as_object_mut() {
        report.extend(mapped.handles.as_ref().map(|handles| ("handles".to_owned(), json!(handles))));
        report.extend(mapped.mesh_repair.map(|repair| ("mesh_repair".to_owned(), json!(repair))));
    }
    report
}
