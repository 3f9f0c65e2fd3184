//! Rotates surfaces in their parameters and in space, and translates and scales them.
//!
//! A rotation Q of space moves a surface, `f'(u) = Q f(u)`: every row of its coefficients, **including row 0**, is
//! multiplied by Q^T from the right. A translation t adds `sqrt(4 pi) t` to row 0, which is the surface's mean
//! position times sqrt(4 pi). A rotation R of the parameters doesn't move the surface in space
//! ([`rotate`](crate::rotate)).

use spharm_harmonics::{Coefficients, Directions};
use spharm_model::Model;
use spharm_monitor::Monitor;
pub use spharm_surface::Similarity;
use spharm_surface::{Hemisphere, Kind, Mesh};

use crate::error::ShapeError;
use crate::extent::{finite, surface};
use crate::rotate::rotate_parameters;
use crate::rotation::Rotation;
use crate::smoothing::keep_penalty;

/// Coefficient of the constant function 1 in row 0: sqrt(4 pi).
pub(crate) const SQRT_4_PI: f64 = 3.544_907_701_811_032;

/// A transform of a surface: `f'(u) = scale Q f(R^T u) + translation`. If `antipodal` is set, f(R^T u) is replaced by
/// f(-R^T u).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Transform {
    /// Rotation R of the parameters.
    pub rotation: Rotation,
    /// Whether each direction is first replaced by its opposite, which mirrors the sphere. If a surface is mirrored
    /// in space, its normals stay outward only if its sphere is mirrored too.
    pub antipodal: bool,
    /// Similarity applied in space after the rotation of the parameters.
    pub similarity: Similarity,
}

impl Transform {
    /// Returns the transform that exchanges left and right of a surface ([`Similarity::reflection`]) and of its
    /// sphere: `f'(u) = M f(M u)` with `M = diag(-1, 1, 1)`. Normals stay outward.
    #[must_use]
    pub const fn reflection() -> Self {
        // M = diag(-1, 1, 1) is a half turn about the first axis, followed by the reflection of all axes.
        Self { rotation: Rotation::HALF_TURN_X, antipodal: true, similarity: Similarity::reflection() }
    }

    /// Returns the composed transform, which applies this transform first and then `next`.
    #[must_use]
    pub fn then(&self, next: &Self) -> Self {
        Self {
            rotation: next.rotation * self.rotation,
            antipodal: self.antipodal != next.antipodal,
            similarity: self.similarity.then(&next.similarity),
        }
    }

    /// Returns the coefficients (K, 3) of a surface after the transform.
    ///
    /// # Errors
    ///
    /// [`ShapeError::NotFinite`] if a coefficient is NaN or infinite; [`ShapeError::NotASurface`] if the coefficients
    /// don't have three columns; [`ShapeError::Interrupted`] if the monitor cancels.
    pub fn apply(&self, coefficients: &Coefficients, monitor: &dyn Monitor) -> Result<Coefficients, ShapeError> {
        surface(coefficients)?;
        let turned = turn(coefficients, &self.rotation, self.antipodal, monitor)?;
        transform_object(&turned, &self.similarity)
    }

    /// Applies the similarity in space to points (n, 3), such as landmarks, in the surface's unit.
    #[must_use]
    pub fn apply_points(&self, points: &[[f64; 3]]) -> Vec<[f64; 3]> {
        points.iter().map(|point| self.similarity.apply(*point)).collect()
    }

    /// Applies the similarity in space to a mesh; see [`Similarity::apply_mesh`]. The rotation of the parameters has no
    /// effect, because a mesh has no parameters.
    #[must_use]
    pub fn apply_mesh(&self, mesh: &Mesh) -> Mesh {
        self.similarity.apply_mesh(mesh)
    }

    /// Returns the transform as JSON, with each matrix as a list of rows: `{"parameters": R, "antipodal": false,
    /// "object": Q, "scale": s, "translation": t}`.
    #[must_use]
    pub fn to_json(&self) -> serde_json::Value {
        serde_json::json!({
            "parameters": self.rotation.matrix(),
            "antipodal": self.antipodal,
            "object": self.similarity.orthogonal,
            "scale": self.similarity.scale,
            "translation": self.similarity.translation,
        })
    }

