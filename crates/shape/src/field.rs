//! Measures a group of models at the vertices of a common sphere, as input for statistical tests.

use ndarray::{Array2, Axis, s};
use spharm_harmonics::{Coefficients, Directions};
use spharm_monitor::{Monitor, Stage};
use spharm_transform::{FINEST, Transform, TransformParams};

use crate::extent::finite;
use crate::mean::mean;
use crate::{MeasureParams, ShapeError, local_geometry, measure};

/// The quantity measured at a vertex.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Measurement {
    /// Displacement from the group's mean along the mean's outward normal: one component, in the unit of length.
    Normal,
    /// Position: three components.
    Position,
    /// Value of a function on the sphere: one component.
    Value,
}

/// Measurements of n models at V vertices.
#[derive(Debug, Clone)]
pub struct Field {
    /// Measured values (n, V d): a row for each model, with the d components of each vertex in adjacent columns.
    pub values: Array2<f64>,
    /// Number of components per vertex, d.
    pub components: usize,
    /// Mean of all models.
    pub mean: Coefficients,
}

impl Field {
    /// Returns the differences between paired models: each model of the first half minus the model at the same
    /// position in the second half. `mean` remains the mean of all models.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Setting`] if the number of models is odd.
    pub fn differences(self) -> Result<Self, ShapeError> {
        let models = self.values.nrows();
        let half = models / 2;
        if models % 2 == 1 {
            let (found, expected) = (models.to_string(), "it must be even");
            return Err(ShapeError::Setting { name: "the number of paired models", found, expected });
        }
        let values = &self.values.slice(s![..half, ..]) - &self.values.slice(s![half.., ..]);
        Ok(Self { values, ..self })
    }

    /// Returns the field at the vertices that the mask `kept` (V) selects; the mean is unchanged.
    ///
    /// # Errors
    ///
    /// [`ShapeError::Differ`] if the length of the mask isn't V.
    pub fn at(self, kept: &[bool]) -> Result<Self, ShapeError> {
        let (components, columns) = (self.components, self.values.ncols());
        if kept.len() * components != columns {
            let (expected, found) = (columns / components.max(1), kept.len());
            return Err(ShapeError::Differ { what: "number of vertices of the mask", expected, found });
        }
        let columns: Vec<usize> = (0..columns).filter(|column| kept[column / components]).collect();
        Ok(Self { values: self.values.select(Axis(1), &columns), ..self })
    }
}

/// Measures a group of models at directions, up to the first model's degree; the other models must have at least that
/// degree. Memory: `8 n V d` bytes for n models and d components at each of V directions, and the memory of a
/// transform.
///
/// # Errors
///
/// [`ShapeError::TooFewMembers`] if there are no models; [`ShapeError::Differ`] if a model's number of channels doesn't
/// match the measurement or its degree is below the first model's; [`ShapeError::NotFinite`] if a coefficient is NaN or
/// infinite; [`ShapeError::Transform`] if the transform fails; [`ShapeError::Interrupted`] if the monitor cancels.
pub fn measure_group(
    group: &[Coefficients],
    directions: &Directions,
    measurement: Measurement,
    monitor: &dyn Monitor,
) -> Result<Field, ShapeError> {
    let channels = if measurement == Measurement::Value { 1 } else { 3 };
    for model in group {
        if model.channels() != channels {
            return Err(ShapeError::Differ { what: "channels", expected: channels, found: model.channels() });
        }
        finite(model)?;
    }
    let mean = mean(group)?;
    let degree = mean.max_degree();
    let components = if measurement == Measurement::Position { 3 } else { 1 };
    let mut values = Array2::zeros((group.len(), directions.len() * components));
    let normals = match measurement {
        Measurement::Normal => {
            let points = local_geometry(&mean, directions, monitor)?;
            // Makes the normals point outwards, regardless of the parameterisation's orientation. Only the sign of
            // the volume is used, so the area needn't be accurate.
            let params = MeasureParams { tolerance: 1.0, ..MeasureParams::default() };
            let sign = if measure(&mean, &params, monitor)?.inwards { -1.0 } else { 1.0 };
            Some(points.into_iter().map(|p| p.normal.map(|n| sign * n)).collect::<Vec<_>>())
        }
        _ => None,
    };
    let params = TransformParams { max_degree: degree, accuracy: FINEST, channels };
    let transform = Transform::new(directions, &params)?;
    monitor.begin(Stage::counted("evaluate", "models"), group.len() as u64);
    for (model, mut row) in group.iter().zip(values.rows_mut()) {
        monitor.check()?;
        let found = match &normals {
            Some(_) => transform.synthesis((&model.up_to(degree) - mean.values()).view())?,
            None => transform.synthesis(model.up_to(degree))?,
        };
        match &normals {
            Some(normals) => {
                for ((value, found), normal) in row.iter_mut().zip(found.rows()).zip(normals) {
                    *value = found[0] * normal[0] + found[1] * normal[1] + found[2] * normal[2];
                }
            }
            None => row.iter_mut().zip(found.slice(s![.., ..]).iter()).for_each(|(value, found)| *value = *found),
        }
        monitor.step(1);
    }
    monitor.end();
    Ok(Field { values, components, mean })
}

