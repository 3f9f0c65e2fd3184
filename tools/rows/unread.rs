//! Vertices that aren't read: those that a mask leaves out, and those without a value.
//!
//! The fit is then over the other vertices alone, and so are its distances. The model has the whole sphere.

use std::path::Path;

use anyhow::{Result, bail};
use rayon::prelude::*;
use spharm::cohort::Row;
use spharm::{Directions, FitParams, Method, Sphere, Target, Weights};
use spharm_surface::Signal;
use spharm_surface::io::{is_named_signal, read_signal, read_signal_with_gaps};

/// Weights with those of the vertices at zero that a mask has at 0.
pub(super) fn masked(weights: &Weights, mask: &Path, sphere: &Sphere) -> Result<Weights> {
    let (path, expected) = (mask.display(), sphere.directions.len());
    let Signal { values: mask, vertices, channels } = read_signal(mask)?;
    if channels != 1 || vertices != expected {
        bail!("{path}: expected a value for each of {expected} vertices, found {vertices} x {channels}");
    }
    let (name, values) = match weights {
        Weights::Uniform => (format!("mask {path}"), vec![1.0; expected]),
        Weights::Area => (format!("area, mask {path}"), sphere.areas()),
        Weights::Values { name, values } if values.len() == expected => {
            (format!("{name}, mask {path}"), values.clone())
        }
        // Refused with its own words by the fit.
        other => return Ok(other.clone()),
    };
    let values = values.iter().zip(&mask).map(|(weight, keep)| if *keep == 0.0 { 0.0 } else { *weight }).collect();
    Ok(Weights::Values { name, values })
}

/// Rows that leave out the same vertices.
pub(super) struct Part {
    /// Numbers of the rows.
    pub(super) rows: Vec<usize>,
    /// The vertices that are read; none where all are.
    pub(super) kept: Option<Kept>,
}

/// The vertices that are read.
pub(super) struct Kept {
    rows: Vec<usize>,
    /// How many others there are.
    unread: usize,
    /// The sphere at these vertices alone.
    pub(super) sphere: Sphere,
    /// The settings with their weights.
    pub(super) params: FitParams,
}

/// Sorts the rows with these numbers by the vertices that they leave out. Signals are looked at for values that are missing
/// where the method allows for that.
pub(super) fn parts(
    rows: &[Row],
    numbers: &[usize],
    sphere: &Sphere,
    params: &FitParams,
    masked: bool,
) -> Result<Vec<Part>> {
    let able = params.method == Method::Lsq && params.store.is_none();
    if !able || !masked && numbers.iter().all(|&number| !is_named_signal(&rows[number].surface)) {
        return Ok(vec![Part { rows: numbers.to_vec(), kept: None }]);
    }
    let unread = |&number: &usize| {
        let gaps = gaps(&rows[number].surface, sphere.directions.len());
        let unread = match &params.weights {
            _ if gaps.is_empty() && !masked => gaps,
            Weights::Values { values, .. } => {
                let gap = |vertex: usize| gaps.get(vertex).copied().unwrap_or(false);
                values.iter().enumerate().map(|(vertex, &weight)| weight == 0.0 || gap(vertex)).collect()
            }
            _ => gaps,
        };
        (number, unread)
    };
    let mut parts: Vec<(Vec<bool>, Vec<usize>)> = Vec::new();
    for (number, unread) in numbers.par_iter().map(unread).collect::<Vec<_>>() {
        match parts.iter_mut().find(|(other, _)| *other == unread) {
            Some((_, rows)) => rows.push(number),
            None => parts.push((unread, vec![number])),
        }
    }
    let part = |(unread, numbers): (Vec<bool>, Vec<usize>)| {
        let first = &rows[numbers[0]].surface;
        let kept = unread.contains(&true).then(|| Kept::new(&unread, sphere, params, first)).transpose()?;
        Ok(Part { rows: numbers, kept })
    };
    parts.into_iter().map(part).collect()
}

/// Whether each vertex has no value; empty where all have one.
fn gaps(path: &Path, vertices: usize) -> Vec<bool> {
    if !is_named_signal(path) {
        return Vec::new();
    }
    // A surface in a file that may hold either, or a file that can't be read, is told of when its turn comes.
    let Ok(signal) = read_signal_with_gaps(path) else { return Vec::new() };
    let none = |row: &[f64]| row.iter().any(|x| x.is_nan());
    let gaps: Vec<bool> = signal.values.chunks_exact(signal.channels.max(1)).map(none).collect();
    if gaps.len() == vertices && gaps.contains(&true) { gaps } else { Vec::new() }
}

impl Kept {
    fn new(unread: &[bool], sphere: &Sphere, params: &FitParams, first: &Path) -> Result<Self> {
        let rows: Vec<usize> = (0..unread.len()).filter(|&vertex| !unread[vertex]).collect();
        if rows.is_empty() {
            bail!("{}: no vertex is left to read", first.display());
        }
        let vectors = rows.iter().map(|&vertex| sphere.directions.as_slice()[vertex]).collect();
        let weights = match &params.weights {
            Weights::Uniform => Weights::Uniform,
            weights => {
                let all = if let Weights::Values { values, .. } = weights { values.clone() } else { sphere.areas() };
                let values = rows.iter().filter_map(|&vertex| all.get(vertex).copied()).collect();
                Weights::Values { name: weights.name().to_owned(), values }
            }
        };
        // Without triangles: a surface is fitted at its vertices.
        let sphere = Sphere {
            path: sphere.path.clone(),
            anatomical_structure: sphere.anatomical_structure.clone(),
            ..Sphere::from_directions(Directions::from_unit_vectors(vectors)?)
        };
        Ok(Self { unread: unread.len() - rows.len(), rows, sphere, params: FitParams { weights, ..params.clone() } })
    }

    /// How many vertices are not read.
    pub(super) fn unread(&self) -> usize {
        self.unread
    }

    /// How many vertices are read.
    pub(super) fn count(&self) -> usize {
        self.rows.len()
    }

    /// A target at these vertices.
    pub(super) fn of(&self, target: Target) -> Target {
        let channels = target.channels;
        let row = |&vertex: &usize| target.values.get(vertex * channels..(vertex + 1) * channels).unwrap_or_default();
        let values = self.rows.iter().flat_map(row).copied().collect();
        Target { values, ..target }
    }

    /// Reads a signal some of whose values are missing.
    pub(super) fn read(&self, path: &Path, sphere: &Sphere) -> Result<Option<Target>> {
        if !is_named_signal(path) {
            return Ok(None);
        }
        let Ok(mut signal) = read_signal_with_gaps(path) else { return Ok(None) };
        signal.values.iter_mut().filter(|x| x.is_nan()).for_each(|x| *x = 0.0);
        let target = Target::from_signal(signal, sphere)?;
        Ok(Some(Target { path: Some(path.to_owned()), ..target }))
    }
}
