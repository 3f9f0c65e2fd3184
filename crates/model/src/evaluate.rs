//! Evaluates a model on any sphere, up to the model's degree or a lower degree.

use ndarray::Array2;
use spharm_harmonics::Directions;
use spharm_surface::{Kind, Mesh, Meta, Signal, Sphere, Welded};
use spharm_transform::{FINEST, Transform, TransformParams, synthesis};

use crate::error::ModelError;
use crate::geometry::Geometry;
use crate::model::Model;

impl Model {
    /// Returns the values (n, c) of the model at n directions, using the degrees up to `degree`.
    ///
    /// # Errors
    ///
    /// [`DegreeTooHigh`](ModelError::DegreeTooHigh) if `degree` exceeds the degree of the model, and
    /// [`Transform`](ModelError::Transform) if the harmonics can't be evaluated.
    pub fn evaluate(&self, directions: &Directions, degree: usize) -> Result<Array2<f64>, ModelError> {
        let max_degree = self.coefficients.max_degree();
        if degree > max_degree {
            return Err(ModelError::DegreeTooHigh { degree, max_degree });
        }
        Ok(synthesis(directions, self.coefficients.up_to(degree))?)
    }

    /// Returns the memory in bytes needed to evaluate a model over a sphere and to write the result to a file. The
    /// sphere and the result are included.
    ///
    /// The sphere takes 24 bytes per vertex and 12 per triangle. The transform takes [`Transform::bytes`]. Each value
    /// is stored three times, with 8 bytes each: in the result of the transform, in the mesh or signal, and in the
    /// writer's output. The result's triangles take 12 bytes each.
    #[must_use]
    pub fn bytes_to_evaluate(vertices: u64, faces: u64, channels: usize, degree: usize) -> u64 {
        let params = TransformParams { max_degree: degree, accuracy: FINEST, channels: channels.clamp(1, 3) };
        let directions = usize::try_from(vertices).unwrap_or(usize::MAX / 1024);
        let transform = Transform::bytes(&params, directions, channels).unwrap_or(usize::MAX) as u64;
        let arrays = vertices.saturating_mul(24 + 24 * channels as u64).saturating_add(faces.saturating_mul(24));
        arrays.saturating_add(transform)
    }

    /// Evaluates the model's surface at the vertices of a sphere. The result has the sphere's triangles, the metadata
    /// that the model preserves from the input's file, and its [anatomical structure](Self::anatomical_structure).
    ///
    /// # Errors
    ///
    /// [`NotASurface`](ModelError::NotASurface) if the model is of a signal, [`NoTriangles`](ModelError::NoTriangles)
    /// if the sphere has no triangles, and the errors of [`evaluate`](Self::evaluate).
    pub fn reconstruct(&self, sphere: &Sphere, degree: usize) -> Result<Mesh, ModelError> {
        if self.kind() != Kind::Surface {
            return Err(ModelError::NotASurface { channels: self.coefficients.channels() });
        }
        if sphere.faces.is_empty() {
            return Err(ModelError::NoTriangles);
        }
        let values = self.evaluate(&sphere.directions, degree)?;
        let vertices = values.rows().into_iter().map(|row| [row[0], row[1], row[2]]).collect();
        Ok(Mesh { meta: self.meta(), ..Mesh::new(vertices, sphere.faces.clone()) })
    }

    /// Evaluates the model at the vertices of the surface to which it was fitted. The result has the triangles of that
    /// surface. If handles of the surface were cut before the fit, the cuts are undone: fillings are removed and seams
    /// are welded.
    ///
    /// # Errors
    ///
    /// [`NoSphere`](ModelError::NoSphere) if the model has no sphere, [`Seam`](ModelError::Seam) if its record of the
    /// cuts contradicts the sphere, and the errors of [`reconstruct`](Self::reconstruct).
    pub fn reconstruct_original(&self, degree: usize) -> Result<Welded, ModelError> {
        let sphere = self.own_sphere()?;
        let mesh = self.reconstruct(sphere, degree)?;
        match &sphere.seam {
            Some(seam) => seam.weld(&mesh).map_err(ModelError::Seam),
            None => Ok(Welded { mesh, gap: 0.0 }),
        }
    }

