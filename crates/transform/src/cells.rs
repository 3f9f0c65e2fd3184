//! Computes the grid cells that contain directions.
//!
//! Rows are colatitudes, and columns are azimuths. Both are computed as angles `atan2(y, x)`; for a colatitude, y is
//! its sine and x its cosine. The grid's number of points around the sphere is a multiple of 8. An angle is measured
//! from the nearest multiple of `pi / 4`, which is a whole number of cells. The measured angle is at most `pi / 8`, so
//! its rounding error is a sixteenth of the rounding error of an angle near 2 pi. This matters at high degrees. Eight
//! directions are processed at a time, whereas a call of the library's `atan` processes only one direction.

use std::f64::consts::TAU;

use multiversion::{multiversion, target::target_cfg_f};

use crate::lanes::fused;

/// Row and column of a cell, and the position in it along rows and columns, in [0, 1).
pub(crate) type Place = ([u32; 2], [f64; 2]);

const LANES: usize = 8;

/// `tan(pi / 8)`.
const TAN_EIGHTH: f64 = 0.414_213_562_373_095_03;

/// Coefficients, from the highest power to the lowest, of a polynomial in `t^2` that approximates
/// `(atan(t) / t - 1) / t^2` on `[0, tan(pi / 8)^2]`, computed by interpolation at Chebyshev nodes in 60 digits. The
/// relative error of atan is then 5e-18 before rounding.
const ATAN: [f64; 11] = [
    -0.019175404711104935,
    0.03923044778479309,
    -0.050854078345894844,
    0.05858140904866328,
    -0.06664510525508936,
    0.07692183125376892,
    -0.0909090457530649,
    0.11111111015187018,
    -0.14285714284665682,
    0.19999999999995516,
    -0.3333333333333333,
];

/// Places unit vectors (n, 3) on a grid of `grid` points around the sphere. `grid` is a multiple of 8.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
pub(crate) fn place(directions: &[[f64; 3]], grid: usize, places: &mut [Place]) {
    for (directions, places) in directions.chunks(LANES).zip(places.chunks_mut(LANES)) {
        let ([x, y, z], sine) = lanes(directions);
        let (rows, columns) = if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
            (cells::<true>(&z, &sine, grid), cells::<true>(&x, &y, grid))
        } else {
            (cells::<false>(&z, &sine, grid), cells::<false>(&x, &y, grid))
        };
        for (i, place) in places.iter_mut().enumerate() {
            *place = ([rows.0[i], columns.0[i]], [rows.1[i], columns.1[i]]);
        }
    }
}

/// Computes the same rows as [`place`], but no columns, at half the cost.
#[multiversion(targets("x86_64+avx512f+avx512vl+avx512dq+avx2+fma", "x86_64+avx2+fma"))]
pub(crate) fn rows(directions: &[[f64; 3]], grid: usize, rows: &mut [u32]) {
    for (directions, rows) in directions.chunks(LANES).zip(rows.chunks_mut(LANES)) {
        let ([_, _, z], sine) = lanes(directions);
        let (found, _) = if target_cfg_f!(any(target_feature = "fma", target_arch = "aarch64")) {
            cells::<true>(&z, &sine, grid)
        } else {
            cells::<false>(&z, &sine, grid)
        };
        rows.copy_from_slice(&found[..rows.len()]);
    }
}

/// Returns x, y and z of at most [`LANES`] directions, and the sines of their colatitudes.
#[inline(always)]
fn lanes(directions: &[[f64; 3]]) -> ([[f64; LANES]; 3], [f64; LANES]) {
    let (mut x, mut y, mut z) = ([1.0; LANES], [0.0; LANES], [0.0; LANES]);
    for (i, direction) in directions.iter().enumerate() {
        [x[i], y[i], z[i]] = *direction;
    }
    let mut sine = [0.0; LANES];
    for i in 0..LANES {
        sine[i] = (x[i] * x[i] + y[i] * y[i]).sqrt();
    }
    ([x, y, z], sine)
}

