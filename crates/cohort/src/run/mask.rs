//! Applies weights, masks and missing values. Vertices outside a mask, and vertices of signals without a value, get
//! weight 0. Vertices outside a row's region get values that are extrapolated from the region's edge.

use std::path::Path;

use rayon::prelude::*;
use spharm::parametrize::fill_in;
use spharm::{Fit, FitParams, Kind, Method, Model, Monitor, Sphere, Target, Weights};
use spharm_surface::io::{may_hold_signal, read_mask, read_signal_with_gaps};

use super::error::RunError;
use crate::Row;

/// Returns the settings of the fit, with the row's weights if the row specifies any.
pub(super) fn weighted(params: &FitParams, row: &Row) -> Result<FitParams, RunError> {
    let weights = match row.weights.as_deref().map(|path| (path, path.to_str())) {
        None => return Ok(params.clone()),
        Some((_, Some("uniform"))) => Weights::Uniform,
        Some((_, Some("area"))) => Weights::Area,
        Some((path, _)) if !path.exists() => return Err(RunError::NoWeights { path: path.to_owned() }),
        Some((path, _)) => Weights::read(path)?,
    };
    Ok(params.clone().with_weights(weights))
}

/// Returns the weights, set to 0 at the vertices at which the mask is 0.
pub(super) fn masked(weights: &Weights, mask: &Path, sphere: &Sphere) -> Result<Weights, RunError> {
    let path = mask.display();
    let keep = read_mask(mask, sphere.directions.len())?;
    let name = match weights {
        Weights::Uniform => format!("mask {path}"),
        _ => format!("{}, mask {path}", weights.name()),
    };
    Ok(weights.masked(&keep, name, sphere)?)
}

/// Those rows of a group whose fits ignore the same vertices.
pub(super) struct Part {
    /// Indices of the rows.
    pub(super) rows: Vec<usize>,
    /// Settings of the fits of these rows, including the weights, which are 0 at ignored vertices.
    pub(super) params: FitParams,
    /// Number of vertices that the fit ignores.
    pub(super) left_out: usize,
}

/// Splits the rows with the given indices into parts. The signals of each part have missing values at the same
/// vertices. Missing values are accepted only for signals that are fitted by least squares without a store. Other fits
/// refuse signals with missing values.
pub(super) fn parts(
    rows: &[Row],
    numbers: &[usize],
    sphere: &Sphere,
    params: &FitParams,
) -> Result<Vec<Part>, RunError> {
    let gaps_of = |number: usize| match (params.method, &params.store) {
        (Method::Lsq, None) => gaps(&rows[number], sphere.directions.len()),
        _ => Vec::new(),
    };
    let mut parts: Vec<(Vec<bool>, Vec<usize>)> = Vec::new();
    for (number, gaps) in numbers.par_iter().map(|&number| (number, gaps_of(number))).collect::<Vec<_>>() {
        match parts.iter_mut().find(|(other, _)| *other == gaps) {
            Some((_, rows)) => rows.push(number),
            None => parts.push((gaps, vec![number])),
        }
    }
    let part = |(gaps, numbers): (Vec<bool>, Vec<usize>)| {
        let nothing = || RunError::NothingToRead { path: rows[numbers[0]].surface.clone() };
        let params = match gaps.is_empty() {
            true => params.clone(),
            false => {
                let keep: Vec<bool> = gaps.iter().map(|gap| !gap).collect();
                if !keep.contains(&true) {
                    return Err(nothing());
                }
                let name = params.weights.name().to_owned();
                params.clone().with_weights(params.weights.masked(&keep, name, sphere)?)
            }
        };
        let left_out = match &params.weights {
            Weights::Values { values, .. } => values.iter().filter(|weight| **weight == 0.0).count(),
            _ => 0,
        };
        if left_out == sphere.directions.len() {
            return Err(nothing());
        }
        Ok(Part { rows: numbers, params, left_out })
    };
    parts.into_iter().map(part).collect()
}

