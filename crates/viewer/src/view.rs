//! One model in a page: its surface to any degree, and the distance of that from a reference.

use ndarray::{Array2, ArrayView2};
use spharm_harmonics::Directions;
use spharm_harmonics::index::basis_size;
use spharm_transform::{Transform, TransformParams};

use crate::normals::vertex_normals;

/// Relative accuracy of the evaluation: slightly better than the precision of the page's f32 positions.
const ACCURACY: f64 = 1e-8;

/// A model, the directions at which it is evaluated, and the latest results. Arrays are row-major.
#[derive(Debug, Default)]
pub struct View {
    /// Vectors of any length, (n, 3).
    pub directions: Vec<f64>,
    /// Canonical coefficients, (K, 3).
    pub coefficients: Vec<f64>,
    /// Triangles, (m, 3).
    pub faces: Vec<u32>,
    /// The reference surface minus the model to its highest degree, (n, 3), in steps; empty without a reference.
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
    #[error("no model was given yet")]
    NoPlan,
    /// An array whose length doesn't match the others.
    #[error("{what}: expected {expected} numbers, found {found}")]
    Shape {
        /// Name of the array.
        what: &'static str,
        /// Length that matches the other arrays.
        expected: usize,
        /// Length found.
        found: usize,
    },
    /// A triangle that refers to a missing vertex.
    #[error("a triangle names vertex {vertex}, there are {vertices}")]
    Face {
        /// Index of the vertex.
        vertex: u32,
        /// Number of vertices.
        vertices: usize,
    },
    /// A degree above the model's.
    #[error("degree {degree} is above the model's {max_degree}")]
    Degree {
        /// The requested degree.
        degree: usize,
        /// The model's degree.
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
    /// Plans the evaluation of models of degree `max_degree`, L, with the directions and triangles that have been
    /// filled in.
    ///
    /// # Errors
    ///
    /// [`ViewError`]: arrays that don't match, or invalid directions.
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

    /// Evaluates the coefficients that have been filled in, using the degrees up to `degree`.
    ///
    /// # Errors
    ///
    /// [`ViewError`]: no plan, a degree above the plan's, or coefficients that don't match it.
    pub fn evaluate(&mut self, degree: usize) -> Result<(), ViewError> {
        let plan = self.plan.as_ref().ok_or(ViewError::NoPlan)?;
        let max_degree = plan.max_degree();
        if degree > max_degree {
            return Err(ViewError::Degree { degree, max_degree });
        }
        expect("coefficients", 3 * basis_size(max_degree), self.coefficients.len())?;
        // A plan to a lower degree over the same sorted directions is cheap, and avoids sums over zeros.
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

    /// Computes the reference: the surface that was evaluated last, plus `offsets` times `step`.
    ///
    /// # Errors
    ///
    /// [`ViewError::Shape`]: the number of offsets isn't that of the positions.
    pub fn refer(&mut self, step: f64) -> Result<(), ViewError> {
        expect("offsets", self.evaluated.len(), self.offsets.len())?;
        let offsets = self.offsets.iter().map(|offset| f64::from(*offset) * step);
        self.reference = self.evaluated.iter().zip(offsets).map(|(value, offset)| value + offset).collect();
        self.reference_normals = vertex_normals(&self.reference, &self.faces);
        Ok(())
    }

    /// Measures how far each vertex is from the corresponding vertex of the reference: the distance or, if `signed`,
    /// the component of the displacement along the reference's normal, positive outside.
    ///
    /// # Errors
    ///
    /// [`ViewError::Shape`]: there is no reference of the same size as the surface that was evaluated last.
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

    /// Returns the positions that were evaluated last, (n, 3).
    #[must_use]
    pub fn positions(&self) -> &[f32] {
        &self.positions
    }

    /// Returns the normals at these positions, (n, 3), computed from the triangles.
    #[must_use]
    pub fn normals(&self) -> &[f32] {
        &self.normals
    }

    /// Returns the reference's positions, (n, 3).
    #[must_use]
    pub fn reference(&self) -> Vec<f32> {
        self.reference.iter().map(|value| *value as f32).collect()
    }

    /// Returns the distances that were measured last, (n).
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

    /// An octahedron's vertices and triangles, and coefficients of degree 3.
    fn view() -> View {
        let directions = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]];
        let mut view = View {
            directions: directions.as_flattened().iter().map(|x| f64::from(*x)).collect(),
            coefficients: (0..48).map(|i| (f64::from(i) * 0.37).sin()).collect(),
            faces: vec![0, 2, 4, 2, 1, 4, 1, 3, 4, 3, 0, 4, 2, 0, 5, 1, 2, 5, 3, 1, 5, 0, 3, 5],
            ..View::default()
        };
        // Sphere-like, so that normals are outward.
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
        // A vertex moved by (2, 0, 0): inwards for the model seen from the reference.
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
