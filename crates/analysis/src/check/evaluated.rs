//! Evaluates models as meshes.

use anyhow::Result;
use spharm::shape::Similarity;
use spharm::{Model, Sphere};
use spharm_surface::Mesh;
use spharm_surface::geometry::bounds;

/// Returns the lowest and the highest x, y and z of a model's surface after the transform `pose`.
pub(super) fn extent(model: &Model, pose: &Similarity) -> Result<[[f64; 3]; 2]> {
    let mesh = moved(&evaluated(model, &Sphere::icosphere(3))?, pose);
    let (low, high) = bounds(mesh.vertices.iter().copied());
    Ok([low, high])
}

/// Returns the surface of a model, evaluated on the model's own sphere if the sphere has triangles, otherwise on an
/// icosphere that suits the model's degree. On the model's own sphere, the facets are as small as the facets of the
/// fitted surface.
pub(super) fn surface_of(model: &Model) -> Result<Mesh> {
    match &model.sphere {
        Some(sphere) if !sphere.faces.is_empty() => evaluated(model, sphere),
        _ => {
            let subdivisions = match model.coefficients.max_degree() {
                0..=15 => 4,
                16..=40 => 5,
                _ => 6,
            };
            evaluated(model, &Sphere::icosphere(subdivisions))
        }
    }
}

/// Applies a transform to a mesh.
pub(super) fn moved(mesh: &Mesh, pose: &Similarity) -> Mesh {
    mesh.with_vertices(mesh.vertices.iter().map(|vertex| pose.apply(*vertex)).collect())
}

fn evaluated(model: &Model, sphere: &Sphere) -> Result<Mesh> {
    Ok(model.reconstruct(sphere, model.coefficients.max_degree())?)
}
