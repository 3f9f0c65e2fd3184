//! Computes the Cholesky factor of the normal equations over a sphere once, and stores it for all fits over that
//! sphere.

use std::path::Path;

use spharm_monitor::Monitor;
use spharm_solver::cholesky::{FactorParams, FactorPlan, FactorReport, build_factor, plan_stored_factor};
use spharm_solver::gram::{Penalised, smoothness_penalty};
use spharm_solver::{SolverError, moment_gram, moment_gram_bytes};
use spharm_store::factor::open_factor;
use spharm_store::{FactorSpec, Scalar, SchemeKey, StoreError, WeightsHash};
use spharm_surface::Sphere;

use crate::Error;
use crate::machine::check_limits;

/// Reciprocal condition number below which a warning reports that solutions lose most of their digits.
const ILL_CONDITIONED: f64 = 1e-12;

/// Settings of a factor.
#[derive(Debug, Clone)]
pub struct FactorSettings {
    /// Highest degree of the coefficients to solve for.
    pub max_degree: usize,
    /// Scalar type of the basis. The factor is stored in the folder of this basis.
    pub basis_scalar: Scalar,
    /// Scalar type of the factor.
    pub scalar: Scalar,
    /// Smoothness penalty lambda, 0 or more: adds `lambda sum (l (l + 1))^2 a_lm^2` over the coefficients a_lm to the
    /// squared distances.
    pub smoothness: f64,
    /// Memory budget in bytes.
    pub memory: usize,
    /// Number of threads; 0 for the number of threads of the caller's rayon pool.
    pub threads: usize,
    /// Whether to build a factor even if it is larger than 64 GiB or than the free disk space.
    pub allow_large: bool,
}

/// A planned factor. Memory and disk space are known to suffice for it.
#[derive(Debug)]
pub struct PlannedFactor<'a> {
    store: &'a Path,
    sphere: &'a Sphere,
    spec: FactorSpec,
    params: FactorParams,
    plan: Option<FactorPlan>,
}

impl<'a> PlannedFactor<'a> {
    /// Plans a factor, without computing or writing anything.
    ///
    /// # Errors
    ///
    /// [`StoreError::Budget`], [`StoreError::Space`] or [`Error::Limit`] if memory or disk space don't suffice for the
    /// factor.
    pub fn new(store: &'a Path, sphere: &'a Sphere, settings: &FactorSettings) -> Result<Self, Error> {
        let rows = sphere.directions.len();
        let spec = FactorSpec {
            key: SchemeKey::of(&sphere.directions, settings.basis_scalar),
            rows,
            max_degree: settings.max_degree,
            weights: WeightsHash::ONES,
            smoothness: settings.smoothness,
        };
        let params = FactorParams {
            scalar: settings.scalar,
            memory: settings.memory,
            // The memory of the moments, and of the sphere's directions and triangles.
            held: moment_gram_bytes(rows, settings.max_degree)? + 24 * rows + 12 * sphere.faces.len(),
            threads: settings.threads,
            allow_large: settings.allow_large,
            ..FactorParams::default()
        };
        let plan = if open_factor(store, &spec, Some(params.scalar)).is_ok() {
            None
        } else {
            let (plan, _) = plan_stored_factor(store, spec.size(), &params)?;
            check_limits(plan.memory + plan.reserved, 0)?;
            Some(plan)
        };
        Ok(Self { store, sphere, spec, params, plan })
    }

    /// Returns the required memory and disk space, or `None` for a factor that is already in the store.
    pub fn plan(&self) -> Option<FactorPlan> {
        self.plan
    }

    /// Computes the factor and publishes it in the store, unless the store already has it.
    ///
    /// # Errors
    ///
    /// [`SolverError::NotPositiveDefinite`] if the sphere doesn't determine the coefficients,
    /// [`StoreError::Interrupted`] if the monitor stopped the call, and other errors if the store can't be read or
    /// written.
    pub fn build(&self, monitor: &dyn Monitor) -> Result<FactorReport, Error> {
        let Self { store, sphere, spec, params, .. } = self;
        let source = moment_gram(&sphere.directions, None, spec.max_degree)?;
        let penalised = Penalised::new(&source, smoothness_penalty(spec.max_degree, spec.smoothness));
        build_factor(store, spec, &penalised, params, monitor).map_err(|error| match error {
            // Convert an interruption to the store's error, whose message also says that finished files are kept.
            SolverError::Interrupted(interrupted) => StoreError::from(interrupted).into(),
            error => error.into(),
        })
    }
}

/// Returns the condition number of a factor's matrix if it is so large that solutions lose most of their digits.
pub fn ill_conditioned(report: &FactorReport) -> Option<f64> {
    let reciprocal = report.file.header().condition.reciprocal;
    (reciprocal < ILL_CONDITIONED).then_some(1.0 / reciprocal)
}