#[cfg(test)]
mod tests {
    use super::*;
    use spharm_monitor::Silent;

    fn sphere(radius: f64, turned: bool) -> Coefficients {
        let mut values = Array2::zeros((9, 3));
        let size = radius * (4.0 * std::f64::consts::PI / 3.0).sqrt();
        let sign = if turned { -1.0 } else { 1.0 };
        (values[[3, 0]], values[[1, 1]], values[[2, 2]]) = (sign * size, size, size);
        values[[0, 1]] = 40.0;
        Coefficients::new(values).unwrap()
    }

    #[test]
    fn displacements_of_spheres_are_their_radii() {
        let directions = Directions::fibonacci(60).unwrap();
        for turned in [false, true] {
            let group = [sphere(1.0, turned), sphere(2.0, turned), sphere(6.0, turned)];
            let found = measure_group(&group, &directions, Measurement::Normal, &Silent).unwrap();
            for (row, off) in found.values.rows().into_iter().zip([-2.0, -1.0, 3.0]) {
                assert!(row.iter().all(|value| (value - off).abs() < 1e-12), "{turned} {row}");
            }
            let positions = measure_group(&group, &directions, Measurement::Position, &Silent).unwrap();
            assert_eq!((positions.values.ncols(), positions.components), (180, 3));
            let centre = 40.0 / (4.0 * std::f64::consts::PI).sqrt();
            let y = positions.values[[2, 3 * 7 + 1]] - centre;
            assert!((y - 6.0 * directions.as_slice()[7][1]).abs() < 1e-12);
        }
    }

    #[test]
    fn pairs_of_models_are_subtracted() {
        let directions = Directions::fibonacci(20).unwrap();
        let group = [4.0, 5.0, 1.0, 3.0].map(|radius| sphere(radius, false));
        let found = measure_group(&group, &directions, Measurement::Normal, &Silent).unwrap().differences().unwrap();
        assert_eq!(found.values.nrows(), 2);
        for (row, off) in found.values.rows().into_iter().zip([3.0, 2.0]) {
            assert!(row.iter().all(|value| (value - off).abs() < 1e-12), "{row}");
        }
        let odd = measure_group(&group[..3], &directions, Measurement::Position, &Silent).unwrap();
        assert!(odd.differences().is_err());
    }

    #[test]
    fn models_that_do_not_fit_are_refused() {
        let directions = Directions::fibonacci(10).unwrap();
        let scalar = Coefficients::new(Array2::ones((4, 1))).unwrap();
        let measure = |group: &[Coefficients]| measure_group(group, &directions, Measurement::Normal, &Silent);
        assert!(measure(&[]).is_err() && measure(&[scalar]).is_err());
        let low = Coefficients::new(Array2::ones((4, 3))).unwrap();
        assert!(matches!(measure(&[sphere(1.0, false), low]), Err(ShapeError::Differ { what: "degree", .. })));
    }
}
