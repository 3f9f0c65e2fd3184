//! Makes the targets of fits, and checks them before any work starts.

use std::path::Path;

use ndarray::ArrayView2;
use rayon::prelude::*;
use spharm::{Error, FitParams, Kind, Mesh, Signal, Sphere, Target};
use spharm_surface::{Hemisphere, Input, TargetWarning};

use crate::errors::Failure;
use crate::metadata::{Metadata, with_metadata};

/// Applies a mask to the settings, if a mask is given.
pub(crate) fn masked(params: FitParams, mask: Option<&[bool]>, sphere: &Sphere) -> Result<FitParams, Error> {
    mask.map_or(Ok(params.clone()), |keep| params.masked(keep, sphere))
}

/// If the settings are strict, returns an error for a sphere that has a warning.
pub(crate) fn refuse_doubtful(sphere: &Sphere, params: &FitParams) -> Result<(), Failure> {
    match sphere.warnings.first().filter(|_| params.strict) {
        Some(warning) => Err(Failure::Argument(format!("the sphere: {warning}"))),
        None => Ok(()),
    }
}

/// Returns the warnings of a target. If the settings are strict, returns the first warning as an error. The warning
/// that a surface isn't closed is omitted, because the surface's sphere has the same triangles and the same warning.
pub(crate) fn doubts(target: &Target, params: &FitParams) -> Result<Vec<String>, Failure> {
    let warnings = target.warnings.iter().filter(|warning| !matches!(warning, TargetWarning::NotClosed(_)));
    named(target.path.as_deref(), warnings, params)
}

/// Returns a warning if the mask of a surface without a sphere belongs to the other hemisphere. If the settings are
/// strict, returns this warning as an error.
pub(crate) fn doubts_of_mask(
    metadata: Option<&Metadata>,
    mask: Option<&Path>,
    params: &FitParams,
) -> Result<Vec<String>, Failure> {
    let path = metadata.and_then(Metadata::path);
    let own = Hemisphere::of(metadata.and_then(Metadata::structure), path);
    let other = mask.and_then(|mask| TargetWarning::of_mask(own, mask));
    named(path, other.iter(), params)
}

/// Returns warnings about a surface, each of which begins with the surface's name. If the settings are strict, returns
/// the first warning as an error.
fn named<'a>(
    path: Option<&Path>,
    warnings: impl Iterator<Item = &'a TargetWarning>,
    params: &FitParams,
) -> Result<Vec<String>, Failure> {
    let name = path.unwrap_or(Path::new("the surface")).display();
    let found: Vec<String> = warnings.map(|warning| format!("{name}: {warning}")).collect();
    match found.first().filter(|_| params.strict) {
        Some(first) => Err(Failure::Argument(first.clone())),
        None => Ok(found),
    }
}

/// Returns the target of a fit. If no triangles are given for a surface, the triangles of the sphere are used.
pub(crate) fn target(
    values: ArrayView2<'_, f64>,
    triangles: Option<&[[u32; 3]]>,
    surface: bool,
    sphere: &Sphere,
    metadata: Option<Metadata>,
) -> Result<Target, Error> {
    let (vertices, channels) = values.dim();
    let triangles = triangles.unwrap_or(&sphere.faces);
    let flat = copied(values);
    let path = metadata.as_ref().and_then(Metadata::path).map(Path::to_owned);
    let contents = if surface && channels == 3 && !triangles.is_empty() {
        let mesh = Mesh::new(flat.as_chunks().0.to_vec(), triangles.to_vec());
        Input::Mesh(with_metadata(mesh, metadata))
    } else {
        Input::Signal(Signal::new(flat, vertices, channels))
    };
    let target = Target::with_gaps(contents, path.as_deref(), sphere)?;
    let kind = if surface { Kind::Surface } else { Kind::Signal };
    Ok(Target { kind, ..target })
}

/// Copies values on all threads of the current pool, because the system spends most of the time of a copy on providing
/// new memory pages.
fn copied(values: ArrayView2<'_, f64>) -> Vec<f64> {
    const PART: usize = 1 << 16;
    let Some(values) = values.as_slice() else {
        return values.iter().copied().collect();
    };
    values.par_iter().with_min_len(PART).copied().collect()
}
