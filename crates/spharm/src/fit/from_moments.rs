//! Computes the full least squares from the moments of samples. The samples themselves aren't needed.

use ndarray::{Array2, s};
use serde::Serialize;
use spharm_harmonics::{Coefficients, basis_size};
use spharm_model::{Fitted, Provenance, Settings};
use spharm_moments::Moments;
use spharm_monitor::{Level, Monitor};
use spharm_solver::lsq::{Denoise, Gcv, LsqReport, MomentFit, MomentProblem, NoisePower, solve_moments};
use spharm_solver::{LsqParams, MomentNormal, SolverError};
use spharm_store::{Scalar, SchemeKey};
use spharm_surface::Kind;
use spharm_surface::range::times;
use spharm_transform::MomentGram;

use super::denoise::{merge, parts, set_columns};
use super::range::{restore_moments, restore_search, smoothness_into_range, sums_into_range};
use super::shared::{check_auto, converged, strategy};
use super::undetermined;
use super::{by_channel, in_pool};
use crate::{Error, FitParams, FitWarning, Model, Smoothness};

/// A fit from moments.
#[derive(Debug, Clone)]
pub struct MomentsFit {
    /// Canonical coefficients: one row per basis function, one column per channel.
    pub coefficients: Coefficients,
    /// Standard errors of the coefficients, if requested, in an array of the coefficients' shape.
    pub standard_errors: Option<Array2<f64>>,
    /// Report on the fit.
    pub report: MomentsReport,
    /// Provenance of the model.
    provenance: Provenance,
}

/// Report on a fit from moments.
#[derive(Debug, Clone, Serialize)]
#[non_exhaustive]
pub struct MomentsReport {
    /// Key of the sampling scheme if the samples are at its vertices; `None` for samples elsewhere.
    #[serde(skip)]
    pub scheme: Option<SchemeKey>,
    /// Names of the c channels.
    pub channels: Vec<String>,
    /// Number of samples with nonzero weight.
    pub samples: u64,
    /// Sum of the weights.
    pub weight: f64,
    /// Root of the weighted mean squared residual of each channel, in the channel's unit; `None` if rounding errors
    /// hide the residual.
    pub rms: Vec<Option<f64>>,
    /// Share of `sum w f^2` that the model explains, for each channel, with weights w and values f of the samples;
    /// `None` if rounding errors hide the residual.
    pub explained: Vec<Option<f64>>,
    /// Diameter of the largest cap without samples, in degrees. Its accuracy is limited by the resolution of the
    /// moments.
    pub largest_gap: f64,
    /// Resolution at the highest degree, `pi / L`, in degrees; `None` at degree 0.
    pub resolved: Option<f64>,
    /// The noise that was estimated and removed: one entry for a surface, or one per channel. Empty without denoising.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub denoise: Vec<Denoise>,
    /// The solver's report.
    pub solver: LsqReport,
    /// The search for the smoothness, if it was chosen by cross-validation.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gcv: Option<Gcv>,
    /// Possible problems with the fit.
    pub warnings: Vec<FitWarning>,
}

/// Fits samples, given by their moments, to any degree up to that of the moments. Of `params`, only degree, smoothness,
/// denoising, standard errors, tolerance, iterations, preconditioner, strictness, memory and threads are used.
///
/// ```
/// use spharm::moments::{Request, accumulate};
/// use spharm::{FitParams, Silent, fit_moments};
///
/// // f = 1 + sin(latitude) at 200 places.
/// let folder = tempfile::tempdir()?;
/// let table = folder.path().join("f.csv");
/// let rows = (0..200).map(|i| {
///     let sine = 1.0 - (2.0 * i as f64 + 1.0) / 200.0;
///     format!("{},{},{}\n", (137.5 * i as f64) % 360.0, sine.asin().to_degrees(), 1.0 + sine)
/// });
/// std::fs::write(&table, format!("lon,lat,f\n{}", rows.collect::<String>()))?;
/// let mut request = Request::new(vec![table], 4);
/// request.columns.values = vec!["f".to_owned()];
/// let moments = accumulate(&request, &Silent)?.moments;
/// let fit = fit_moments(&moments, &FitParams::lsq(2), &Silent)?;
/// assert!(fit.report.rms[0].is_some_and(|rms| rms < 1e-6));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
///
/// [`Error::Solver`] if the degree is above that of the moments, or standard errors of undetermined coefficients are
/// requested; [`Error::Memory`] if memory doesn't suffice; [`Error::NotConverged`] if `params` are strict and the
/// tolerance isn't met; [`Error::Setting`] if a setting or a sum of squares is out of range, or rounding errors hide a
/// residual that standard errors, denoising or the choice of the smoothness require.
pub fn fit_moments(moments: &Moments, params: &FitParams, monitor: &dyn Monitor) -> Result<MomentsFit, Error> {
    params.check()?;
    in_pool(params.threads, || solve(moments, params, monitor))
}

