//! Measures the distance between two surfaces, whose triangles may differ.
//!
//! A reconstruction may be exact at its vertices and oscillate between them, and different meshes have no corresponding
//! vertices. Therefore points are spread over both surfaces, and the distance d is measured from each point to the
//! nearest point (not vertex) of the other surface.
//!
//! # Sample points
//!
//! Each triangle is cut into n^2 congruent smaller triangles, with n chosen such that the small triangles' edges have
//! about the same length everywhere. The small triangles' centroids are the sample points and their areas the weights,
//! so the mean and the root mean square are integrals over the surface, computed by the midpoint rule. The largest
//! distance is also measured at the vertices, because peaks occur at vertices. The method uses no random numbers.
//!
//! # Error bound
//!
//! d is 1-Lipschitz, and no point of a small triangle is farther from the triangle's centroid than 2/3 of its longest
//! edge. The true Hausdorff distance is therefore at least the computed one, and exceeds it by at most 2/3 of the
//! longest edge of all small triangles (`spacing`). This limit is [`SurfaceDistance::bound`]. The errors of the mean
//! and the root mean square have the same bound, but are far smaller in practice: the midpoint rule's error is of
//! second order where d is smooth.
//!
//! # Cost
//!
//! O((n + samples) log n) time. Two surfaces of 80,000 triangles, with 200,000 points and 40,962 vertices each, take
//! 0.5 s on two cores. Memory is about 200 bytes per triangle and 60 per point.
//!
//! The method follows Cignoni, Rocchini and Scopigno, "Metro: measuring error on simplified surfaces", Computer
//! Graphics Forum 17 (1998), with a grid instead of random points.

use rayon::prelude::*;
use spharm_monitor::Monitor;

use super::grid::{Grid, centroids};
use super::pointwise::nearest_distances;
use super::vertexwise::{bounding_box_scale, check_mask};
use crate::error::SurfaceError;
use crate::geometry::Vec3;
use crate::mesh::Mesh;
use crate::nearest::TriangleTree;
use crate::range::{scaled_meshes, times};

/// Settings of [`surface_distance`]: the sampling density.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SurfaceDistanceParams {
    /// Approximate number of points on each surface, in addition to its vertices. Each triangle gets at least one
    /// point. Long thin triangles get more points than triangles of the same area and better shape. If the number of
    /// points would exceed eight times `samples` and eight times the number of triangles, the points are spaced more
    /// widely.
    pub samples: usize,
}

impl Default for SurfaceDistanceParams {
    fn default() -> Self {
        Self { samples: 100_000 }
    }
}

/// Distances from the sample points of one surface to another surface, in the coordinates' unit.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct Directed {
    /// Mean distance, weighted by area.
    pub mean: f64,
    /// Root mean square distance, weighted by area.
    pub rms: f64,
    /// 95th percentile of the distance, weighted by area.
    pub percentile95: f64,
    /// Largest distance among sample points and vertices.
    pub max: f64,
    /// The point with the largest distance.
    pub worst: [f64; 3],
    /// Number of sample points, without vertices.
    pub samples: usize,
    /// The longest edge of the small triangles that the sample points represent.
    pub spacing: f64,
}

/// Symmetric distance between two surfaces, in the coordinates' unit (mm). Divide by `scale` to get the distance for a
/// bounding box of volume 1, to which msd and xsd refer.
#[derive(Clone, Copy, Debug, PartialEq)]
#[non_exhaustive]
pub struct SurfaceDistance {
    /// Mean distance, weighted by the area of both surfaces.
    pub mean: f64,
    /// Root mean square distance, weighted by the area of both surfaces.
    pub rms: f64,
    /// 95th percentile of the distance, weighted by the area of both surfaces.
    pub percentile95: f64,
    /// Hausdorff distance: the larger of `forward.max` and `backward.max`.
    pub hausdorff: f64,
    /// Distances from the first surface to the second.
    pub forward: Directed,
    /// Distances from the second surface to the first.
    pub backward: Directed,
    /// Largest amount by which the true Hausdorff distance can exceed `hausdorff`.
    pub bound: f64,
    /// [`bounding_box_scale`] of the first surface.
    pub scale: f64,
}

