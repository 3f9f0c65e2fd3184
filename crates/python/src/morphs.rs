//! Computes shapes between two models.

use pyo3::prelude::*;
use spharm::Kind;
use spharm::model::made;
use spharm::shape::morph::{Morph, default_method, volume_ratio, volume_warning};
use spharm::shape::{AlignParams, Method};
use spharm::{Error, Monitor};

use crate::errors::Failure;
use crate::models::Model;
use crate::poses::refuse_signals;
use crate::run::run_owned;

/// Returns the models at the given times, from 0 (start) to 1 (end). `fixed` states whether both models keep their
/// parameters; by default, they do if they are members of one group and `mirror` isn't set. Also returns a ratio of
/// volumes, and warnings. The ratio is the volume at time 0.5 divided by the smaller of the volumes at the start and
/// the end.
#[pyfunction]
#[pyo3(signature = (start, end, times, *, fixed, keep_pose, mirror, threads = None, progress = None))]
#[expect(clippy::too_many_arguments, reason = "each argument is a Python keyword argument")]
pub(crate) fn shape_morph(
    py: Python<'_>,
    start: PyRef<'_, Model>,
    end: PyRef<'_, Model>,
    times: Vec<f64>,
    fixed: Option<bool>,
    keep_pose: bool,
    mirror: bool,
    threads: Option<usize>,
    progress: Option<Bound<'_, PyAny>>,
) -> PyResult<(Vec<Model>, f64, Vec<String>)> {
    let (start, end) = (start.inner.clone(), end.inner.clone());
    let (models, ratio, warnings) = run_owned(py, threads, progress.as_ref(), move |monitor| {
        refuse_signals("start", std::slice::from_ref(&start))?;
        refuse_signals("end", std::slice::from_ref(&end))?;
        let method = match fixed {
            Some(true) => Method::FixedParameters,
            Some(false) => Method::Joint,
            None => default_method(&start, &end, mirror),
        };
        let params = AlignParams { method, mirror, scale: false, ..AlignParams::default() };
        let morph = Morph::new(&start.coefficients, &end.coefficients, &params, keep_pose, monitor)?;
        let ratio = volume_ratio(&morph, monitor)?;
        let at = |&time: &f64| -> Result<spharm::Model, Failure> {
            Monitor::check(monitor).map_err(Error::from)?;
            Ok(made(morph.at(time)?, Kind::Surface, "shape morph"))
        };
        let models = times.iter().map(at).collect::<Result<Vec<_>, _>>()?;
        let mut warnings: Vec<String> = morph.alignment.report.warnings.iter().map(ToString::to_string).collect();
        warnings.extend(volume_warning(ratio));
        Ok((models, ratio, warnings))
    })?;
    Ok((models.into_iter().map(|inner| Model { inner }).collect(), ratio, warnings))
}