fn solve(moments: &Moments, params: &FitParams, monitor: &dyn Monitor) -> Result<MomentsFit, Error> {
    let (max_degree, channels) = (params.max_degree, moments.channels.len());
    let functions = basis_size(max_degree);
    let budget = params.memory_budget();
    let threads = rayon::current_num_threads();
    // Memory of the sums, of the copies of the sums in the problem, and of the vectors of the conjugate gradients.
    let sums = 8 * (moments.sums.moments.len() + moments.sums.right_sides.len());
    let held = 2 * sums + 64 * functions * channels + MomentNormal::bytes(max_degree, channels, threads);
    if held > budget {
        return Err(Error::Memory { budget, needed: held });
    }
    check_range(moments)?;
    let scaled = sums_into_range(&moments.sums, is_surface(&moments.channels));
    let none = (vec![0; channels], 0);
    let (sums, (exponents, weight_exponent)) = match scaled {
        Some((ref sums, exponents, weights)) => (sums, (exponents, weights)),
        None => (&moments.sums, none),
    };
    let problem = MomentProblem::new(sums, max_degree).map_err(Error::from)?;
    let mut gcv = match params.smoothness {
        Smoothness::Auto => {
            check_auto(problem.rows(), max_degree)?;
            let kind = if is_surface(&moments.channels) { Kind::Surface } else { Kind::Signal };
            let chosen = by_channel::choose(&problem, &parts(&(0..channels), kind), monitor);
            Some(chosen.map_err(|error| refused(error, "smoothness auto", moments))?)
        }
        _ => None,
    };
    let smoothness = match (&gcv, params.smoothness) {
        (Some(gcv), _) => gcv.smoothness,
        (None, Smoothness::Fixed(smoothness)) => smoothness_into_range(smoothness, weight_exponent),
        _ => 0.0,
    };
    let solver = LsqParams {
        smoothness,
        strategy: strategy(params.preconditioner),
        tolerance: params.tolerance,
        max_iterations: params.max_iterations,
        memory: budget,
        held,
        gram_bytes: MomentGram::bytes(max_degree),
        ..LsqParams::default()
    };
    let lambdas = gcv.as_ref().map_or(&[][..], |gcv| &gcv.by_channel);
    let mut found = by_channel::solve(&problem, &solver, lambdas, params.standard_errors && !params.denoise, monitor)
        .map_err(|error| refused(error, "stderr", moments))?;
    let squares = found.residual_squares.iter().zip(&found.lost).filter(|(_, lost)| !**lost).map(|(sum, _)| sum);
    let amplified = FitWarning::of_amplified(&found.report, squares.sum::<f64>() / sums.weight);
    // Check for a factor before denoising, which adds the times of its own fits to the report.
    let has_factor = found.report.seconds.factor > 0.0;
    let (mut denoised, relative_noise) = match params.denoise {
        true => denoise(&problem, &solver, params, &mut found, moments, monitor)?,
        false => (Vec::new(), 1.0),
    };
    let largest_gap = moments.occupied.largest_gap().to_degrees();
    let resolved = (max_degree > 0).then(|| 180.0 / max_degree as f64);
    let mut warnings = FitWarning::of_lsq(&found.report, params.tolerance, None);
    let gap = undetermined::warning(moments, &problem, &solver, (&found.report, has_factor), largest_gap, monitor)?;
    let amplified = amplified.filter(|_| !params.denoise && gap.is_none() && found.report.shift == 0.0);
    let hidden = |removed: &Denoise| FitWarning::of_noise(relative_noise, &removed.gain, max_degree);
    warnings.extend(gap.into_iter().chain(amplified).chain(denoised.iter().find_map(hidden)));
    warnings.extend(doubts(moments, &found.lost));
    let converged = converged(params, &warnings)?;
    let text = format_args!("{} iterations, optimality {:.1e}", found.report.iterations, found.report.optimality);
    monitor.note(Level::Detail, text);
    let mean = |(square, e): (&f64, &i32)| times((square / sums.weight).sqrt(), *e);
    let known = |(value, lost): (f64, &bool)| (!lost).then_some(value);
    let rms = found.residual_squares.iter().zip(&exponents).map(mean).zip(&found.lost).map(known).collect();
    let share = |(left, all): (&f64, &f64)| if *all > 0.0 { 1.0 - left / all } else { 1.0 };
    let explained = found.residual_squares.iter().zip(&sums.squares).map(share).zip(&found.lost).map(known).collect();
    restore_moments(&mut found, &exponents, weight_exponent);
    for (removed, e) in denoised.iter_mut().zip(&exponents) {
        removed.sigma = times(removed.sigma, e + weight_exponent / 2);
    }
    if let Some(gcv) = &mut gcv {
        restore_search(gcv, exponents.iter().copied().max().unwrap_or(0), weight_exponent);
    }
    if let Some(((row, channel), &found)) = found.coefficients.values().indexed_iter().find(|(_, x)| !x.is_finite()) {
        return Err(Error::NotFinite { row, channel, found });
    }
    let provenance = provenance(params, &found.report, converged);
    let report = MomentsReport {
        scheme: moments.scheme,
        channels: moments.channels.clone(),
        samples: moments.sums.count,
        weight: moments.sums.weight,
        rms,
        explained,
        largest_gap,
        resolved,
        denoise: denoised,
        solver: found.report,
        gcv,
        warnings,
    };
    Ok(MomentsFit { coefficients: found.coefficients, standard_errors: found.standard_errors, report, provenance })
}

