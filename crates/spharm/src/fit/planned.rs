//! Defines a sphere whose transforms are planned once, for fits of signals one after another.

use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};

use spharm_solver::{MatrixFreeOperator, MomentNormal, SolverError, moment_normal};
use spharm_store::{Scalar, SchemeKey, WeightsHash};
use spharm_surface::Sphere;
use spharm_transform::{Transform, TransformParams};

use crate::{Error, defaults};

/// A sphere with planned transforms of one degree. Fits of this degree at the sphere's vertices use these transforms
/// instead of planning their own, if the transforms are accurate enough. If a fit computes the
/// [moments](MomentNormal) of the directions, they are kept for later fits with the same weights. Therefore a fit may
/// differ from an earlier fit of the same target, or from a fit without a planned sphere, by an amount within the
/// tolerance.
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
    operator: MatrixFreeOperator,
    /// Moments of the last fit that computed moments.
    moments: Mutex<Option<KeptMoments>>,
    /// Transforms for moments, created when moments are computed for the second time, for example with other weights.
    with_moments: OnceLock<MatrixFreeOperator>,
    key: OnceLock<SchemeKey>,
}

/// The normal matrix that an earlier fit made from moments, kept for later fits.
#[derive(Debug, Clone)]
pub(super) struct KeptMoments {
    weights: WeightsHash,
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
        let operator = MatrixFreeOperator::new(&sphere.directions, params)?;
        let (moments, with_moments, key) = (Mutex::new(None), OnceLock::new(), OnceLock::new());
        Ok(Self { sphere, params: *params, operator, moments, with_moments, key })
    }

    /// Returns the sphere.
    pub fn sphere(&self) -> &Sphere {
        &self.sphere
    }

    /// Returns the transform at the sphere's directions.
    pub fn transform(&self) -> &Transform {
        self.operator.transform()
    }

    /// Returns whether fits of degree `max_degree` use these transforms.
    pub fn serves(&self, max_degree: usize) -> bool {
        max_degree == self.params.max_degree && self.params.accuracy <= defaults::TRANSFORM_ACCURACY
    }

    /// Returns the key of the sphere's sampling scheme in double precision.
    pub(super) fn key(&self) -> SchemeKey {
        if let Some(key) = self.key.get() {
            return *key;
        }
        // Compute the key before initialising the cell. During the initialisation, a thread that waits for other
        // threads' parts of the hash might start another fit, which would wait for the cell: a deadlock.
        let key = SchemeKey::of(&self.sphere.directions, Scalar::F64);
        *self.key.get_or_init(|| key)
    }

    /// Returns the operator at the sphere's directions.
    pub(super) fn operator(&self) -> &MatrixFreeOperator {
        &self.operator
    }

    /// Returns the moments that an earlier fit with these weights computed, if their relative accuracy is at least
    /// `accuracy`.
    pub(super) fn moments(&self, weights: WeightsHash, accuracy: f64) -> Option<KeptMoments> {
        let kept = locked(&self.moments).clone();
        kept.filter(|kept| kept.weights == weights && kept.accuracy <= accuracy)
    }

    /// Computes moments of at least the relative accuracy `accuracy`, and keeps them in place of earlier ones. `hash`
    /// is the hash of the vertices' weights, which are all 1 by default.
    pub(super) fn make_moments(
        &self,
        weights: Option<&[f64]>,
        hash: WeightsHash,
        accuracy: f64,
    ) -> Result<Arc<MomentNormal>, SolverError> {
        let directions = &self.sphere.directions;
        // Moments for other weights are dropped first, to free their memory.
        let again = locked(&self.moments).take().is_some();
        let normal = if again {
            self.with_moments()?.moments(directions, weights, accuracy, None)?.0
        } else {
            moment_normal(directions, weights, self.params.max_degree, accuracy)?
        };
        let normal = Arc::new(normal);
        *locked(&self.moments) = Some(KeptMoments { weights: hash, accuracy, normal: normal.clone() });
        Ok(normal)
    }

    /// Returns the transforms for moments.
    fn with_moments(&self) -> Result<&MatrixFreeOperator, SolverError> {
        if let Some(made) = self.with_moments.get() {
            return Ok(made);
        }
        // Plan before the cell is initialised, for the same reason as in `key`.
        let made = MatrixFreeOperator::with_moments(&self.sphere.directions, &self.params)?;
        Ok(self.with_moments.get_or_init(|| made))
    }
}

fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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

    fn problem() -> (PlannedSphere, Signal) {
        let sphere = Sphere::from_directions(Directions::fibonacci(SAMPLES).unwrap());
        let params = TransformParams { max_degree: DEGREE, accuracy: 1e-12, channels: 1 };
        let values = sphere.directions.as_slice().iter().map(|u| (3.0 * u[0] + u[2]).sin()).collect();
        (PlannedSphere::new(sphere, &params).unwrap(), Signal::new(values, SAMPLES, 1))
    }

    /// Returns the coefficients of a fit on the planned sphere, the names of its steps, and how its matrix products
    /// were computed.
    fn solve(planned: &PlannedSphere, signal: &Signal, params: &FitParams) -> (Vec<f64>, Vec<&'static str>, String) {
        let target = Target::from_signal(signal.clone(), planned.sphere()).unwrap();
        let (fit, report) = planned.fit(target, params, &Silent).unwrap();
        let [BatchReport::LeastSquares { report, .. }] = &report.batches[..] else { panic!("{report:?}") };
        let steps = report.steps.iter().map(|step| step.name).collect();
        (fit.coefficients.values().iter().copied().collect(), steps, report.products.to_owned())
    }

    #[test]
    fn moments_serve_later_fits_with_the_same_weights() {
        let (planned, signal) = problem();
        // This preconditioner needs moments for any number of samples.
        let fine = FitParams::lsq(DEGREE).with_preconditioner(Preconditioner::Density);
        let rough = fine.clone().with_tolerance(1e-6);
        let values = (0..SAMPLES).map(|vertex| 1.0 + (vertex % 3) as f64).collect();
        let weighted = fine.clone().with_weights(Weights::Values { name: "noise".to_owned(), values });
        // Kept moments aren't used if they have insufficient accuracy or other weights. Rough fits use moments that
        // were computed for a fine fit.
        for (params, computes) in [(&rough, true), (&fine, true), (&rough, false), (&weighted, true), (&fine, true)] {
            let (coefficients, steps, _) = solve(&planned, &signal, params);
            assert_eq!(steps.contains(&"moments"), computes, "{steps:?}");
            let (repeated, steps, products) = solve(&planned, &signal, params);
            assert_eq!((&steps[..], &products[..]), (&["iterations by moments", "confirmation"][..], "moments"));
            assert_eq!(coefficients, repeated);
            let alone = fit(planned.sphere(), &signal, params).unwrap();
            let off = alone.coefficients.values().iter().zip(&coefficients).map(|(a, b)| (a - b).abs());
            let most = off.fold(0.0, f64::max);
            assert!(most < 10.0 * params.tolerance, "{most:e}");
        }
    }
    /// A fit with a factor needs no moments: it takes the same steps and the same memory whether or not moments are
    /// kept.
    #[test]
    fn moments_do_not_change_fits_that_need_none() {
        let ((fresh, signal), (planned, _)) = (problem(), problem());
        solve(&planned, &signal, &FitParams::lsq(DEGREE).with_preconditioner(Preconditioner::Density));
        let factor = FitParams::lsq(DEGREE).with_preconditioner(Preconditioner::Factor);
        let target = || Target::from_signal(signal.clone(), fresh.sphere()).unwrap();
        let fits = |memory: usize| fresh.fit(target(), &factor.clone().with_memory(memory), &Silent).is_ok();
        let (mut too_small, mut enough) = (0, 1 << 30);
        while enough - too_small > 1 << 12 {
            let middle = usize::midpoint(too_small, enough);
            if fits(middle) { enough = middle } else { too_small = middle }
        }
        let tight = factor.with_memory(enough);
        assert_eq!(solve(&planned, &signal, &tight), solve(&fresh, &signal, &tight));
    }
}
