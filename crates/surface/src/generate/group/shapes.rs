//! Generates ellipsoids, rods and rings. The places on a shape depend linearly on the shape's parameters.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use super::super::icosphere::icosphere_counts;
use super::super::random::SplitMix64;
use crate::geometry::Vec3;
use crate::mesh::Mesh;

/// The third half axis of ellipsoids, in mm.
const C: f64 = 8.0;
/// Radii of a rod's shaft (`SHAFT`) and of its knob (`KNOB`), in mm.
const SHAFT: f64 = 4.0;
const KNOB: f64 = 7.0;
/// A rod's thickness along z relative to y (`FLAT`), the offset of the knob from the shaft's axis in mm (`OFF`), and
/// the length of shaft over which the rod bends to that offset in mm (`BEND`). Because of these three constants, no
/// rotation maps a rod to itself.
const FLAT: f64 = 0.7;
const OFF: f64 = 3.0;
const BEND: f64 = 8.0;
/// Fraction of the radius by which a ring's tube is thicker on one side (`THICKER`), and the ring's warp in mm
/// (`WARP`). Because of these two constants, no rotation maps a ring to itself.
const THICKER: f64 = 0.25;
const WARP: f64 = 2.0;

pub(super) fn ellipsoid(axes: &[f64], u: Vec3) -> Vec3 {
    [axes[0] * u[0], axes[1] * u[1], C * u[2]]
}

pub(super) fn ellipsoid_places(axes: &[f64]) -> Vec<(&'static str, Vec3)> {
    let s = 1.0 / 3.0_f64.sqrt();
    let at: [(&str, Vec3); 10] = [
        ("x0", [-1.0, 0.0, 0.0]),
        ("x1", [1.0, 0.0, 0.0]),
        ("y0", [0.0, -1.0, 0.0]),
        ("y1", [0.0, 1.0, 0.0]),
        ("z0", [0.0, 0.0, -1.0]),
        ("z1", [0.0, 0.0, 1.0]),
        ("octant-001", [-s, -s, s]),
        ("octant-010", [-s, s, -s]),
        ("octant-100", [s, -s, -s]),
        ("octant-111", [s, s, s]),
    ];
    at.into_iter().map(|(name, u)| (name, ellipsoid(axes, u))).collect()
}

/// Returns the x coordinate at which the shaft ends and the knob begins. At this coordinate, the shaft and the knob
/// have the same circular cross-section.
fn junction(length: f64) -> f64 {
    length - (KNOB * KNOB - SHAFT * SHAFT).sqrt()
}

/// Returns the point of a rod at coordinate x and at the given angle around the shaft. The rod's circular
/// cross-sections are flattened along z, and displaced where the rod bends.
fn on_rod(x: f64, angle: f64, length: f64) -> Vec3 {
    let square = if x < 0.0 {
        SHAFT * SHAFT - x * x
    } else if x < junction(length) {
        SHAFT * SHAFT
    } else {
        KNOB * KNOB - (x - length).powi(2)
    };
    let radius = square.max(0.0).sqrt();
    let rise = ((x - junction(length)) / BEND + 1.0).clamp(0.0, 1.0);
    let off = OFF * rise * rise * (3.0 - 2.0 * rise);
    [x, radius * angle.cos() + off, FLAT * radius * angle.sin()]
}

/// Returns the point of the rod for a direction u. The plane perpendicular to x through this point divides the rod's
/// area, before flattening, in the same proportion as the plane perpendicular to x through u divides the sphere's area.
/// On the shaft, including its rounded end, and on the knob, the area of a zone of width dx is `2 pi r dx`, with r the
/// radius of the shaft or of the knob.
pub(super) fn rod(u: Vec3, length: f64) -> Vec3 {
    let (first, from) = (SHAFT * (junction(length) + SHAFT), junction(length));
    let all = first + KNOB * (length + KNOB - from);
    let area = 0.5 * (1.0 + u[0].clamp(-1.0, 1.0)) * all;
    let x = if area < first { area / SHAFT - SHAFT } else { from + (area - first) / KNOB };
    on_rod(x, u[2].atan2(u[1]), length)
}

/// Returns the places of a rod: the tip, the knob, and points at a quarter, half and three quarters of the shaft. The
/// shaft stretches evenly with the parameter.
pub(super) fn rod_places(length: f64) -> Vec<(&'static str, Vec3)> {
    let shaft = |share: f64, angle: f64| on_rod(share * (junction(length) - BEND), angle, length);
    vec![
        ("tip", on_rod(-SHAFT, 0.0, length)),
        ("quarter", shaft(0.25, 0.0)),
        ("half-y0", shaft(0.5, PI)),
        ("half-y1", shaft(0.5, 0.0)),
        ("half-z1", shaft(0.5, FRAC_PI_2)),
        ("three-quarters", shaft(0.75, 0.0)),
        ("knob", on_rod(length + KNOB, 0.0, length)),
        ("knob-y0", on_rod(length, PI, length)),
        ("knob-y1", on_rod(length, 0.0, length)),
        ("knob-z0", on_rod(length, -FRAC_PI_2, length)),
        ("knob-z1", on_rod(length, FRAC_PI_2, length)),
    ]
}

fn on_ring(around: f64, across: f64, parameters: &[f64]) -> Vec3 {
    let tube = parameters[1] * (1.0 + THICKER * around.cos());
    let radius = parameters[0] + tube * across.cos();
    [radius * around.cos(), radius * around.sin(), tube * across.sin() + WARP * (2.0 * around).cos()]
}

/// Returns a ring, meshed with a grid of random size and phase.
pub(super) fn ring(parameters: &[f64], subdivisions: u32, random: &mut SplitMix64) -> Mesh {
    // The grid has three times as many vertices around the ring as around the tube, because the ring is longer.
    let most = icosphere_counts(subdivisions)[0] as f64;
    let across = ((most / 3.0).sqrt() * random.between(0.85, 1.0)).max(4.0) as u32;
    let around = (3.0 * f64::from(across) * random.between(0.9, 1.0)).max(4.0) as u32;
    let phases = [random.between(0.0, TAU), random.between(0.0, TAU)];
    // Each row is shifted by a fraction of a cell relative to the previous row. The shifts add up to complete turns, so
    // that the grid closes.
    let slant = (random.between(0.0, 3.0) as u32).min(2);
    let vertices = (0..around * across).map(|index| {
        let (i, j) = (f64::from(index / across) / f64::from(around), f64::from(index % across) / f64::from(across));
        on_ring(phases[0] + TAU * i, phases[1] + TAU * (j + f64::from(slant) * i), parameters)
    });
    let at = |i: u32, j: u32| (i % around) * across + j % across;
    let faces = (0..around).flat_map(|i| {
        (0..across).flat_map(move |j| {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            [[a, b, c], [a, c, d]]
        })
    });
    Mesh::new(vertices.collect(), faces.collect())
}

pub(super) fn ring_places(parameters: &[f64]) -> Vec<(&'static str, Vec3)> {
    let at = [
        ("outer-0", 0.0, 0.0),
        ("outer-1", 0.25, 0.0),
        ("outer-2", 0.5, 0.0),
        ("outer-3", 0.75, 0.0),
        ("upper-0", 0.0, 0.25),
        ("upper-1", 0.25, 0.25),
        ("upper-2", 0.5, 0.25),
        ("upper-3", 0.75, 0.25),
        ("inner-0", 0.0, 0.5),
        ("inner-2", 0.5, 0.5),
    ];
    at.into_iter().map(|(name, around, across)| (name, on_ring(TAU * around, TAU * across, parameters))).collect()
}
