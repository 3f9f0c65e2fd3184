//! Provides operations on 3-vectors, and the area of a triangle.

pub(crate) use spharm_surface::geometry::{Vec3, add, cross, dot, orientation, scale, solid_angle, sub};

pub(crate) fn norm(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

/// Returns a / |a|.
pub(crate) fn unit(a: Vec3) -> Vec3 {
    scale(a, 1.0 / norm(a))
}

/// Returns the area of a flat triangle.
pub(crate) fn area([a, b, c]: [Vec3; 3]) -> f64 {
    0.5 * norm(cross(sub(b, a), sub(c, a)))
}
