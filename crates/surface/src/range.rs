//! Scales numbers whose products leave the range of f64.
//!
//! Squares of numbers above 1e154 overflow, and squares of numbers below 1e-162 underflow. Sums of squares are then
//! infinite or zero, although the numbers and the final results can be represented with all digits. Values in
//! transforms leave the range earlier, because transforms multiply values by 2^930 and Legendre functions by 2^-930.
//! Numbers far from 1 are therefore multiplied by a power of two beforehand, and results by its inverse afterwards.
//! Both multiplications are exact, except for results below the smallest normal number. Numbers of ordinary size aren't
//! changed.

use crate::geometry::Vec3;
use crate::mesh::Mesh;

/// Numbers from 2^-30 to 2^32 (about 1e-9 to 4e9) are left unchanged. A sum of products of a weight and a value over
/// millions of vertices then stays below 2^90, and transforms can multiply it by 2^930 without overflow.
const SAFE: i32 = 30;

/// Largest exponent of a power of two by which [`times`] multiplies in one step. The largest exponent that f64 can
/// represent is 1023.
const STEP: i32 = 1000;

/// Returns the exponent e for which the largest magnitude among `values`, divided by 2^e, is from 1 to 4. e is even, so
/// that the square root of 2^e is exact. Returns 0 if the largest magnitude is from 2^-30 to 2^32, is zero, or isn't
/// finite.
#[must_use]
pub fn exponent(values: impl IntoIterator<Item = f64>) -> i32 {
    even_exponent(values).map_or(0, unless_ordinary)
}

/// Returns the exponent of the power of two by which to divide numbers whose [`even_exponent`] is `exponent`. This is 0
/// if the numbers are of ordinary size, else `exponent`.
#[must_use]
pub fn unless_ordinary(exponent: i32) -> i32 {
    if (-SAFE..=SAFE).contains(&exponent) { 0 } else { exponent }
}

/// Returns the even exponent e for which the largest magnitude among `values`, divided by 2^e, is from 1 to 4. Returns
/// `None` if the largest magnitude is zero or isn't finite.
#[must_use]
pub fn even_exponent(values: impl IntoIterator<Item = f64>) -> Option<i32> {
    let largest = values.into_iter().fold(0.0_f64, |most, value| most.max(value.abs()));
    if largest == 0.0 || !largest.is_finite() {
        return None;
    }
    // The exponent bits of a subnormal number are all zero, so the number is multiplied by a power of two first.
    let of = |normal: f64| (normal.to_bits() >> 52) as i32 - 1023;
    let exponent = if largest.is_normal() { of(largest) } else { of(times(largest, STEP)) - STEP };
    Some(exponent - exponent.rem_euclid(2))
}

/// Returns `value * 2^exponent`. The result is exact, unless its magnitude is below the smallest normal number. On
/// overflow, the result is infinite.
#[must_use]
pub fn times(value: f64, exponent: i32) -> f64 {
    let power = |e: i32| f64::from_bits(((1023 + e) as u64) << 52);
    let (mut value, mut left) = (value, exponent);
    while left != 0 {
        let step = left.clamp(-STEP, STEP);
        value *= power(step);
        left -= step;
    }
    value
}

/// Returns `value * 2^exponent`, clamped in magnitude to at most the largest finite number and, for a nonzero value,
/// at least the smallest number above 0. It is meant for reports, in which infinity and zero would mislead.
#[must_use]
pub fn times_within(value: f64, exponent: i32) -> f64 {
    let found = times(value, exponent);
    if found.is_infinite() && value.is_finite() {
        f64::MAX.copysign(value)
    } else if found == 0.0 && value != 0.0 {
        f64::from_bits(1).copysign(value)
    } else {
        found
    }
}

/// Multiplies all values by `2^exponent`.
pub fn scale_all<'a>(values: impl IntoIterator<Item = &'a mut f64>, exponent: i32) {
    if exponent != 0 {
        values.into_iter().for_each(|value| *value = times(*value, exponent));
    }
}

/// Returns points with their coordinates divided by 2^exponent.
pub(crate) fn scaled_points(points: &[Vec3], exponent: i32) -> Vec<Vec3> {
    points.iter().map(|point| point.map(|x| times(x, -exponent))).collect()
}

/// Returns the meshes with all coordinates divided by 2^e, together with e, the [`exponent`] of the coordinates.
/// Returns `None` if e is 0.
#[must_use]
pub fn scaled_meshes<const N: usize>(meshes: [&Mesh; N]) -> Option<([Mesh; N], i32)> {
    let exponent = exponent(meshes.iter().flat_map(|mesh| mesh.vertices.iter().flatten().copied()));
    let each = |mesh: &Mesh| mesh.with_vertices(scaled_points(&mesh.vertices, exponent));
    (exponent != 0).then(|| (meshes.map(each), exponent))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_bring_the_largest_near_one_and_leave_ordinary_numbers_alone() {
        for ordinary in [0.0, 1.0, -3e5, 1e-9, 4e9, f64::NAN, f64::INFINITY] {
            assert_eq!(exponent([ordinary, 0.0]), 0, "{ordinary}");
        }
        for value in [1e300, -1e154, 1e10, 1e-10, -1e-162, 1e-300, 1e-308, 3e-320, f64::from_bits(1), f64::MAX] {
            let e = exponent([0.0, value, value / 3.0]);
            let near = times(value, -e);
            assert!(e % 2 == 0 && (1.0..4.0).contains(&near.abs()), "{value:e}: {e}, {near}");
            assert_eq!(times(near, e).to_bits(), value.to_bits());
        }
    }

    #[test]
    fn figures_stay_within_the_range() {
        assert_eq!(times(1.5, 2000), f64::INFINITY);
        assert_eq!((times_within(1.5, 2000), times_within(-1.5, 2000)), (f64::MAX, -f64::MAX));
        assert_eq!((times_within(1.5, -2000), times_within(0.0, -2000)), (f64::from_bits(1), 0.0));
        assert_eq!(times_within(1.5, 10), 1536.0);
        assert!(times_within(f64::NAN, 4000).is_nan() && times_within(f64::INFINITY, -4000).is_infinite());
    }
}