/// Returns the cells of the angles `atan2(y, x)` in [0, 2 pi), and the positions in them. At the origin, where the
/// angle is undefined, the returned angle is zero.
#[inline(always)]
fn cells<const FMA: bool>(x: &[f64; LANES], y: &[f64; LANES], grid: usize) -> ([u32; LANES], [f64; LANES]) {
    let (mut cells, mut fractions) = ([0; LANES], [0.0; LANES]);
    let around = grid as f64;
    for i in 0..LANES {
        let (across, up) = (x[i].abs(), y[i].abs());
        let steep = up > across;
        let (short, long) = if steep { (across, up) } else { (up, across) };
        // Angles of more than pi / 8 from the axis are measured from the diagonal.
        let far = short > TAN_EIGHTH * long;
        let (numerator, denominator) = if far { (short - long, short + long) } else { (short, long) };
        let t = numerator / if denominator > 0.0 { denominator } else { 1.0 };
        let square = t * t;
        let mut sum = ATAN[0];
        for coefficient in &ATAN[1..] {
            sum = fused::<FMA>(sum, square, *coefficient);
        }
        // The angle, in cells, is `from`, a whole number, plus `steps`. Depending on the octant, it is mirrored at the
        // diagonal, the y axis and the x axis.
        let mut steps = fused::<FMA>(t * square, sum, t) * (around / TAU);
        let mut from = if far { around / 8.0 } else { 0.0 };
        for (mirrored, axis) in [(steep, around / 4.0), (x[i] < 0.0, around / 2.0), (y[i] < 0.0, around)] {
            (steps, from) = if mirrored { (-steps, axis - from) } else { (steps, from) };
        }
        let whole = steps.floor();
        // The fraction of a tiny negative angle rounds to one; the double just below one is equally close.
        fractions[i] = (steps - whole).min(1.0 - f64::EPSILON / 2.0);
        let cell = from + whole;
        let cell = if cell < 0.0 { cell + around } else { cell };
        cells[i] = if cell < around { cell } else { cell - around } as u32;
    }
    (cells, fractions)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the column that contains the angle of (x, y), and the position in it.
    fn column(x: f64, y: f64, grid: usize) -> (u32, f64) {
        let mut places = [([0; 2], [0.0; 2])];
        place(&[[x, y, 0.0]], grid, &mut places);
        (places[0].0[1], places[0].1[1])
    }

    #[test]
    fn cells_are_those_of_the_angles() {
        let grid = 96;
        let angles: Vec<f64> = (0..1003).map(|i| f64::from(i) * TAU / 1003.0).collect();
        let directions: Vec<[f64; 3]> = angles.iter().map(|a| [a.cos(), a.sin(), 0.3 * a.cos()]).collect();
        let mut places = vec![([0; 2], [0.0; 2]); directions.len()];
        place(&directions, grid, &mut places);
        let mut found = vec![0; directions.len()];
        rows(&directions, grid, &mut found);
        assert!(places.iter().map(|(cell, _)| cell[0]).eq(found));
        for ((angle, [x, y, z]), (cell, fraction)) in angles.iter().zip(&directions).zip(&places) {
            for (which, expected) in [(0, x.hypot(*y).atan2(*z)), (1, *angle)] {
                let found = (f64::from(cell[which]) + fraction[which]) * TAU / grid as f64;
                let off = (found - expected).abs();
                assert!(off < 1e-14 || (off - TAU).abs() < 1e-14, "{expected} {found}");
                assert!((cell[which] as usize) < grid && (0.0..1.0).contains(&fraction[which]));
            }
        }
    }

    #[test]
    fn positions_in_cells_are_those_of_the_angle_to_rounding() {
        // The grid has 2^20 points around the sphere. The tolerance covers the rounding errors of the expected angle
        // and of the arctangent that `place` computes. This arctangent is at most a sixteenth of the circle.
        let grid = 1 << 20;
        for i in 0..2_000 {
            let t = (f64::from(i) - 1000.0) / 1000.0;
            let (cell, fraction) = column(1.0, t, grid);
            let steps = t.atan() * grid as f64 / TAU;
            let found = f64::from(cell) + fraction - if t < 0.0 { grid as f64 } else { 0.0 };
            assert!((found - steps).abs() <= 1e-10, "{t}: {found} {steps}");
        }
    }

    #[test]
    fn axes_are_whole_cells() {
        for (x, y, cell) in [
            (1.0, 0.0, 0),
            (1.0, -0.0, 0),
            (0.5, 0.5, 12),
            (0.0, 1.0, 24),
            (-1.0, 0.0, 48),
            (-1.0, -0.0, 48),
            (0.0, -1.0, 72),
            (0.0, 0.0, 0),
        ] {
            assert_eq!(column(x, y, 96), (cell, 0.0), "{x} {y}");
        }
        assert_eq!(column(1.0, -1e-300, 96), (95, 1.0 - f64::EPSILON / 2.0));
    }
}
