//! Generates boxes with bumps. A box is a superellipsoid `sum |x_i / h_i|^p = 1` with half extents h_i and power p. A
//! direction is mapped to the point of the superellipsoid in that direction. On the upper half (z > 0), a bump centred
//! at x = t, y = s adds `height (z / h_z)^4 exp(-((x - t)^2 + (y - s)^2) / (2 width^2))` to z.

use crate::geometry::{Vec3, scale};

/// Half extents of the tapered box, in mm.
const HALF: Vec3 = [15.0, 9.0, 7.0];
/// Fraction by which the box is narrower at x = 15 mm than in the middle, and wider at x = -15 mm. Because of the
/// taper, no rotation maps the box to itself.
const TAPER: f64 = 0.25;
/// Width of the bump on the tapered box, in mm.
const WIDTH: f64 = 3.5;
/// Height of the moving bump, in mm.
pub(super) const HEIGHT: f64 = 3.0;
/// Position (x, y) of the growing bump, in mm.
pub(super) const PLACE: [f64; 2] = [5.0, 2.0];
/// Half extents of the box with the sharp bump, and the bump's height and width, in mm.
const SHARP: (Vec3, f64, f64) = ([15.0, 5.0, 5.0], 3.5, 1.8);

fn superellipsoid(u: Vec3, half: Vec3, power: i32) -> Vec3 {
    let sum: f64 = (0..3).map(|i| (u[i] / half[i]).abs().powi(power)).sum();
    scale(u, sum.powf(-1.0 / f64::from(power)))
}

fn with_bump(mut x: Vec3, half: f64, [t, s]: [f64; 2], height: f64, width: f64) -> Vec3 {
    let upper = (x[2] / half).clamp(0.0, 1.0).powi(4);
    let square = (x[0] - t).powi(2) + (x[1] - s).powi(2);
    x[2] += upper * height * (-square / (2.0 * width * width)).exp();
    x
}

/// Returns the point in direction u of the tapered box with a bump at `place`.
pub(super) fn tapered(u: Vec3, place: [f64; 2], height: f64) -> Vec3 {
    let mut x = superellipsoid(u, HALF, 4);
    x[1] *= 1.0 - TAPER * x[0] / HALF[0];
    with_bump(x, HALF[2], place, height, WIDTH)
}

/// Returns the point in direction u of the box with the sharp bump at x = t. All lengths are ten times those in the
/// prototype `bump.py`.
pub(super) fn sharp(u: Vec3, t: f64) -> Vec3 {
    let (half, height, width) = SHARP;
    with_bump(superellipsoid(u, half, 8), half[2], [t, 0.0], height, width)
}

const CORNERS: [(&str, Vec3); 8] = [
    ("corner-000", [-1.0, -1.0, -1.0]),
    ("corner-001", [-1.0, -1.0, 1.0]),
    ("corner-010", [-1.0, 1.0, -1.0]),
    ("corner-011", [-1.0, 1.0, 1.0]),
    ("corner-100", [1.0, -1.0, -1.0]),
    ("corner-101", [1.0, -1.0, 1.0]),
    ("corner-110", [1.0, 1.0, -1.0]),
    ("corner-111", [1.0, 1.0, 1.0]),
];
const ENDS: [(&str, Vec3); 3] = [("end-0", [-1.0, 0.0, 0.0]), ("end-1", [1.0, 0.0, 0.0]), ("bottom", [0.0, 0.0, -1.0])];

/// Returns named points of the tapered box: its corners and ends, the middle of the bump, and points at a distance of
/// one width from the bump's middle.
pub(super) fn places(point: impl Fn(Vec3) -> Vec3, [t, s]: [f64; 2], height: f64) -> Vec<(&'static str, Vec3)> {
    let mut found: Vec<(&str, Vec3)> = fixed(&point, HALF);
    // Returns the point on the box's upper side with the given x and y. Its height without the bump is that of the
    // superellipsoid before the taper, at the point that the taper moves to (x, y).
    let above = |x: f64, y: f64| {
        let plain = y / (1.0 - TAPER * x / HALF[0]);
        let z = HALF[2] * (1.0 - (x / HALF[0]).powi(4) - (plain / HALF[1]).powi(4)).max(0.0).powf(0.25);
        with_bump([x, y, z], HALF[2], [t, s], height, WIDTH)
    };
    found.extend(around(above, [t, s], WIDTH));
    found
}

/// Returns named points of the box with the sharp bump: the corners, the ends and the bump.
pub(super) fn sharp_places(t: f64) -> Vec<(&'static str, Vec3)> {
    let (half, height, width) = SHARP;
    let mut found = fixed(&|u| sharp(u, t), half);
    let above = |x: f64, y: f64| {
        let z = half[2] * (1.0 - (x / half[0]).powi(8) - (y / half[1]).powi(8)).max(0.0).powf(0.125);
        with_bump([x, y, z], half[2], [t, 0.0], height, width)
    };
    found.extend(around(above, [t, 0.0], width));
    found
}

fn fixed(point: &impl Fn(Vec3) -> Vec3, half: Vec3) -> Vec<(&'static str, Vec3)> {
    let on = |(name, signs): &(&'static str, Vec3)| (*name, point(std::array::from_fn(|i| signs[i] * half[i])));
    CORNERS.iter().chain(&ENDS).map(on).collect()
}

fn around(above: impl Fn(f64, f64) -> Vec3, [t, s]: [f64; 2], width: f64) -> [(&'static str, Vec3); 5] {
    [
        ("bump", above(t, s)),
        ("bump-x0", above(t - width, s)),
        ("bump-x1", above(t + width, s)),
        ("bump-y0", above(t, s - width)),
        ("bump-y1", above(t, s + width)),
    ]
}
