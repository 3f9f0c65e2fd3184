//! Defines a sphere whose transforms are planned once, for fits of signals one after another.

use std::sync::{Arc, Mutex, OnceLock, PoisonError};

use spharm_solver::{MatrixFreeOperator, MomentNormal};
use spharm_store::{Scalar, SchemeKey, WeightsHash};
use spharm_surface::Sphere;
use spharm_transform::{Transform, TransformParams};

use crate::{Error, defaults};

/// A sphere with planned transforms of one degree. Fits of this degree at the sphere's vertices use these transforms
/// instead of planning their own, if the transforms are accurate enough. If a fit computes the
/// [moments](MomentNormal) of the directions, they are kept for later fits with the same weights.
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
    operator: Arc<MatrixFreeOperator>,
    /// Moments of the last fit that computed moments.
    moments: Mutex<Option<KeptMoments>>,
    key: OnceLock<SchemeKey>,
}

/// The normal matrix from moments that a fit computed.
#[derive(Debug, Clone)]
pub(super) struct KeptMoments {
    pub(super) weights: WeightsHash,
    /// Relative accuracy of the moments.
    pub(super) accuracy: f64,
    pub(super) normal: Arc<MomentNormal>,
}

impl PlannedSphere {
    /// Plans transforms at the sphere's directions.
    ///
    /// # Errors
    ///
    /// [`Error::Solver`] if the degree or the accuracy is out of range.
    pub fn new(sphere: Sphere, params: &TransformParams) -> Result<Self, Error> {
        let operator = Arc::new(MatrixFreeOperator::new(&sphere.directions, params)?);
        Ok(Self { sphere, params: *params, operator, moments: Mutex::new(None), key: OnceLock::new() })
    }

    /// Returns the sphere.
    pub fn sphere(&self) -> &Sphere {
        &self.sphere
    }

    /// Returns the transform at the sphere's directions.
    pub fn transform(&self) -> &Transform {
        self.operator.transform()
    }

    /// Returns whether fits of a degree use these transforms.
    pub fn serves(&self, max_degree: usize) -> bool {
        max_degree == self.params.max_degree && self.params.accuracy <= defaults::TRANSFORM_ACCURACY
    }

    /// Returns the key of the sphere's sampling scheme in double precision.
    pub(super) fn key(&self) -> SchemeKey {
        *self.key.get_or_init(|| SchemeKey::of(&self.sphere.directions, Scalar::F64))
    }

    /// Returns the operator at the sphere's directions.
    pub(super) fn operator(&self) -> Arc<MatrixFreeOperator> {
        Arc::clone(&self.operator)
    }

    /// Returns the moments that an earlier fit with these weights computed.
    pub(super) fn moments(&self, weights: WeightsHash) -> Option<KeptMoments> {
        let kept = self.moments.lock().unwrap_or_else(PoisonError::into_inner);
        kept.clone().filter(|kept| kept.weights == weights)
    }

    /// Keeps the moments of a fit for later fits with the same weights.
    pub(super) fn keep(&self, made: KeptMoments) {
        *self.moments.lock().unwrap_or_else(PoisonError::into_inner) = Some(made);
    }
}

#[cfg(test)]
mod tests {
    use spharm_harmonics::Directions;
    use spharm_surface::{Signal, Target};

    use super::*;
    use crate::report::BatchReport;
    use crate::{FitParams, Preconditioner, Silent, Weights, fit};

    const SAMPLES: usize = 10_000;
    const DEGREE: usize = 12;

    /// Returns the coefficients of a fit on the planned sphere, and the names of its steps.
    fn solve(planned: &PlannedSphere, signal: &Signal, params: &FitParams) -> (Vec<f64>, Vec<&'static str>) {
        let target = Target::from_signal(signal.clone(), planned.sphere()).unwrap();
        let (fit, report) = planned.fit(target, params, &Silent).unwrap();
        let [BatchReport::LeastSquares { report, .. }] = &report.batches[..] else { panic!("{report:?}") };
        (fit.coefficients.values().iter().copied().collect(), report.steps.iter().map(|step| step.name).collect())
    }

    #[test]
    fn moments_serve_later_fits_with_the_same_weights() {
        let sphere = Sphere::from_directions(Directions::fibonacci(SAMPLES).unwrap());
        let planned =
            PlannedSphere::new(sphere, &TransformParams { max_degree: DEGREE, accuracy: 1e-12, channels: 1 }).unwrap();
        let values = planned.sphere().directions.as_slice().iter().map(|u| (3.0 * u[0] + u[2]).sin()).collect();
        let signal = Signal::new(values, SAMPLES, 1);
        // This preconditioner needs moments for any number of samples.
        let fine = FitParams::lsq(DEGREE).with_preconditioner(Preconditioner::Density);
        let rough = fine.clone().with_tolerance(1e-6);
        let values = (0..SAMPLES).map(|vertex| 1.0 + (vertex % 3) as f64).collect();
        let weighted = fine.clone().with_weights(Weights::Values { name: "noise".to_owned(), values });
        // Moments of insufficient accuracy, or of other weights, aren't used. Finer moments serve rough fits.
        for (params, computes) in [(&rough, true), (&fine, true), (&rough, false), (&weighted, true), (&fine, true)] {
            let (coefficients, steps) = solve(&planned, &signal, params);
            assert_eq!(steps.contains(&"moments"), computes, "{steps:?}");
            let (repeated, steps) = solve(&planned, &signal, params);
            assert_eq!(steps, ["iterations by moments", "confirmation"]);
            assert_eq!(coefficients, repeated);
            let alone = fit(planned.sphere(), &signal, params).unwrap();
            let off = alone.coefficients.values().iter().zip(&coefficients).map(|(a, b)| (a - b).abs());
            let most = off.fold(0.0, f64::max);
            assert!(most < 10.0 * params.tolerance, "{most:e}");
        }
    }
}
