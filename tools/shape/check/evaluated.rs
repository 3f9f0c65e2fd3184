//! Evaluates models as meshes.

use anyhow::Result;
use spharm::shape::Similarity;
use spharm::{Coefficients, Model, Sphere};
use spharm_surface::Mesh;
use spharm_surface::geometry::bounds;
use spharm_transform::synthesis;

/// Returns the lowest and the highest coordinates of a model after a transform.
pub(super) fn extent(model: &Model, pose: &Similarity) -> Result<[[f64; 3]; 2]> {
    let mesh = moved(&evaluated(&model.coefficients, &Sphere::icosphere(3))?, pose);
    let (low, high) = bounds(mesh.vertices.iter().copied());
    Ok([low, high])
}

/// Returns the surface of a model: over its own sphere, if it has one with triangles, so that its facets are as small
/// as those of the fitted surface; else over an icosphere that suits its degree.
pub(super) fn surface_of(model: &Model) -> Result<Mesh> {
    match &model.sphere {
        Some(sphere) if !sphere.faces.is_empty() => evaluated(&model.coefficients, sphere),
        _ => {
            let subdivisions = match model.coefficients.max_degree() {
                0..=15 => 4,
                16..=40 => 5,
                _ => 6,
            };
            evaluated(&model.coefficients, &Sphere::icosphere(subdivisions))
        }
    }
}

/// Returns a mesh after a transform.
pub(super) fn moved(mesh: &Mesh, pose: &Similarity) -> Mesh {
    mesh.with_vertices(mesh.vertices.iter().map(|vertex| pose.apply(*vertex)).collect())
}

fn evaluated(coefficients: &Coefficients, sphere: &Sphere) -> Result<Mesh> {
    let values = synthesis(&sphere.directions, coefficients.values().view())?;
    let vertices = values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
    Ok(Mesh::new(vertices, sphere.faces.clone()))
}