/// Returns warnings about residuals that are unknown because of rounding errors, and about missing shards of the
/// samples.
fn doubts(moments: &Moments, lost: &[bool]) -> Vec<FitWarning> {
    let hidden = moments.channels.iter().zip(lost).filter(|(_, lost)| **lost);
    let channels: Vec<String> = hidden.map(|(channel, _)| channel.clone()).collect();
    let missing = moments.missing_shards();
    let hidden = (!channels.is_empty()).then_some(FitWarning::LostResidual { channels });
    let partial = (!missing.is_empty()).then_some(FitWarning::MissingShards { missing });
    hidden.into_iter().chain(partial).collect()
}

/// Converts an error of the solver into the error to return. `what` is the setting that caused it, such as `stderr`.
fn refused(error: SolverError, what: &'static str, moments: &Moments) -> Error {
    let SolverError::LostResidual { column } = error else { return error.into() };
    let channel = moments.channels.get(column).map_or("", String::as_str);
    Error::Setting {
        what,
        expected: "moments precise enough to compute the residual",
        found: format!(
            "a mean of channel {channel:?} so large that rounding errors hide the residual; subtract a constant, such \
             as the mean, from the values and compute the moments again, or leave out this channel"
        ),
    }
}

/// Returns an error if sums of squares have overflowed, or have lost digits by underflow.
fn check_range(moments: &Moments) -> Result<(), Error> {
    moments.out_of_range().map_or(Ok(()), |channel| {
        Err(Error::Setting {
            what: "a fit from moments",
            expected: "sums of squares from 1e-307 to 1e308",
            found: format!(
                "sums outside this range for column {channel}; scale the values and compute the moments again"
            ),
        })
    })
}

/// Returns whether the channels are the coordinates x, y and z of a surface.
fn is_surface(channels: &[String]) -> bool {
    matches!(channels, [x, y, z] if [x, y, z] == ["x", "y", "z"])
}

/// Replaces the plain fit by penalised fits: one for a surface, or one for each channel of a signal. Returns the
/// removed noise, and the power of the noise in degree 1 relative to its power on an even sampling.
fn denoise(
    problem: &MomentProblem,
    solver: &LsqParams,
    params: &FitParams,
    found: &mut MomentFit,
    moments: &Moments,
    monitor: &dyn Monitor,
) -> Result<(Vec<Denoise>, f64), Error> {
    if let Some(column) = found.lost.iter().position(|&lost| lost) {
        return Err(refused(SolverError::LostResidual { column }, "denoise", moments));
    }
    let power = NoisePower::of_moments(problem, monitor)?;
    let mut coefficients = found.coefficients.values().to_owned();
    let mut errors = params.standard_errors.then(|| Array2::zeros(coefficients.dim()));
    let mut denoised = Vec::new();
    let kind = if is_surface(&moments.channels) { Kind::Surface } else { Kind::Signal };
    for part in parts(&(0..problem.channels()), kind) {
        let residual = found.residual_squares[part.clone()].iter().sum();
        let removed = power.denoise(coefficients.slice(s![.., part.clone()]), residual);
        let solver = LsqParams { penalty: Some(removed.penalty.clone()), ..solver.clone() };
        let fit = solve_moments(&problem.of_columns(part.clone()), &solver, params.standard_errors, monitor)?;
        set_columns(&mut coefficients, &part, fit.coefficients.values().view());
        found.residual_squares[part.clone()].copy_from_slice(&fit.residual_squares);
        if let (Some(errors), Some(of_part)) = (&mut errors, &fit.standard_errors) {
            set_columns(errors, &part, removed.with_uncertain_gains(of_part.clone()).view());
        }
        merge(&mut found.report, fit.report);
        denoised.push(removed);
    }
    found.coefficients = Coefficients::new(coefficients)?;
    found.standard_errors = errors;
    Ok((denoised, power.relative_to_even(problem.weight())))
}

