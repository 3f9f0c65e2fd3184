//! Evaluates a model of a page up to any degree, and measures its distance from a reference.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Directions;
use spharm_harmonics::index::basis_size;
use spharm_transform::{Transform, TransformParams};

use crate::normals::vertex_normals;

/// Relative accuracy of the evaluation, slightly better than the precision of the page's f32 positions.
const ACCURACY: f64 = 1e-8;

/// A model, the directions at which it is evaluated, and the latest results. All arrays are row-major.
#[derive(Debug, Default)]
pub struct View {
    /// Directions at which the model is evaluated, (n, 3), as vectors of any length.
    pub directions: Vec<f64>,
    /// Canonical coefficients, (K, 3).
    pub coefficients: Vec<f64>,
    /// Triangles, (m, 3).
    pub faces: Vec<u32>,
    /// Offsets of the reference surface from the model at its highest degree, (n, 3), in multiples of the `step` given
    /// to [`refer`](Self::refer); empty without a reference.
    pub offsets: Vec<i16>,
    plan: Option<Transform>,
    evaluated: Vec<f64>,
    reference: Vec<f64>,
    reference_normals: Vec<f32>,
    positions: Vec<f32>,
    normals: Vec<f32>,
    distances: Vec<f32>,
}

/// Errors of a [`View`].
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ViewError {
    /// [`View::plan`] hasn't succeeded yet.
    #[error("plan() must be called before evaluate()")]
    NoPlan,
    /// An array whose length doesn't match the other arrays.
    #[error("{what}: expected {expected} numbers, found {found}")]
    Shape {
        /// Name of the array.
        what: &'static str,
        /// Length that matches the other arrays.
        expected: usize,
        /// Length of the array.
        found: usize,
    },
    /// A triangle that refers to a missing vertex.
    #[error("a triangle refers to vertex {vertex}, but there are only {vertices} vertices (counted from 0)")]
    Face {
        /// Index of the vertex.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A requested degree above the model's highest degree.
    #[error("degree {degree} is above the model's {max_degree}")]
    Degree {
        /// The requested degree.
        degree: usize,
        /// Highest degree of the model.
        max_degree: usize,
    },
    /// Invalid directions.
    #[error(transparent)]
    Directions(#[from] spharm_harmonics::HarmonicsError),
    /// An error of the transform.
    #[error(transparent)]
    Transform(#[from] spharm_transform::TransformError),
}

impl View {
    /// Plans the evaluation of models up to degree `max_degree` with the current `directions` and `faces`.
    ///
    /// # Errors
    ///
    /// [`ViewError`] if a triangle refers to a missing vertex, or directions are invalid.
    pub fn plan(&mut self, max_degree: usize) -> Result<(), ViewError> {
        let vectors: Vec<[f64; 3]> = self.directions.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect();
        if let Some(&vertex) = self.faces.iter().find(|vertex| **vertex as usize >= vectors.len()) {
            return Err(ViewError::Face { vertex, vertices: vectors.len() });
        }
        let directions = Directions::from_vertices(&vectors)?;
        let params = TransformParams { max_degree, accuracy: ACCURACY, channels: 3 };
        self.plan = Some(Transform::new(&directions, &params)?);
        self.reference.clear();
        self.reference_normals.clear();
        Ok(())
    }

    /// Evaluates the current `coefficients`, using the degrees up to `degree`.
    ///
    /// # Errors
    ///
    /// [`ViewError`] if there is no plan, the degree is above the plan's, or the number of coefficients doesn't match
    /// the plan.
    pub fn evaluate(&mut self, degree: usize) -> Result<(), ViewError> {
        let plan = self.plan.as_ref().ok_or(ViewError::NoPlan)?;
        let max_degree = plan.max_degree();
        if degree > max_degree {
            return Err(ViewError::Degree { degree, max_degree });
        }
        expect("coefficients", 3 * basis_size(max_degree), self.coefficients.len())?;
        // A plan of a lower degree for the same sorted directions is cheap, and avoids sums over zeros.
        let lower = if degree == max_degree { None } else { Some(plan.to_degree(degree, 3)?) };
        let rows = basis_size(degree);
        let used = ArrayView2::from_shape((rows, 3), &self.coefficients[..3 * rows]);
        let used = used.map_err(|_| ViewError::Shape { what: "coefficients", expected: 3 * rows, found: 0 })?;
        let values: Array2<f64> = lower.as_ref().unwrap_or(plan).synthesis(used)?;
        self.evaluated = values.into_iter().collect();
        self.positions = self.evaluated.iter().map(|value| *value as f32).collect();
        self.normals = vertex_normals(&self.evaluated, &self.faces);
        Ok(())
    }

    /// Computes the reference, which is the surface evaluated last plus `offsets` times `step`.
    ///
    /// # Errors
    ///
    /// [`ViewError::Shape`] if the number of offsets differs from the number of positions.
    pub fn refer(&mut self, step: f64) -> Result<(), ViewError> {
        expect("offsets", self.evaluated.len(), self.offsets.len())?;
        let offsets = self.offsets.iter().map(|offset| f64::from(*offset) * step);
        self.reference = self.evaluated.iter().zip(offsets).map(|(value, offset)| value + offset).collect();
        self.reference_normals = vertex_normals(&self.reference, &self.faces);
        Ok(())
    }

    /// Measures the distance of each vertex from the corresponding vertex of the reference. If `signed` is true,
    /// measures instead the component of the displacement along the reference's normal, which is positive outside.
    ///
    /// # Errors
    ///
    /// [`ViewError::Shape`] if there is no reference, or if the reference and the evaluated surface have different
    /// numbers of vertices.
    pub fn measure(&mut self, signed: bool) -> Result<(), ViewError> {
        expect("reference", self.evaluated.len(), self.reference.len())?;
        let pairs = self.evaluated.chunks_exact(3).zip(self.reference.chunks_exact(3));
        let distance = |((value, reference), normal): ((&[f64], &[f64]), &[f32])| {
            let apart = [0, 1, 2].map(|i| value[i] - reference[i]);
            if signed {
                (0..3).map(|i| apart[i] * f64::from(normal[i])).sum::<f64>() as f32
            } else {
                apart.iter().map(|x| x * x).sum::<f64>().sqrt() as f32
            }
        };
        self.distances = pairs.zip(self.reference_normals.chunks_exact(3)).map(distance).collect();
        Ok(())
    }

    /// Returns the positions of the surface evaluated last, (n, 3).
    #[must_use]
    pub fn positions(&self) -> &[f32] {
        &self.positions
    }

    /// Returns the normals of the surface evaluated last, (n, 3), computed from its triangles.
    #[must_use]
    pub fn normals(&self) -> &[f32] {
        &self.normals
    }

    /// Returns the positions of the reference, (n, 3).
    #[must_use]
    pub fn reference(&self) -> Vec<f32> {
        self.reference.iter().map(|value| *value as f32).collect()
    }

    /// Returns the distances measured last, (n).
    #[must_use]
    pub fn distances(&self) -> &[f32] {
        &self.distances
    }
}

fn expect(what: &'static str, expected: usize, found: usize) -> Result<(), ViewError> {
    if expected == found { Ok(()) } else { Err(ViewError::Shape { what, expected, found }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_transform::synthesis;

    /// Returns a view with the vertices and triangles of an octahedron, and coefficients of degree 3.
    fn view() -> View {
        let directions = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
        let mut view = View {
            directions: directions.as_flattened().iter().map(|x| f64::from(*x)).collect(),
            coefficients: (0..48).map(|i| (f64::from(i) * 0.37).sin()).collect(),
            faces: vec![0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5],
            ..View::default()
        };
        // Make the surface similar to a sphere, so that its normals point outwards.
        for (row, channel) in [(3, 0), (1, 1), (2, 2)] {
            view.coefficients[3 * row + channel] += 20.0;
        }
        view
    }

    #[test]
    fn every_degree_is_the_sum_to_that_degree() {
        let mut view = view();
        view.plan(3).unwrap();
        let vectors: Vec<[f64; 3]> = view.directions.chunks_exact(3).map(|v| [v[0], v[1], v[2]]).collect();
        let directions = Directions::from_vertices(&vectors).unwrap();
        for degree in [3, 0, 2, 1] {
            view.evaluate(degree).unwrap();
            let rows = basis_size(degree);
            let used = ArrayView2::from_shape((rows, 3), &view.coefficients[..3 * rows]).unwrap();
            let expected = synthesis(&directions, used).unwrap();
            for (found, expected) in view.positions().iter().zip(&expected) {
                assert!((f64::from(*found) - expected).abs() < 1e-6, "degree {degree}: {found}, {expected}");
            }
        }
    }

    #[test]
    fn distances_are_from_the_reference_and_positive_outside() {
        let mut view = view();
        view.plan(3).unwrap();
        view.evaluate(3).unwrap();
        // A vertex of the reference is moved outwards by (2, 0, 0), so the model's vertex is inside the reference.
        view.offsets = vec![0; 18];
        view.offsets[0] = 4;
        view.refer(0.5).unwrap();
        view.measure(false).unwrap();
        assert!((view.distances()[0] - 2.0).abs() < 1e-6 && view.distances()[1..].iter().all(|d| d.abs() < 1e-6));
        view.measure(true).unwrap();
        assert!(view.distances()[0] < -1.0, "{:?}", view.distances());
        assert!((view.reference()[0] - view.positions()[0] - 2.0).abs() < 1e-5);
    }

    #[test]
    fn what_does_not_fit_is_refused() {
        assert!(matches!(View::default().evaluate(0), Err(ViewError::NoPlan)));
        let mut view = view();
        view.plan(3).unwrap();
        assert!(matches!(view.evaluate(4), Err(ViewError::Degree { degree: 4, max_degree: 3 })));
        assert!(matches!(view.measure(false), Ok(())), "nothing was evaluated, nothing is measured");
        view.evaluate(3).unwrap();
        assert!(matches!(view.refer(1.0), Err(ViewError::Shape { what: "offsets", expected: 18, found: 0 })));
        view.coefficients.pop();
        assert!(matches!(view.evaluate(2), Err(ViewError::Shape { what: "coefficients", .. })));
        view.faces[0] = 6;
        assert!(matches!(view.plan(3), Err(ViewError::Face { vertex: 6, vertices: 6 })));
        view.directions.fill(0.0);
        view.faces.clear();
        assert!(matches!(view.plan(3), Err(ViewError::Directions(_))));
    }
}
