//! Computes the targets of the equal-area map from the physical size of the quadrangles: their areas on the sphere, and
//! the weights of their edges.
//!
//! A face of a voxel is a rectangle with sides h and h'. The face's target area on the sphere is 4 pi times its share
//! of the surface's area. The optimisation minimises the sum over edges of w_ij |x_i - x_j|^2. If all faces are squares
//! and w_ij = 1, this sum is the Dirichlet energy of the map; on rectangles the sum is the Dirichlet energy if the edge
//! of length h has the weight h' / h. With these areas and weights, the map doesn't depend on the direction in which
//! voxels are longest. For cubes all weights are exactly 1 and all targets exactly 4 pi / Q, with Q the number of
//! quadrangles.

use std::f64::consts::PI;

use crate::geometry::{Vec3, cross, norm, sub};
use crate::volume::QuadMesh;

/// Relative difference below which two side lengths, or two areas, are treated as equal. Voxel sizes in files are
/// rounded to 32 bits.
const EQUAL: f64 = 1e-5;

/// Bounds to which target areas are clamped, relative to the mean area; there is no upper bound. Faces of voxels are
/// never clamped, but quadrangles of other surfaces may be.
const AREA: (f64, f64) = (1e-6, f64::INFINITY);
/// Bounds to which the weights of edges are clamped. Weights on faces of voxels are never clamped, but weights on other
/// surfaces may be.
const WEIGHT: (f64, f64) = (1e-2, 1e2);

/// Target areas and weights of a surface's quadrangles.
pub(super) struct Targets {
    /// Target solid angle of each quadrangle (Q); the sum is 4 pi.
    pub(super) areas: Vec<f64>,
    /// Weights of the squared lengths of each quadrangle's four sides (Q, 4); side k goes from corner k to the next
    /// corner.
    pub(super) weights: Vec<[f64; 4]>,
}

impl Targets {
    /// Returns the targets of quadrangles whose vertices have the given positions.
    pub(super) fn of(quads: &QuadMesh, positions: &[Vec3]) -> Self {
        let count = quads.quads.len();
        let corners = |quad: &[u32; 4]| quad.map(|v| positions[v as usize]);
        let sides: Vec<[f64; 4]> = quads.quads.iter().map(|quad| sides(corners(quad))).collect();
        let areas: Vec<f64> = quads.quads.iter().map(|quad| area(corners(quad))).collect();
        let mean = 4.0 * PI / count as f64;
        if are_equal(sides.as_flattened()) && are_equal(&areas) {
            return Self { areas: vec![mean; count], weights: vec![[1.0; 4]; count] };
        }
        let total: f64 = areas.iter().sum();
        let share = |area: f64| (4.0 * PI * area / total).clamp(AREA.0 * mean, AREA.1);
        let weight = |l: &[f64; 4]| {
            std::array::from_fn(|k| {
                let across = 0.5 * (l[(k + 1) % 4] + l[(k + 3) % 4]);
                let weight = across / l[k];
                // The weight is NaN if the side and the two adjacent sides all have length 0.
                if weight.is_nan() { 1.0 } else { weight.clamp(WEIGHT.0, WEIGHT.1) }
            })
        };
        Self { areas: areas.into_iter().map(share).collect(), weights: sides.iter().map(weight).collect() }
    }
}

fn are_equal(values: &[f64]) -> bool {
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    let most = values.iter().copied().fold(0.0, f64::max);
    most - least <= EQUAL * most
}

fn sides(p: [Vec3; 4]) -> [f64; 4] {
    std::array::from_fn(|k| norm(sub(p[(k + 1) % 4], p[k])))
}

fn area([a, b, c, d]: [Vec3; 4]) -> f64 {
    0.5 * norm(cross(sub(c, a), sub(d, b)))
}
