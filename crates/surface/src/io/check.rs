//! Checks every surface and signal that is read or written.

use std::path::Path;

use super::spec::{FormatSpec, Precision};
use crate::error::SurfaceError;
use crate::mesh::{Input, Mesh, Signal};

/// Largest number of vertices, since vertices are counted in u32.
const MOST_VERTICES: usize = u32::MAX as usize;
/// Largest number of triangles, since half-edges (three per triangle) are counted in u32.
const MOST_FACES: usize = (u32::MAX / 3) as usize;

pub(super) fn input(path: &Path, input: &Input) -> Result<(), SurfaceError> {
    match input {
        Input::Mesh(m) => mesh(path, m),
        Input::Signal(s) => signal(path, s),
    }
}

/// Checks that a mesh has vertices and triangles, that positions are finite and that indices are in range. Every mesh
/// that is read or written is checked. Error messages call the mesh `path`, for example "the surface".
///
/// # Errors
///
/// [`Empty`](SurfaceError::Empty) if there are no vertices or no triangles; [`TooLarge`](SurfaceError::TooLarge) if
/// there are too many to count in 32 bits; [`NonFinite`](SurfaceError::NonFinite) if a position isn't finite;
/// [`IndexOutOfRange`](SurfaceError::IndexOutOfRange) if a triangle refers to a missing vertex.
pub fn mesh(path: &Path, mesh: &Mesh) -> Result<(), SurfaceError> {
    mesh_with_gaps(path, mesh)?;
    for (vertex, position) in mesh.vertices.iter().enumerate() {
        if let Some(&value) = position.iter().find(|x| !x.is_finite()) {
            return Err(SurfaceError::NonFinite { path: path.to_owned(), vertex, value });
        }
    }
    Ok(())
}

/// Checks a mesh as [`mesh`] does, but allows positions that aren't finite.
pub(crate) fn mesh_with_gaps(path: &Path, mesh: &Mesh) -> Result<(), SurfaceError> {
    let (vertices, faces) = (mesh.vertices.len(), mesh.faces.len());
    for (count, limit, one, many) in
        [(vertices, MOST_VERTICES, "vertex", "vertices"), (faces, MOST_FACES, "triangle", "triangles")]
    {
        if count == 0 {
            return Err(SurfaceError::Empty { path: path.to_owned(), what: one });
        }
        if count > limit {
            return Err(SurfaceError::TooLarge { path: path.to_owned(), what: many, found: count, limit });
        }
    }
    indices(path, mesh)
}

/// Checks that the triangles' indices are in range.
pub(crate) fn indices(path: &Path, mesh: &Mesh) -> Result<(), SurfaceError> {
    let vertices = mesh.vertices.len();
    for (face, corners) in mesh.faces.iter().enumerate() {
        if let Some(&index) = corners.iter().find(|&&i| i as usize >= vertices) {
            return Err(SurfaceError::IndexOutOfRange { path: path.to_owned(), face, index, vertices });
        }
    }
    Ok(())
}

/// Checks that a signal has values and that the values are finite.
pub(crate) fn signal(path: &Path, signal: &Signal) -> Result<(), SurfaceError> {
    signal_without(path, signal, |x| !x.is_finite())
}

/// Checks a signal that is to be written. The signal must have values, which may be NaN but not infinite.
pub(super) fn written_signal(path: &Path, signal: &Signal) -> Result<(), SurfaceError> {
    signal_without(path, signal, f64::is_infinite)
}

fn signal_without(path: &Path, signal: &Signal, bad: impl Fn(f64) -> bool) -> Result<(), SurfaceError> {
    signal_with_gaps(path, signal)?;
    match signal.values.iter().position(|x| bad(*x)) {
        None => Ok(()),
        Some(i) => Err(SurfaceError::NonFinite {
            path: path.to_owned(),
            vertex: i / signal.channels,
            value: signal.values.get(i).copied().unwrap_or(f64::NAN),
        }),
    }
}

/// Checks a signal as [`signal`] does, but allows values that aren't finite.
pub(crate) fn signal_with_gaps(path: &Path, signal: &Signal) -> Result<(), SurfaceError> {
    if signal.values.is_empty() {
        return Err(SurfaceError::Empty { path: path.to_owned(), what: "value" });
    }
    if signal.vertices.checked_mul(signal.channels) != Some(signal.values.len()) {
        return Err(SurfaceError::LengthMismatch {
            what: "values of the signal",
            expected: signal.vertices.saturating_mul(signal.channels),
            found: signal.values.len(),
        });
    }
    Ok(())
}

/// Checks that positions stay finite when rounded to 32-bit floats, and that not all of them become 0. A mere loss of
/// digits is accepted.
pub(super) fn fits_f32(path: &Path, vertices: &[[f64; 3]], format: &FormatSpec) -> Result<(), SurfaceError> {
    let values = vertices.as_flattened();
    fits(path, values, 3, format)
}

/// Checks that a signal's finite values stay finite when rounded to 32-bit floats, and that not all of them become 0.
pub(super) fn values_fit_f32(path: &Path, signal: &Signal, format: &FormatSpec) -> Result<(), SurfaceError> {
    fits(path, &signal.values, signal.channels, format)
}

fn fits(path: &Path, values: &[f64], channels: usize, format: &FormatSpec) -> Result<(), SurfaceError> {
    let finite = || values.iter().enumerate().filter(|(_, x)| x.is_finite());
    let too_large = finite().find(|(_, x)| !(**x as f32).is_finite());
    let all_too_small = || {
        let largest = finite().max_by(|(_, a), (_, b)| a.abs().total_cmp(&b.abs()));
        largest.filter(|(_, x)| **x != 0.0 && **x as f32 == 0.0)
    };
    match too_large.or_else(all_too_small) {
        None => Ok(()),
        Some((i, &value)) => Err(SurfaceError::NotRepresentable {
            path: path.to_owned(),
            vertex: i / channels,
            value,
            remedy: match format.precision {
                Precision::Choice => "write 64-bit floats (--double, in Python double=True)",
                _ => "write another format, such as .surf.gii with 64-bit floats",
            },
        }),
    }
}
