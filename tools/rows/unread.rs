//! Vertices that aren't read: those that a mask leaves out, and those of signals without a value. They have the weight 0.

use std::path::Path;

use anyhow::{Result, bail};
use rayon::prelude::*;
use spharm::cohort::Row;
use spharm::{FitParams, Method, Sphere, Weights};
use spharm_surface::Signal;
use spharm_surface::io::{is_named_signal, read_signal, read_signal_with_gaps};

/// Weights with those of the vertices at zero that a mask has at 0.
pub(super) fn masked(weights: &Weights, mask: &Path, sphere: &Sphere) -> Result<Weights> {
    let (path, expected) = (mask.display(), sphere.directions.len());
    let Signal { values: mask, vertices, channels } = read_signal(mask)?;
    if channels != 1 || vertices != expected {
        bail!("{path}: expected a value for each of {expected} vertices, found {vertices} x {channels}");
    }
    if mask.iter().all(|keep| *keep == 0.0) {
        bail!("{path}: no vertex is left to read: all values are 0");
    }
    let name = match weights {
        Weights::Uniform => format!("mask {path}"),
        _ => format!("{}, mask {path}", weights.name()),
    };
    Ok(without(weights, sphere, name, |vertex| mask[vertex] == 0.0))
}

/// Weights that are 0 at some vertices.
fn without(weights: &Weights, sphere: &Sphere, name: String, leave_out: impl Fn(usize) -> bool) -> Weights {
    let mut values = match weights {
        Weights::Uniform => vec![1.0; sphere.directions.len()],
        Weights::Area => sphere.areas(),
        Weights::Values { values, .. } if values.len() == sphere.directions.len() => values.clone(),
        // Refused by the fit, with its own message.
        other @ Weights::Values { .. } => return other.clone(),
    };
    values.iter_mut().enumerate().filter(|(vertex, _)| leave_out(*vertex)).for_each(|(_, weight)| *weight = 0.0);
    Weights::Values { name, values }
}

/// Rows that leave out the same vertices.
pub(super) struct Part {
    /// Numbers of the rows.
    pub(super) rows: Vec<usize>,
    /// Settings with the weights of these rows.
    pub(super) params: FitParams,
    /// Number of vertices that aren't read.
    pub(super) unread: usize,
}

/// Sorts the rows with these numbers by the vertices that have no value, of signals that are fitted by least squares without a
/// store. Other methods refuse values that aren't there.
pub(super) fn parts(rows: &[Row], numbers: &[usize], sphere: &Sphere, params: &FitParams) -> Result<Vec<Part>> {
    let gaps_of = |number: usize| match (params.method, &params.store) {
        (Method::Lsq, None) => gaps(&rows[number].surface, sphere.directions.len()),
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
        let params = match gaps.is_empty() {
            true => params.clone(),
            false => {
                let name = params.weights.name().to_owned();
                FitParams { weights: without(&params.weights, sphere, name, |vertex| gaps[vertex]), ..params.clone() }
            }
        };
        let unread = match &params.weights {
            Weights::Values { values, .. } => values.iter().filter(|weight| **weight == 0.0).count(),
            _ => 0,
        };
        if unread == sphere.directions.len() {
            bail!("{}: no vertex is left to read", rows[numbers[0]].surface.display());
        }
        Ok(Part { rows: numbers, params, unread })
    };
    parts.into_iter().map(part).collect()
}

/// Whether each vertex has no value; empty if all have one.
fn gaps(path: &Path, vertices: usize) -> Vec<bool> {
    if !is_named_signal(path) {
        return Vec::new();
    }
    // Other files, and those that can't be read, are refused when they are fitted.
    let Ok(signal) = read_signal_with_gaps(path) else { return Vec::new() };
    let none = |row: &[f64]| row.iter().any(|x| x.is_nan());
    let gaps: Vec<bool> = signal.values.chunks_exact(signal.channels.max(1)).map(none).collect();
    if gaps.len() == vertices && gaps.contains(&true) { gaps } else { Vec::new() }
}
