//! Applies diffeomorphisms of the sphere, which are compositions of steps along tangent fields, and their inverses.
//!
//! ```text
//! phi = exp(w_T) o ... o exp(w_1),    w_t = grad A_t + u x grad B_t
//! ```
//!
//! A step is one-to-one if the displacements `d(u) = exp(w)(u) - u` of any two directions differ by less than the
//! distance between the directions. The descent keeps the difference below half of that distance. The inverse of a step
//! at p is then the limit of the iteration `q <- p - d(q)`, projected to the sphere. Each iteration at least halves the
//! error.
//!
//! Cost: one synthesis of six functions per step. The inverse takes about twenty syntheses per step. Its iteration
//! stops when directions change by less than 1e-11 rad.

use ndarray::Array2;
use spharm_harmonics::Directions;
use spharm_harmonics::index::max_degree_of;
use spharm_surface::geometry::{Vec3, add, dot, sub, unit};
use spharm_transform::{Transform, TransformParams};

use crate::error::ShapeError;
use crate::groupwise::field::{field, step};

/// Accuracy of the evaluated fields.
const ACCURACY: f64 = 1e-12;
/// Angle in radians. The iteration that inverts a flow has converged once it changes all directions by less than this
/// angle.
const FOUND: f64 = 1e-11;
/// Maximum number of iterations for the inverse of a step.
const ROUNDS: usize = 60;

/// A diffeomorphism of the sphere; the identity by default.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Flow {
    steps: Vec<Array2<f64>>,
}

impl Flow {
    /// Creates a flow from its steps, in the order of application. Each step holds the canonical coefficients (K, 2) of
    /// two potentials, in radians: the first for the gradient, the second for the curl.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Harmonics`] if K isn't `(D + 1)^2` for any D; [`ShapeError::Differ`] if the number of columns
    /// isn't two; [`ShapeError::NotFiniteValue`] if a coefficient is NaN or infinite.
    pub fn from_steps(steps: Vec<Array2<f64>>) -> Result<Self, ShapeError> {
        for step in &steps {
            let (rows, columns) = step.dim();
            if max_degree_of(rows).is_none() {
                return Err(spharm_harmonics::HarmonicsError::NotABasisSize { rows }.into());
            }
            if columns != 2 {
                return Err(ShapeError::Differ { what: "columns of a flow's step", expected: 2, found: columns });
            }
            if let Some(((row, column), _)) = step.indexed_iter().find(|(_, value)| !value.is_finite()) {
                return Err(ShapeError::NotFiniteValue { what: "a flow's step", row, column });
            }
        }
        Ok(Self { steps })
    }

    /// Returns the steps, as given to [`from_steps`](Self::from_steps).
    #[must_use]
    pub fn steps(&self) -> &[Array2<f64>] {
        &self.steps
    }

    pub(super) fn push(&mut self, step: Array2<f64>) {
        self.steps.push(step);
    }

    /// Returns the images (n, 3) of unit vectors (n, 3) under the flow.
    ///
    /// Runs on the current rayon pool; the result is bitwise the same on any number of threads.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Harmonics`] if there are no vectors, or a vector's length isn't 1; [`ShapeError::Transform`] if a
    /// field can't be evaluated.
    pub fn apply(&self, directions: &[Vec3]) -> Result<Vec<Vec3>, ShapeError> {
        let mut at = Directions::from_unit_vectors(directions.to_vec())?.as_slice().to_vec();
        for potentials in &self.steps {
            at = step(&at, &field_at(potentials, &at)?, 1.0);
        }
        Ok(at)
    }

    /// Returns the preimages (n, 3) of unit vectors (n, 3) under the flow, with an error of about 1e-10.
    ///
    /// # Errors
    ///
    /// The errors of [`apply`](Self::apply).
    pub fn inverse(&self, directions: &[Vec3]) -> Result<Vec<Vec3>, ShapeError> {
        let mut at = Directions::from_unit_vectors(directions.to_vec())?.as_slice().to_vec();
        for potentials in self.steps.iter().rev() {
            let target = at.clone();
            for _ in 0..ROUNDS {
                let reached = step(&at, &field_at(potentials, &at)?, 1.0);
                let mut change = 0.0_f64;
                for ((q, &reached), &p) in at.iter_mut().zip(&reached).zip(&target) {
                    let next = unit(add(p, sub(*q, reached)));
                    let by = sub(next, *q);
                    change = change.max(dot(by, by));
                    *q = next;
                }
                if change < FOUND * FOUND {
                    break;
                }
            }
        }
        Ok(at)
    }
}

fn field_at(potentials: &Array2<f64>, at: &[Vec3]) -> Result<Vec<Vec3>, ShapeError> {
    let max_degree = max_degree_of(potentials.nrows()).unwrap_or(0);
    let params = TransformParams { max_degree, accuracy: ACCURACY, channels: 6 };
    field(potentials, at, &Transform::new(&Directions::from_unit_vectors(at.to_vec())?, &params)?)
}