/// Extrapolates the values of a signal from the edge of a region to the vertices outside it. `region` is the file of a
/// mask or label.
pub(super) fn continue_from(
    region: &Path,
    target: &mut Target,
    sphere: &Sphere,
    monitor: &dyn Monitor,
) -> Result<(), RunError> {
    let channels = target.channels.max(1);
    let mut known = read_mask(region, sphere.directions.len())?;
    // NaN and infinite values inside the region aren't replaced by extrapolation. NaN means a missing value, which gets
    // weight 0, see `gaps`; the fit refuses infinite values.
    let mut not_finite: Vec<(usize, Vec<f64>)> = Vec::new();
    for (vertex, (known, values)) in known.iter_mut().zip(target.values.chunks_exact(channels)).enumerate() {
        if *known && !values.iter().all(|value| value.is_finite()) {
            *known = false;
            not_finite.push((vertex, values.to_vec()));
        }
    }
    fill_in(&mut target.values, target.channels, &known, &sphere.faces, monitor)?;
    for (vertex, values) in not_finite {
        target.values[channels * vertex..channels * (vertex + 1)].copy_from_slice(&values);
    }
    Ok(())
}

/// Compares the model's values at ignored vertices with the range of its values at the other vertices. Returns a
/// warning if a value is outside this range by more than the width of the range.
pub(super) fn runaway(name: &str, fit: &Fit, params: &FitParams, sphere: &Sphere) -> Result<Option<String>, RunError> {
    let Weights::Values { values: weights, .. } = &params.weights else { return Ok(None) };
    let model = Model::without_sphere(fit.coefficients.clone(), Kind::Signal);
    let found = model.reconstruct_signal(sphere, fit.coefficients.max_degree())?;
    for channel in 0..found.channels {
        let range = |unread: bool| {
            let values = found.values.iter().skip(channel).step_by(found.channels).zip(weights);
            let values = values.filter(|(_, weight)| (**weight == 0.0) == unread).map(|(value, _)| *value);
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| [low.min(value), high.max(value)])
        };
        let ([low, high], [least, most]) = (range(false), range(true));
        // For a constant channel, the width would be zero, so at least a bound on rounding errors is used.
        let width = (high - low).max(1e-6 * low.abs().max(high.abs()));
        if least < low - width || most > high + width {
            return Ok(Some(format!(
                "{name}: the model ranges from {least:.4} to {most:.4} at excluded vertices, where the data don't \
                 determine it, but only from {low:.4} to {high:.4} at the other vertices; this affects means, modes \
                 and maps of whole models: lower the degree or set a smoothness"
            )));
        }
    }
    Ok(None)
}

/// Returns, for each vertex, whether its value is missing, or an empty vector if no value is missing. Missing values
/// outside the row's region aren't counted, because they are replaced by extrapolated values.
fn gaps(row: &Row, vertices: usize) -> Vec<bool> {
    let path = &row.surface;
    if row.region.is_none() && !may_hold_signal(path) {
        return Vec::new();
    }
    // A file that isn't a signal or can't be read is refused later, by the fit.
    let Ok(signal) = read_signal_with_gaps(path) else { return Vec::new() };
    let none = |row: &[f64]| row.iter().any(|x| x.is_nan());
    let mut gaps: Vec<bool> = signal.values.chunks_exact(signal.channels.max(1)).map(none).collect();
    if let Some(Ok(region)) = row.region.as_ref().map(|region| read_mask(region, vertices)) {
        gaps.iter_mut().zip(region).for_each(|(gap, inside)| *gap &= inside);
    }
    if gaps.len() == vertices && gaps.contains(&true) { gaps } else { Vec::new() }
}

#[cfg(test)]
mod tests {
    use spharm::Signal;
    use spharm_surface::io::{WriteOptions, write_mesh, write_signal};

    use super::*;

    #[test]
    fn missing_values_are_found_in_curv_files_of_any_name() {
        let folder = tempfile::tempdir().unwrap();
        let of = |name: &str| Row { surface: folder.path().join(name), ..Row::default() };
        let signal = Signal::new(vec![f64::NAN, 1.0, 2.0], 3, 1);
        for name in ["lh.thickness", "lh.thickness.fwhm10", "lh.mydata"] {
            write_signal(folder.path().join(name), &signal, &WriteOptions::default()).unwrap();
            assert_eq!(gaps(&of(name), 3), [true, false, false], "{name}");
        }
        let mesh = Sphere::icosphere(0).to_mesh();
        write_mesh(folder.path().join("lh.other"), &mesh, &WriteOptions::default()).unwrap();
        assert!(gaps(&of("lh.other"), 12).is_empty());
    }
}
