//! Defines a sphere whose transforms are planned once, for fits of signals one after another.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use spharm_solver::MatrixFreeOperator;
use spharm_store::{Scalar, SchemeKey};
use spharm_surface::Sphere;
use spharm_transform::{Transform, TransformParams};

use crate::{Error, defaults};

/// A sphere with planned transforms of one degree. Fits of this degree at the sphere's vertices use these transforms
/// instead of planning their own, if the transforms are accurate enough.
///
/// ```
/// use spharm::harmonics::Directions;
/// use spharm::transform::TransformParams;
/// use spharm::{FitParams, Monitor, PlannedSphere, Silent, Signal, Sphere, Target};
///
/// let sphere = Sphere::from_directions(Directions::fibonacci(1000)?);
/// let planned = PlannedSphere::new(sphere, &TransformParams { max_degree: 8, accuracy: 1e-12, channels: 1 })?;
/// for power in 1..4 {
///     let values: Vec<f64> = planned.sphere().directions.as_slice().iter().map(|u| u[2].powi(power)).collect();
///     let target = Target::from_signal(Signal::new(values, 1000, 1), planned.sphere())?;
///     let (fit, _) = planned.fit(target, &FitParams::lsq(8), &Silent)?;
///     assert!(fit.report.optimality.is_some_and(|optimality| optimality < 1e-10));
/// }
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct PlannedSphere {
    sphere: Sphere,
    params: TransformParams,
    plain: Arc<MatrixFreeOperator>,
    /// Transforms that share their sorted directions with the transforms that compute moments. Created by the first fit
    /// that computes moments.
    with_moments: Mutex<Option<Arc<MatrixFreeOperator>>>,
    key: OnceLock<SchemeKey>,
}

impl PlannedSphere {
    /// Plans transforms at the sphere's directions.
    ///
    /// # Errors
    ///
    /// [`Error::Solver`] if the degree or the accuracy is out of range.
    pub fn new(sphere: Sphere, params: &TransformParams) -> Result<Self, Error> {
        let plain = Arc::new(MatrixFreeOperator::new(&sphere.directions, params)?);
        Ok(Self { sphere, params: *params, plain, with_moments: Mutex::new(None), key: OnceLock::new() })
    }

    /// Returns the sphere.
    pub fn sphere(&self) -> &Sphere {
        &self.sphere
    }

    /// Returns the transform at the sphere's directions.
    pub fn transform(&self) -> &Transform {
        self.plain.transform()
    }

    /// Returns whether fits of a degree use these transforms.
    pub fn serves(&self, max_degree: usize) -> bool {
        max_degree == self.params.max_degree && self.params.accuracy <= defaults::TRANSFORM_ACCURACY
    }

    /// Returns the key of the sphere's sampling scheme in double precision.
    pub(super) fn key(&self) -> SchemeKey {
        *self.key.get_or_init(|| SchemeKey::of(&self.sphere.directions, Scalar::F64))
    }

    /// Returns the transforms. If `moments` is set, they share their sorted directions with the transforms that compute
    /// moments.
    pub(super) fn operator(&self, moments: bool) -> Result<Arc<MatrixFreeOperator>, Error> {
        if !moments {
            return Ok(Arc::clone(&self.plain));
        }
        let mut made = self.with_moments.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(made) = &*made {
            return Ok(Arc::clone(made));
        }
        let new = Arc::new(MatrixFreeOperator::with_moments(&self.sphere.directions, &self.params)?);
        Ok(Arc::clone(made.insert(new)))
    }
}
