//! Distances between vertices that correspond, and the scale of a surface.

use crate::error::SurfaceError;
use crate::geometry::{Vec3, bounds, dot, sub};
use crate::mesh::Mesh;
use crate::range::{scaled_meshes, times, times_within};
use crate::topology::different_triangles;

/// Distances between a surface and its reconstruction, vertex by vertex.
///
/// `msd` and `xsd` are those of Shen and Chung (3DPVT 2006, section 4.2): mean and maximum of the squared distances
/// once the surface is scaled so that its axis-aligned bounding box has volume 1.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Distances {
    /// Mean squared distance, with bounding-box volume 1.
    pub msd: f64,
    /// Maximal squared distance, with bounding-box volume 1.
    pub xsd: f64,
    /// Mean squared distance, in squared units of the coordinates (mm^2).
    pub msd_raw: f64,
    /// Maximal squared distance, in squared units of the coordinates (mm^2).
    pub xsd_raw: f64,
    /// Root of `msd_raw`, in units of the coordinates (mm). It is valid even if the square leaves the range of f64 and
    /// `msd_raw` is clamped to the end of that range.
    pub rms_raw: f64,
    /// Root of `xsd_raw`, likewise.
    pub max_raw: f64,
    /// Vertex of the maximum.
    pub worst_vertex: usize,
    /// The original's [`bounding_box_scale`], in units of the coordinates.
    pub scale: f64,
}

/// Returns (dx dy dz)^(1/3) of the axis-aligned bounding box. Dividing the coordinates by it gives a box of volume 1.
///
/// # Errors
///
/// [`FlatBox`](SurfaceError::FlatBox) if the box's volume is zero or not finite.
pub fn bounding_box_scale(vertices: &[[f64; 3]]) -> Result<f64, SurfaceError> {
    let (low, high) = bounds(vertices.iter().copied());
    let [x, y, z] = sub(high, low);
    // Roots first: the product of three extents may leave the range of f64 even if the scale doesn't.
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

/// Returns msd, xsd and the worst vertex, scaled by the original.
///
/// # Errors
///
/// [`TopologyDiffers`](SurfaceError::TopologyDiffers) or [`LengthMismatch`](SurfaceError::LengthMismatch) if the meshes
/// don't have the same triangles over the same number of vertices, [`FlatBox`](SurfaceError::FlatBox).
pub fn compare(original: &Mesh, reconstruction: &Mesh) -> Result<Distances, SurfaceError> {
    if original.faces.len() != reconstruction.faces.len() {
        return Err(SurfaceError::LengthMismatch {
            what: "triangles of the reconstruction",
            expected: original.faces.len(),
            found: reconstruction.faces.len(),
        });
    }
    // The same triangles in another order, or wound the other way, are the same topology.
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
    let found = summarise(&squared, bounding_box_scale(&original.vertices)?);
    Ok(Distances {
        msd_raw: times_within(found.msd_raw, 2 * exponent),
        xsd_raw: times_within(found.xsd_raw, 2 * exponent),
        rms_raw: times(found.rms_raw, exponent),
        max_raw: times(found.max_raw, exponent),
        scale: times(found.scale, exponent),
        ..found
    })
}

/// Returns the mean, the maximum and its vertex. A NaN anywhere makes both NaN, so that a broken reconstruction doesn't
/// pass for a good one.
fn summarise(squared: &[f64], scale: f64) -> Distances {
    let msd_raw = squared.iter().sum::<f64>() / squared.len() as f64;
    let mut worst = (0, f64::NEG_INFINITY);
    for (i, &d) in squared.iter().enumerate() {
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