    /// Evaluates the model at the directions of a sphere, and returns the values as a signal.
    ///
    /// # Errors
    ///
    /// The errors of [`evaluate`](Self::evaluate).
    pub fn reconstruct_signal(&self, sphere: &Sphere, degree: usize) -> Result<Signal, ModelError> {
        let values = self.evaluate(&sphere.directions, degree)?;
        let (vertices, channels) = values.dim();
        Ok(Signal::new(values.iter().copied().collect(), vertices, channels))
    }

    /// Returns the sphere over which the model was fitted.
    ///
    /// # Errors
    ///
    /// [`NoSphere`](ModelError::NoSphere) if the model has no sphere.
    pub fn own_sphere(&self) -> Result<&Sphere, ModelError> {
        self.sphere.as_ref().ok_or(ModelError::NoSphere)
    }

    fn meta(&self) -> Meta {
        let mut meta = self.provenance.geometry.as_ref().map(Geometry::to_meta).unwrap_or_default();
        meta.anatomical_structure_primary = self.anatomical_structure();
        meta
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_harmonics::Coefficients;

    fn ellipsoid() -> Model {
        let mut values = Array2::zeros((9, 3));
        (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (9.0, 4.0, 4.0);
        Model::without_sphere(Coefficients::new(values).unwrap(), Kind::Surface)
    }

    #[test]
    fn degrees_and_kinds_are_checked() {
        let model = ellipsoid();
        let sphere = Sphere::icosphere(1);
        let degree_0 = model.reconstruct(&sphere, 0).unwrap();
        assert!(degree_0.vertices.iter().all(|v| *v == degree_0.vertices[0]), "a surface of degree 0 is a point");
        let error = model.reconstruct(&sphere, 3).unwrap_err();
        assert!(matches!(error, ModelError::DegreeTooHigh { degree: 3, max_degree: 2 }), "{error}");
        let points = Sphere::from_directions(sphere.directions.clone());
        assert!(matches!(model.reconstruct(&points, 2), Err(ModelError::NoTriangles)));
        assert!(matches!(model.own_sphere(), Err(ModelError::NoSphere)));

        let mut signal = ellipsoid();
        signal.provenance.surface = Some(false);
        assert!(matches!(signal.reconstruct(&sphere, 2), Err(ModelError::NotASurface { channels: 3 })));
        let values = signal.reconstruct_signal(&points, 2).unwrap();
        assert_eq!((values.vertices, values.channels), (42, 3));
    }

    #[test]
    fn the_original_of_a_cut_surface_is_without_copies_and_filling() {
        let mut model = ellipsoid();
        let mut sphere = Sphere::icosphere(1);
        let (faces, first) = (sphere.faces.len(), sphere.faces[0]);
        model.sphere = Some(sphere.clone());
        assert_eq!(model.reconstruct_original(2).unwrap().mesh, model.reconstruct(&sphere, 2).unwrap());
        // Vertex 40 is a copy of vertex 0, and vertex 41 belongs to the filling. The triangles at these two vertices
        // are removed and replaced by one triangle of the filling.
        sphere.faces.retain(|face| face.iter().all(|&v| v < 41));
        let own = sphere.faces.len();
        sphere.faces.push([first[0], first[1], 41]);
        sphere.seam = Some(spharm_surface::Seam { vertices: 40, faces: own, copies: vec![0] });
        model.sphere = Some(sphere);
        let Welded { mesh, gap } = model.reconstruct_original(2).unwrap();
        assert_eq!((mesh.vertices.len(), mesh.faces.len()), (40, own));
        assert!(own < faces && gap > 0.0);
        assert!(mesh.faces.as_flattened().iter().all(|&v| v < 40));
    }

    #[test]
    fn a_reconstruction_has_the_inputs_geometry() {
        let mut model = ellipsoid();
        let meta = Meta {
            anatomical_structure_primary: Some("CortexRight".to_owned()),
            freesurfer_footer: Some(vec![0, 0, 0, 20, b'v', 255]),
            ..Meta::default()
        };
        model.provenance.set_meta(&meta);
        assert_eq!(model.reconstruct(&Sphere::icosphere(1), 2).unwrap().meta, meta);
    }
}