    /// Transforms a model. Its sphere rotates with the parameters, so that each vertex of a reconstruction remains the
    /// same point of the surface. The rotated sphere is another sampling, which has no key in a basis store. A model of
    /// a signal can be rotated in its parameters but not in space.
    ///
    /// The provenance records each call: `transform` lists the [`to_json`](Self::to_json) of all transforms applied.
    /// Settings and distances of the fit are removed, because they don't apply to the transformed model. If the
    /// surface was moved, its position in a volume is removed too. If the surface, or the sphere of a signal, was
    /// mirrored, left and right are exchanged in the anatomical structure.
    ///
    /// # Errors
    ///
    /// [`ShapeError::NotFinite`] if a coefficient is NaN or infinite; [`ShapeError::NotASurface`] if a signal is to be
    /// moved; [`ShapeError::Interrupted`] if the monitor cancels.
    pub fn apply_model(&self, model: &Model, monitor: &dyn Monitor) -> Result<Model, ShapeError> {
        let moves = self.similarity != Similarity::default();
        if moves && model.kind() != Kind::Surface {
            return Err(ShapeError::NotASurface { channels: model.coefficients.channels() });
        }
        let mirrors = if model.kind() == Kind::Surface { self.similarity.mirrors() } else { self.antipodal };
        let mut model = model.clone();
        if self.rotation != Rotation::IDENTITY || self.antipodal {
            model.coefficients = turn(&model.coefficients, &self.rotation, self.antipodal, monitor)?;
            if let Some(sphere) = &mut model.sphere {
                let sign = if self.antipodal { -1.0 } else { 1.0 };
                let turned = sphere.directions.as_slice().iter().map(|&u| self.rotation.apply(u).map(|v| sign * v));
                sphere.directions = Directions::from_vertices(&turned.collect::<Vec<_>>())?;
                sphere.path = None;
                if self.antipodal {
                    sphere.faces.iter_mut().for_each(|face| face.swap(1, 2));
                }
            }
            model.scheme_key = None;
        }
        if moves {
            model.coefficients = transform_object(&model.coefficients, &self.similarity)?;
        }
        finite(&model.coefficients)?;
        let provenance = &mut model.provenance;
        keep_penalty(provenance.settings.as_ref(), &mut provenance.other);
        (provenance.settings, provenance.distances, provenance.surface_rms) = (None, None, None);
        if moves {
            provenance.geometry = None;
            provenance.scale = provenance.scale.map(|scale| scale * self.similarity.scale);
        }
        if mirrors {
            let mirrored = |structure: String| Hemisphere::mirrored_structure(&structure);
            provenance.anatomical_structure_primary = provenance.anatomical_structure_primary.take().map(mirrored);
            if let Some(sphere) = &mut model.sphere {
                sphere.anatomical_structure = sphere.anatomical_structure.take().map(mirrored);
            }
        }
        let step = self.to_json();
        let done = provenance.other.entry("transform").or_insert_with(|| serde_json::json!([]));
        match done {
            serde_json::Value::Array(steps) => steps.push(step),
            // A value that another program wrote to this field is kept as the first step.
            other => *other = serde_json::json!([other.take(), step]),
        }
        Ok(model)
    }
}

/// Moves a surface with coefficients (K, 3): `f'(u) = scale Q f(u) + translation`.
///
/// # Errors
///
/// [`ShapeError::NotFinite`] if a coefficient is NaN or infinite; [`ShapeError::NotASurface`] if the coefficients don't
/// have three columns.
pub fn transform_object(coefficients: &Coefficients, similarity: &Similarity) -> Result<Coefficients, ShapeError> {
    surface(coefficients)?;
    let mut values = coefficients.values().clone();
    let linear = Similarity { translation: [0.0; 3], ..*similarity };
    for mut row in values.rows_mut() {
        let moved = linear.apply([row[0], row[1], row[2]]);
        row.iter_mut().zip(moved).for_each(|(value, moved)| *value = moved);
    }
    for (value, translation) in values.row_mut(0).iter_mut().zip(similarity.translation) {
        *value += SQRT_4_PI * translation;
    }
    let moved = Coefficients::new(values)?;
    finite(&moved)?;
    Ok(moved)
}

fn turn(
    coefficients: &Coefficients,
    rotation: &Rotation,
    antipodal: bool,
    monitor: &dyn Monitor,
) -> Result<Coefficients, ShapeError> {
    let turned = rotate_parameters(coefficients, rotation, monitor)?;
    if !antipodal {
        return Ok(turned);
    }
    // Harmonics have the parity of their degree: S_lm(-u) = (-1)^l S_lm(u).
    let mut values = turned.values().clone();
    for (k, mut row) in values.rows_mut().into_iter().enumerate() {
        if k.isqrt() % 2 == 1 {
            row.mapv_inplace(|v| -v);
        }
    }
    Ok(Coefficients::new(values)?)
}