fn provenance(params: &FitParams, report: &LsqReport, converged: bool) -> Provenance {
    Provenance {
        tool: Some("fit".to_owned()),
        versions: Some(crate::versions()),
        settings: Some(Settings {
            method: params.method.name().to_owned(),
            objective: Some("samples".to_owned()),
            area: None,
            passes: params.method.passes(),
            granularity: None,
            start_degree: None,
            accelerate: false,
            weights: "moments".to_owned(),
            weights_blake3: None,
            hold_out: None,
            tolerance: Some(params.tolerance),
            max_iterations: Some(params.max_iterations),
            preconditioner: Some(params.preconditioner.to_string()),
            optimality: Some(report.optimality),
            converged: Some(converged),
            smoothness_choice: Some(params.penalty_name().to_owned()),
            smoothness: report.smoothness,
            dtype: Scalar::F64.name().to_owned(),
        }),
        ..Provenance::default()
    }
}

impl MomentsFit {
    /// Returns the model: a surface if the channels are x, y and z, else a signal. The model has no sphere. If the
    /// samples are at the vertices of a sampling scheme, the model has the scheme's key.
    #[must_use]
    pub fn model(&self) -> Model {
        let surface = is_surface(&self.report.channels);
        let scheme_key = self.report.scheme.map(|key| key.to_string());
        let fitted =
            Fitted { coefficients: self.coefficients.clone(), scheme_key, provenance: self.provenance.clone() };
        Model::without_sphere(fitted, if surface { Kind::Surface } else { Kind::Signal })
    }
}

#[cfg(test)]
mod tests {
    use std::fmt;
    use std::sync::Mutex;

    use spharm_harmonics::Directions;
    use spharm_moments::{Part, Samples, accumulate_samples};
    use spharm_monitor::Silent;

    use super::*;
    use crate::Preconditioner;

    /// A monitor that records the notes of level `Info`.
    #[derive(Default)]
    struct Notes(Mutex<Vec<String>>);

    impl Monitor for Notes {
        fn note(&self, level: Level, text: fmt::Arguments<'_>) {
            if level == Level::Info {
                self.0.lock().unwrap().push(text.to_string());
            }
        }
    }

    /// Samples with a wide gap around a pole are checked by a second fit only if the first fit has no factor.
    #[test]
    fn a_fit_with_a_factor_is_not_repeated() {
        let all = Directions::fibonacci(2000).unwrap();
        let places: Vec<f64> = all.as_slice().iter().filter(|v| v[2] < 0.8).flatten().copied().collect();
        let directions = Array2::from_shape_vec((places.len() / 3, 3), places).unwrap();
        let samples = Samples { directions: directions.view(), values: directions.slice(s![.., 2..]), weights: None };
        let moments = accumulate_samples(&samples, vec!["f".to_owned()], 6, &Part::default(), &Silent).unwrap();
        for (preconditioner, expected) in [(Preconditioner::None, 1), (Preconditioner::Factor, 0)] {
            let notes = Notes::default();
            let params = FitParams { preconditioner, ..FitParams::lsq(6) };
            let report = fit_moments(&moments, &params, &notes).unwrap().report;
            assert!(report.resolved.is_some_and(|resolved| report.largest_gap > resolved));
            assert!(!report.warnings.iter().any(|warning| matches!(warning, FitWarning::Gap { .. })));
            let notes = notes.0.into_inner().unwrap();
            let checks = notes.iter().filter(|note| note.contains("whether the samples determine the fit")).count();
            assert_eq!(checks, expected, "{preconditioner}: {notes:?}");
        }
    }
}
