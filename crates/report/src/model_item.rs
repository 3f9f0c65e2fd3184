//! Prepares a model for a page: its coefficients, the directions at which it is evaluated, and the surface for
//! comparison.

use serde::Serialize;
use spharm_model::Model;
use spharm_monitor::Monitor;
use spharm_render::{Paint, Panel};
use spharm_surface::metrics::{correspond, distances_to_surface, vertex_distances};
use spharm_surface::{Mesh, Sphere};

use crate::ReportError;
use crate::blocks::{Block, Blocks};
use crate::contents::Shown;
use crate::grid::{Grid, icosphere_for};
use crate::still::still;

/// A model, in the form in which the page's script reads it.
#[derive(Debug, Serialize)]
pub(crate) struct ModelItem {
    kind: &'static str,
    name: String,
    degree: usize,
    grid: Grid,
    coefficients: Block,
    reference: Reference,
}

/// Reference surface from which the page measures the displayed model's distances.
#[derive(Debug, Serialize)]
#[serde(tag = "kind", rename_all = "lowercase")]
enum Reference {
    /// The model itself at its highest degree.
    Model,
    /// A surface with the same triangles, given by the offset of each vertex from the model at its highest degree, in
    /// steps.
    Vertices { name: String, offsets: Block, step: f64 },
    /// A surface with other triangles, with the distance of each vertex of the model at its highest degree from the
    /// nearest point of the surface. The distance is NaN for vertices that were added to close cut handles, because
    /// they have no counterpart on the surface.
    Surface { name: String, mesh: Option<Drawn>, distances: Block },
}

/// A mesh with fixed positions, in the form in which the page's script reads it.
#[derive(Debug, Serialize)]
pub(crate) struct Drawn {
    grid: Grid,
    positions: Block,
}

impl Drawn {
    pub(crate) fn new(mesh: &Mesh, blocks: &mut Blocks) -> Self {
        Self {
            grid: Grid::of_faces(mesh.vertices.len(), &mesh.faces, blocks),
            positions: blocks.f32(mesh.vertices.as_flattened().iter().copied()),
        }
    }
}

/// Item of a model, with the model's picture and its distances from the surface, if any.
pub(crate) struct Made {
    pub(crate) item: ModelItem,
    /// Picture of the model as PNG.
    pub(crate) still: Vec<u8>,
    /// Root mean square and largest distance from the surface, if any.
    pub(crate) errors: Option<[f64; 2]>,
}

impl ModelItem {
    /// Creates the item of a model, its picture and its distances.
    pub(crate) fn make(
        shown: &Shown,
        max_vertices: usize,
        blocks: &mut Blocks,
        monitor: &dyn Monitor,
    ) -> Result<Made, ReportError> {
        let Shown { name, model, surface, .. } = shown;
        let degree = model.coefficients.max_degree();
        let sphere = sphere_of(model, max_vertices);
        let of_model = |source| ReportError::Model { name: name.clone(), source };
        let of_surface = |source| ReportError::Surface { name: name.clone(), source };
        let mesh = model.reconstruct(&sphere, degree).map_err(of_model)?;
        let (mut distances, mut reference) = (None, Reference::Model);
        if let Some((surface_name, surface)) = surface {
            let surface_name = surface_name.clone();
            let mut found;
            if correspond(surface, &mesh) {
                found = vertex_distances(&surface.vertices, &mesh.vertices).map_err(of_surface)?;
                let (offsets, step) = offsets(&surface.vertices, &mesh.vertices);
                reference = Reference::Vertices { name: surface_name, offsets: blocks.i16(offsets), step };
            } else {
                found = distances_to_surface(surface, &mesh.vertices, monitor).map_err(of_surface)?;
                // Vertices that close cut handles have no counterpart on the surface.
                if let Some(seam) = &sphere.seam {
                    found.iter_mut().skip(seam.vertices + seam.copies.len()).for_each(|distance| *distance = f64::NAN);
                }
                let mesh = (surface.vertices.len() <= max_vertices).then(|| Drawn::new(surface, blocks));
                let distances = blocks.f32(found.iter().copied());
                reference = Reference::Surface { name: surface_name, mesh, distances };
            }
            distances = Some(found);
        }
        let largest = |values: &[f64]| values.iter().copied().fold(f64::MIN_POSITIVE, f64::max);
        let mut panels = vec![Panel::new(&mesh, "model")];
        if let (Some((_, surface)), Some(values)) = (surface, &distances) {
            panels.insert(0, Panel::new(surface, "surface"));
            let paint = Paint::Scalar { values, range: (0.0, largest(values)), label: "" };
            panels.push(Panel { paint, ..Panel::new(&mesh, "distance") });
        }
        let still = still(&panels)?;
        let errors = distances.map(|values| {
            let known: Vec<f64> = values.iter().copied().filter(|distance| !distance.is_nan()).collect();
            let mean_square = known.iter().map(|d| d * d).sum::<f64>() / known.len().max(1) as f64;
            [mean_square.sqrt(), largest(&values)]
        });
        let item = Self {
            kind: "model",
            name: name.clone(),
            degree,
            grid: Grid::of_sphere(&sphere, blocks),
            coefficients: blocks.f32(model.coefficients.values().iter().copied()),
            reference,
        };
        Ok(Made { item, still, errors })
    }
}

/// Returns the sphere of the model if it has triangles and at most `max_vertices` vertices, otherwise an icosphere. The
/// model of a surface whose handles were cut always has a sphere, and the page shows it with the cuts.
fn sphere_of(model: &Model, max_vertices: usize) -> Sphere {
    match &model.sphere {
        Some(own) if !own.faces.is_empty() && own.directions.len() <= max_vertices => own.clone(),
        _ => icosphere_for(model.coefficients.max_degree(), max_vertices),
    }
}

/// Returns the offsets of the surface from the model in steps, and the size of a step. The step is chosen such that the
/// largest offset is the maximum of i16.
fn offsets(surface: &[[f64; 3]], model: &[[f64; 3]]) -> (Vec<i16>, f64) {
    let apart: Vec<f64> =
        surface.as_flattened().iter().zip(model.as_flattened()).map(|(surface, model)| surface - model).collect();
    let most = apart.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    let step = if most > 0.0 { most / f64::from(i16::MAX) } else { 1.0 };
    (apart.iter().map(|value| (value / step).round() as i16).collect(), step)
}

#[cfg(test)]
mod tests {
    use super::offsets;

    #[test]
    fn offsets_are_right_to_half_a_step() {
        let surface = [[1.0, 2.0, 3.0], [-4.0, 0.5, 0.25]];
        let model = [[1.5, 2.0, 2.9], [-3.0, 0.5, 0.26]];
        let (found, step) = offsets(&surface, &model);
        assert_eq!((found[3], step), (-i16::MAX, 1.0 / f64::from(i16::MAX)));
        for (offset, (surface, model)) in found.iter().zip(surface.as_flattened().iter().zip(model.as_flattened())) {
            assert!((f64::from(*offset) * step - (surface - model)).abs() <= 0.5 * step * (1.0 + 1e-9));
        }
        assert_eq!(offsets(&surface, &surface), (vec![0; 6], 1.0));
    }
}