/// Returns the root mean square distance over the sphere between two surfaces of the same degree,
/// `|a - b| / sqrt(4 pi)`, in their unit.
///
/// # Errors
///
/// [`ShapeError::Differ`] if the degrees or the numbers of columns differ.
pub fn rmsd(a: &Coefficients, b: &Coefficients) -> Result<f64, ShapeError> {
    let ((rows, columns), (other_rows, other_columns)) = (a.values().dim(), b.values().dim());
    for (what, expected, found) in [("coefficients", rows, other_rows), ("channels", columns, other_columns)] {
        if found != expected {
            return Err(ShapeError::Differ { what, expected, found });
        }
    }
    let differences = || a.values().iter().zip(b.values()).map(|(a, b)| (a - b).abs());
    // Differences are scaled so that squares neither overflow nor underflow.
    let largest = differences().fold(0.0, f64::max);
    if largest == 0.0 {
        return Ok(0.0);
    }
    let square: f64 = differences().map(|difference| (difference / largest).powi(2)).sum();
    Ok(square.sqrt() * largest / SQRT_4_PI)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::matrix3::determinant;
    use crate::samples::{blob, some_pose};
    use spharm_monitor::Silent;
    use spharm_surface::Sphere;

    /// The reconstruction has the original's vertices, moved by the transform, and its faces point outwards.
    #[test]
    fn a_models_vertices_move_with_it() {
        let model = Model::new(Sphere::icosphere(2), blob(6, 1), Kind::Surface);
        let before = model.reconstruct(model.own_sphere().unwrap(), 6).unwrap();
        for antipodal in [false, true] {
            let transform = Transform { antipodal, ..some_pose(3) };
            let moved = transform.apply_model(&model, &Silent).unwrap();
            let after = moved.reconstruct(moved.own_sphere().unwrap(), 6).unwrap();
            for (before, after) in before.vertices.iter().zip(&after.vertices) {
                let expected = transform.similarity.apply(*before);
                assert!((0..3).all(|i| (expected[i] - after[i]).abs() < 1e-12), "{expected:?} {after:?}");
            }
            let sphere = moved.own_sphere().unwrap();
            let corners = sphere.faces[0].map(|i| sphere.directions.as_slice()[i as usize]);
            assert!(determinant(&corners) > 0.0);
            assert_eq!(moved.provenance.other["transform"][0]["antipodal"], antipodal);
            assert_eq!(moved.scheme_key, None);
        }
    }

    /// The point of the mirrored surface at a mirrored direction is the mirror image of the surface's point at the
    /// original direction. Reflecting twice is the identity.
    #[test]
    fn a_reflection_mirrors_surface_and_sphere() {
        let surface = blob(6, 2);
        let mirrored = Transform::reflection().apply(&surface, &Silent).unwrap();
        let sphere = Sphere::icosphere(2);
        let flipped: Vec<[f64; 3]> = sphere.directions.as_slice().iter().map(|u| [-u[0], u[1], u[2]]).collect();
        let flipped = Directions::from_vertices(&flipped).unwrap();
        let at = |directions: &Directions, coefficients: &Coefficients| {
            spharm_transform::synthesis(directions, coefficients.values().view()).unwrap()
        };
        let (expected, found) = (at(&flipped, &surface), at(&sphere.directions, &mirrored));
        for (expected, found) in expected.rows().into_iter().zip(found.rows()) {
            for (axis, sign) in [-1.0, 1.0, 1.0].into_iter().enumerate() {
                assert!((sign * expected[axis] - found[axis]).abs() < 1e-12);
            }
        }
        let twice = Transform::reflection().then(&Transform::reflection());
        assert_eq!(twice, Transform::default());
    }

    /// Applying two transforms one after the other equals applying their composition.
    #[test]
    fn transforms_are_composed() {
        let (first, second) = (Transform { antipodal: true, ..some_pose(2) }, some_pose(5));
        let surface = blob(6, 3);
        let in_turn = second.apply(&first.apply(&surface, &Silent).unwrap(), &Silent).unwrap();
        let at_once = first.then(&second).apply(&surface, &Silent).unwrap();
        let apart = in_turn.values() - at_once.values();
        assert!(apart.iter().all(|difference| difference.abs() < 1e-11));
    }

    /// A mirrored surface or signal belongs to the other hemisphere. The hemisphere doesn't change if the model is only
    /// rotated, or if the sphere of a surface is inverted but the surface isn't mirrored.
    #[test]
    fn mirror_images_belong_to_the_other_hemisphere() {
        let flat = Transform { similarity: Similarity::default(), ..Transform::reflection() };
        let turn = Transform { rotation: some_pose(1).rotation, ..Transform::default() };
        for (kind, transform, expected) in [
            (Kind::Surface, Transform::reflection(), "CortexLeft"),
            (Kind::Surface, flat, "CortexRight"),
            (Kind::Signal, flat, "CortexLeft"),
            (Kind::Signal, turn, "CortexRight"),
        ] {
            let mut model = Model::new(Sphere::icosphere(1), blob(4, 1), kind);
            model.provenance.anatomical_structure_primary = Some("CortexRight".to_owned());
            let provenance = transform.apply_model(&model, &Silent).unwrap().provenance;
            assert_eq!(provenance.anatomical_structure_primary.as_deref(), Some(expected), "{kind:?}");
        }
    }

    #[test]
    fn a_signal_turns_but_doesnt_move() {
        let signal = Coefficients::new(ndarray::Array2::ones((9, 3))).unwrap();
        let signal = Model::without_sphere(signal, Kind::Signal);
        let turn = Transform { rotation: some_pose(1).rotation, ..Transform::default() };
        assert!(turn.apply_model(&signal, &Silent).is_ok());
        let found = some_pose(1).apply_model(&signal, &Silent);
        assert!(matches!(found, Err(ShapeError::NotASurface { channels: 3 })), "{found:?}");
    }
}
