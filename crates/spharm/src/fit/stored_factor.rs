//! Looks in the store for the Cholesky factor that a fit needs.

use spharm_monitor::{Level, Monitor};
use spharm_solver::StoredFactor;
use spharm_store::factor::{factors, open_factor};
use spharm_store::{FactorSpec, Scalar, SchemeKey, WeightsHash};

use super::job::Job;
use crate::{Error, FitWarning};

/// Returns the factor in the store that matches this fit, or `None` if the store has none. A factor of at most `memory`
/// bytes is kept in memory as a whole.
pub(super) fn stored_factor(
    job: &Job<'_>,
    smoothness: f64,
    memory: usize,
    warnings: &mut Vec<FitWarning>,
    monitor: &dyn Monitor,
) -> Result<Option<StoredFactor>, Error> {
    job.params.store.as_deref().map(spharm_store::catalog::schemes).transpose()?;
    // Factors in the store are computed with unscaled weights and smoothness, so a fit with scaled weights can't use
    // them.
    let Some(store) = job.params.store.as_ref().filter(|_| job.weight_exponent == 0) else { return Ok(None) };
    let mut refused = None;
    // Look for the scheme with either scalar type of the basis.
    for scalar in [Scalar::F64, Scalar::F32] {
        let spec = FactorSpec {
            key: SchemeKey::of(&job.sphere.directions, scalar),
            rows: job.sphere.directions.len(),
            max_degree: job.params.max_degree,
            weights: WeightsHash::of(job.weights.as_deref()),
            smoothness,
        };
        // Skip this scalar type if the store has no folder or no factors for the scheme's basis of this type.
        if !store.join(spec.key.to_string()).exists() || factors(store, spec.key)?.is_empty() {
            continue;
        }
        match open_factor(store, &spec, None) {
            Ok(file) => return Ok(Some(StoredFactor::new(file, memory, job.threads))),
            Err(error) => refused = Some(error),
        }
    }
    match refused {
        Some(error) => warnings.push(FitWarning::FactorUnusable { reason: error.to_string() }),
        None => {
            let store = store.display();
            monitor.note(Level::Info, format_args!("{store}: no Cholesky factor for this sphere; fitting without one"));
        }
    }
    Ok(None)
}