/// Returns the mean, root mean square, 95th percentile and maximum (Hausdorff) distance between two surfaces of any
/// topology. Exchanging the surfaces changes only `scale`, `forward` and `backward`.
///
/// # Errors
///
/// [`Argument`](SurfaceError::Argument) for a surface without area or with a coordinate that isn't finite;
/// [`FlatBox`](SurfaceError::FlatBox) if the bounding box of the first surface has no volume;
/// [`Interrupted`](SurfaceError::Interrupted) if the monitor asks to stop.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
pub fn surface_distance(
    first: &Mesh,
    second: &Mesh,
    params: &SurfaceDistanceParams,
    monitor: &dyn Monitor,
) -> Result<SurfaceDistance, SurfaceError> {
    surface_distance_at(first, second, None, params, monitor)
}

/// Returns the distances between two surfaces with the same triangles, measured only at the vertices that a mask keeps
/// and in the triangles whose corners are all kept. From these points of each surface, distances are measured to the
/// complete other surface. Without a mask, the result is that of [`surface_distance`]. `scale` is computed from the
/// complete first surface.
///
/// # Errors
///
/// The errors of [`surface_distance`]; [`Argument`](SurfaceError::Argument) if the mask keeps no triangle;
/// [`LengthMismatch`](SurfaceError::LengthMismatch) if the mask's length isn't the number of vertices of both surfaces.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
pub fn surface_distance_at(
    first: &Mesh,
    second: &Mesh,
    mask: Option<&[bool]>,
    params: &SurfaceDistanceParams,
    monitor: &dyn Monitor,
) -> Result<SurfaceDistance, SurfaceError> {
    if let Some(([first, second], exponent)) = scaled_meshes([first, second]) {
        return Ok(surface_distance_at(&first, &second, mask, params, monitor)?.times(exponent));
    }
    let parts = match mask {
        Some(mask) => Some([kept(first, mask)?, kept(second, mask)?]),
        None => None,
    };
    let [from_first, from_second] = parts.as_ref().map_or([first, second], |parts| parts.each_ref());
    let scale = bounding_box_scale(&first.vertices)?;
    let there = Samples::towards(from_first, &TriangleTree::new(second), f64::INFINITY, params, monitor)?;
    let back = Samples::towards(from_second, &TriangleTree::new(first), f64::INFINITY, params, monitor)?;
    let (forward, backward) = (there.summary(), back.summary());
    let area = there.area + back.area;
    // A sum of two terms doesn't depend on the order of the terms, so exchanging the surfaces doesn't change the
    // result.
    let mean = (there.area * forward.mean + back.area * backward.mean) / area;
    let square = (there.area * forward.rms * forward.rms + back.area * backward.rms * backward.rms) / area;
    let bound = forward.spacing.max(backward.spacing) * (2.0 / 3.0);
    let percentile95 = percentile(there.weighted.iter().chain(&back.weighted).copied().collect(), 0.95);
    let hausdorff = forward.max.max(backward.max);
    Ok(SurfaceDistance { mean, rms: square.sqrt(), percentile95, hausdorff, forward, backward, bound, scale })
}

/// A sample point on one surface that lies far from another surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FarSample {
    /// Position of the sample point.
    pub point: [f64; 3],
    /// Distance to the other surface.
    pub distance: f64,
    /// Fraction of the surface's area that the point represents.
    pub share: f64,
}

/// Returns the distances from the points of the surface `from` to the surface in the tree `to`, and the sample points
/// of `from` that lie farther than `limit` from that surface.
///
/// # Errors
///
/// The errors of [`surface_distance`].
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
pub fn directed_distance(
    from: &Mesh,
    to: &TriangleTree,
    limit: f64,
    params: &SurfaceDistanceParams,
    monitor: &dyn Monitor,
) -> Result<(Directed, Vec<FarSample>), SurfaceError> {
    let samples = Samples::towards(from, to, limit, params, monitor)?;
    Ok((samples.summary(), samples.far))
}

