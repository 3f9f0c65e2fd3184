//! Measures distances between corresponding vertices, and the scale of a surface.

use crate::error::SurfaceError;
use crate::geometry::{Vec3, bounds, dot, sub};
use crate::mesh::Mesh;
use crate::range::{scaled_meshes, times, times_within};
use crate::topology::different_triangles;

/// Distances between a surface and its reconstruction, vertex by vertex.
///
/// `msd` and `xsd` are defined as in Shen and Chung (3DPVT 2006, section 4.2): mean and maximum of the squared
/// distances after the surface is scaled such that its axis-aligned bounding box has volume 1.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Distances {
    /// Mean squared distance for a bounding box of volume 1.
    pub msd: f64,
    /// Maximal squared distance for a bounding box of volume 1.
    pub xsd: f64,
    /// Mean squared distance, in squared units of the coordinates (mm^2).
    pub msd_raw: f64,
    /// Maximal squared distance, in squared units of the coordinates (mm^2).
    pub xsd_raw: f64,
    /// Square root of the mean squared distance, in units of the coordinates (mm). It is correct even if its square is
    /// outside of f64's range, in which case `msd_raw` is clamped.
    pub rms_raw: f64,
    /// Square root of the maximal squared distance, in units of the coordinates (mm). It is correct even if `xsd_raw`
    /// is clamped.
    pub max_raw: f64,
    /// Index of the vertex with the maximal distance.
    pub worst_vertex: usize,
    /// [`bounding_box_scale`] of the original, in units of the coordinates.
    pub scale: f64,
}

/// Returns (dx dy dz)^(1/3), with dx, dy, dz the extents of the axis-aligned bounding box. Coordinates divided by this
/// scale have a bounding box of volume 1.
///
/// # Errors
///
/// [`FlatBox`](SurfaceError::FlatBox) if the box's volume is zero or not finite.
pub fn bounding_box_scale(vertices: &[[f64; 3]]) -> Result<f64, SurfaceError> {
    let (low, high) = bounds(vertices.iter().copied());
    let [x, y, z] = sub(high, low);
    // The roots are taken first, since the product of the extents can overflow or underflow although the result
    // doesn't.
    let scale = x.cbrt() * y.cbrt() * z.cbrt();
    if [x, y, z].iter().all(|&d| d > 0.0) && scale.is_finite() && scale > 0.0 {
        Ok(scale)
    } else {
        Err(SurfaceError::FlatBox { x, y, z })
    }
}

/// Returns |original - reconstruction|^2 at each vertex, in squared units of the coordinates.
///
/// # Errors
///
/// [`LengthMismatch`](SurfaceError::LengthMismatch) if the numbers of vertices differ.
pub fn squared_distances(original: &[[f64; 3]], reconstruction: &[[f64; 3]]) -> Result<Vec<f64>, SurfaceError> {
    if original.len() != reconstruction.len() {
        return Err(SurfaceError::LengthMismatch {
            what: "vertices of the reconstruction",
            expected: original.len(),
            found: reconstruction.len(),
        });
    }
    let squared = |(a, b): (&Vec3, &Vec3)| {
        let d = sub(*a, *b);
        dot(d, d)
    };
    Ok(original.iter().zip(reconstruction).map(squared).collect())
}

/// Returns the distances between a surface and its reconstruction. msd and xsd are scaled by the original's bounding
/// box.
///
/// # Errors
///
/// [`TopologyDiffers`](SurfaceError::TopologyDiffers) or [`LengthMismatch`](SurfaceError::LengthMismatch) if the meshes
/// don't have the same triangles or numbers of vertices; [`FlatBox`](SurfaceError::FlatBox) if the original's bounding
/// box has no volume.
pub fn compare(original: &Mesh, reconstruction: &Mesh) -> Result<Distances, SurfaceError> {
    compare_at(original, reconstruction, None)
}

/// Returns the distances between a surface and its reconstruction at the vertices that a mask keeps, or at all
/// vertices. `scale` is computed from the whole original.
///
/// # Errors
///
/// The errors of [`compare`]; [`LengthMismatch`](SurfaceError::LengthMismatch) if the mask's length isn't the number of
/// vertices; [`Argument`](SurfaceError::Argument) if the mask keeps no vertex.
pub fn compare_at(original: &Mesh, reconstruction: &Mesh, mask: Option<&[bool]>) -> Result<Distances, SurfaceError> {
    if original.faces.len() != reconstruction.faces.len() {
        return Err(SurfaceError::LengthMismatch {
            what: "triangles of the reconstruction",
            expected: original.faces.len(),
            found: reconstruction.faces.len(),
        });
    }
    // Triangles may be in another order, start at another corner or be wound the other way.
    let mut pairs = original.faces.iter().zip(&reconstruction.faces).enumerate();
    if different_triangles(&original.faces, &reconstruction.faces) > 0
        && let Some((face, (expected, found))) = pairs.find(|(_, (a, b))| a != b)
    {
        return Err(SurfaceError::TopologyDiffers { face, expected: *expected, found: *found });
    }
    let scaled = scaled_meshes([original, reconstruction]);
    let ([original, reconstruction], exponent) = match &scaled {
        Some(([original, reconstruction], exponent)) => ([original, reconstruction], *exponent),
        None => ([original, reconstruction], 0),
    };
    let squared = squared_distances(&original.vertices, &reconstruction.vertices)?;
    check_mask(mask, squared.len())?;
    let found = summarise(&squared, mask, bounding_box_scale(&original.vertices)?);
    Ok(Distances {
        msd_raw: times_within(found.msd_raw, 2 * exponent),
        xsd_raw: times_within(found.xsd_raw, 2 * exponent),
        rms_raw: times(found.rms_raw, exponent),
        max_raw: times(found.max_raw, exponent),
        scale: times(found.scale, exponent),
        ..found
    })
}

/// Checks that a mask has an entry for each vertex and keeps at least one vertex.
pub(super) fn check_mask(mask: Option<&[bool]>, vertices: usize) -> Result<(), SurfaceError> {
    let Some(mask) = mask else { return Ok(()) };
    if mask.len() != vertices {
        return Err(SurfaceError::LengthMismatch { what: "values of the mask", expected: vertices, found: mask.len() });
    }
    if !mask.contains(&true) {
        let found = format!("none among {vertices} vertices");
        return Err(SurfaceError::Argument { what: "mask", expected: "at least one vertex that is kept", found });
    }
    Ok(())
}

/// Summarises squared distances at the kept vertices by their mean, their maximum and the vertex of the maximum. Any
/// NaN makes the mean and the maximum NaN, so that a broken reconstruction isn't reported as a good one.
fn summarise(squared: &[f64], mask: Option<&[bool]>, scale: f64) -> Distances {
    let kept = || squared.iter().enumerate().filter(|(i, _)| mask.is_none_or(|mask| mask[*i]));
    let msd_raw = kept().map(|(_, d)| d).sum::<f64>() / kept().count() as f64;
    let mut worst = (0, f64::NEG_INFINITY);
    for (i, &d) in kept() {
        if d.is_nan() {
            worst = (i, d);
            break;
        }
        if d > worst.1 {
            worst = (i, d);
        }
    }
    let (worst_vertex, xsd_raw) = worst;
    let (msd, xsd) = (msd_raw / (scale * scale), xsd_raw / (scale * scale));
    Distances { msd, xsd, msd_raw, xsd_raw, rms_raw: msd_raw.sqrt(), max_raw: xsd_raw.sqrt(), worst_vertex, scale }
}