/// Returns the vertices that a mask keeps, and the triangles between them.
fn kept(mesh: &Mesh, mask: &[bool]) -> Result<Mesh, SurfaceError> {
    check_mask(Some(mask), mesh.vertices.len())?;
    let mut index = Vec::with_capacity(mask.len());
    let mut count = 0;
    for keep in mask {
        index.push(count);
        count += u32::from(*keep);
    }
    let vertices = mesh.vertices.iter().zip(mask).filter(|(_, keep)| **keep).map(|(vertex, _)| *vertex).collect();
    let faces = mesh.faces.iter().filter(|face| face.iter().all(|v| mask[*v as usize]));
    let faces: Vec<[u32; 3]> = faces.map(|face| face.map(|v| index[v as usize])).collect();
    if faces.is_empty() {
        let found = format!("none among {} triangles", mesh.faces.len());
        let expected = "at least one triangle whose three corners are kept";
        return Err(SurfaceError::Argument { what: "mask", expected, found });
    }
    Ok(Mesh::new(vertices, faces))
}

impl Directed {
    fn times(self, exponent: i32) -> Self {
        let by = |length: f64| times(length, exponent);
        Self {
            mean: by(self.mean),
            rms: by(self.rms),
            percentile95: by(self.percentile95),
            max: by(self.max),
            worst: self.worst.map(by),
            spacing: by(self.spacing),
            ..self
        }
    }
}

impl SurfaceDistance {
    /// Returns the distances that result if both surfaces are scaled by 2^exponent.
    #[must_use]
    pub fn times(self, exponent: i32) -> Self {
        let by = |length: f64| times(length, exponent);
        Self {
            mean: by(self.mean),
            rms: by(self.rms),
            percentile95: by(self.percentile95),
            hausdorff: by(self.hausdorff),
            forward: self.forward.times(exponent),
            backward: self.backward.times(exponent),
            bound: by(self.bound),
            scale: by(self.scale),
        }
    }
}

/// Returns the number of bytes that [`surface_distance`] needs in addition to the surfaces.
///
/// Each triangle needs 250 bytes for the search tree of one surface while the tree is built, and 120 bytes for the
/// division into pieces. Each sample point or vertex needs 136 bytes: for its position (two copies while positions are
/// collected), its distance, and its pair of distance and area (two copies while pairs are sorted). The number of
/// points is computed exactly.
///
/// # Panics
///
/// Panics if a triangle's index is out of range.
#[must_use]
pub fn surface_distance_bytes(first: &Mesh, second: &Mesh, params: &SurfaceDistanceParams) -> u64 {
    const BYTES_PER_TRIANGLE: u64 = 370;
    const BYTES_PER_POINT: u64 = 136;
    let most = [first, second].map(|mesh| {
        let pieces: u64 = Grid::new(mesh, params.samples).triangles.iter().map(|(_, n)| u64::from(*n).pow(2)).sum();
        (mesh.faces.len() as u64, pieces + mesh.vertices.len() as u64)
    });
    let (triangles, points) = (most[0].0.max(most[1].0), most[0].1.max(most[1].1));
    triangles * BYTES_PER_TRIANGLE + points.saturating_mul(BYTES_PER_POINT)
}

/// The sample points of one surface, with their distances to the other surface.
struct Samples {
    /// For each sample point, its distance to the other surface and the area that it represents.
    weighted: Vec<(f64, f64)>,
    /// The sample points farther than a limit from the other surface.
    far: Vec<FarSample>,
    area: f64,
    worst: (f64, Vec3),
    spacing: f64,
}

impl Samples {
    fn towards(
        mesh: &Mesh,
        other: &TriangleTree,
        limit: f64,
        params: &SurfaceDistanceParams,
        monitor: &dyn Monitor,
    ) -> Result<Self, SurfaceError> {
        let wrong = |found: String| SurfaceError::Argument {
            what: "surface whose distance is measured",
            expected: "finite coordinates and an area above 0",
            found,
        };
        if let Some(vertex) = mesh.vertices.iter().position(|v| v.iter().any(|x| !x.is_finite())) {
            return Err(wrong(format!("{:?} at vertex {vertex}", mesh.vertices[vertex])));
        }
        let grid = Grid::new(mesh, params.samples);
        if !(grid.area > 0.0 && grid.area.is_finite()) {
            return Err(wrong(format!("{} triangles with a total area of {}", mesh.faces.len(), grid.area)));
        }
        // Points are in the order of the mesh, so that sums don't depend on the number of threads.
        let pieces = grid.triangles.par_iter().flat_map_iter(|&(corners, n)| centroids(corners, n));
        let mut points: Vec<Vec3> = pieces.collect();
        points.extend_from_slice(&mesh.vertices);
        let distances =
            nearest_distances(other, &points, |_| wrong("no triangle at a finite distance".to_owned()), monitor)?;
        let mut worst = (f64::NEG_INFINITY, [0.0; 3]);
        for (&distance, &point) in distances.iter().zip(&points) {
            if distance > worst.0 {
                worst = (distance, point);
            }
        }
        let weights = grid.triangles.iter().zip(&grid.areas).flat_map(|((_, n), area)| {
            let pieces = (n * n) as usize;
            std::iter::repeat_n(area / pieces as f64, pieces)
        });
        let weighted: Vec<(f64, f64)> = distances.iter().copied().zip(weights).collect();
        let far = weighted.iter().zip(&points).filter(|((distance, _), _)| *distance > limit);
        let far = far.map(|(&(distance, area), &point)| FarSample { point, distance, share: area / grid.area });
        Ok(Self { far: far.collect(), weighted, area: grid.area, worst, spacing: grid.spacing })
    }

    fn summary(&self) -> Directed {
        let integral = |f: fn(f64) -> f64| self.weighted.iter().map(|&(d, w)| w * f(d)).sum::<f64>() / self.area;
        Directed {
            mean: integral(|d| d),
            rms: integral(|d| d * d).sqrt(),
            percentile95: percentile(self.weighted.clone(), 0.95),
            max: self.worst.0,
            worst: self.worst.1,
            samples: self.weighted.len(),
            spacing: self.spacing,
        }
    }
}

/// Returns the smallest value such that the values up to it have at least a fraction `part` of the total weight.
fn percentile(mut weighted: Vec<(f64, f64)>, part: f64) -> f64 {
    // Equal values are sorted by weight, so that the result doesn't depend on the original order.
    weighted.par_sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let wanted = part * weighted.iter().map(|(_, w)| w).sum::<f64>();
    let mut below = 0.0;
    for &(value, weight) in &weighted {
        below += weight;
        if below >= wanted {
            return value;
        }
    }
    weighted.last().map_or(f64::NAN, |last| last.0)
}

#[cfg(test)]
mod tests {
    use spharm_monitor::Silent;

    use super::*;
    use crate::generate::icosphere;

    #[test]
    fn far_samples_have_their_positions_and_shares() {
        let near = icosphere(2);
        let mut both = near.clone();
        let count = near.vertices.len() as u32;
        both.vertices.extend(near.vertices.iter().map(|[x, y, z]| [x + 10.0, *y, *z]));
        both.faces.extend(near.faces.iter().map(|face| face.map(|v| v + count)));
        let params = SurfaceDistanceParams { samples: 2000 };
        let (_, far) = directed_distance(&both, &TriangleTree::new(&near), 1.0, &params, &Silent).unwrap();
        assert!(far.iter().all(|sample| sample.distance > 7.9 && sample.point[0] > 8.9));
        let share = far.iter().map(|sample| sample.share).sum::<f64>();
        assert!((share - 0.5).abs() < 1e-12, "{share}");
    }

    #[test]
    fn percentiles_go_by_weight() {
        assert_eq!(percentile(vec![(5.0, 1.0), (1.0, 18.0), (3.0, 1.0)], 0.95), 3.0);
        assert_eq!(percentile(vec![(1.0, 1.0)], 0.95), 1.0);
    }
}
