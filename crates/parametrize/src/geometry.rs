//! Three-vectors, as much as is needed here, and what is measured on the sphere.

pub(crate) use spharm_surface::geometry::{Vec3, add, cross, dot, scale, solid_angle, sub};

pub(crate) fn norm(a: Vec3) -> f64 {
    dot(a, a).sqrt()
}

/// a / |a|.
pub(crate) fn unit(a: Vec3) -> Vec3 {
    scale(a, 1.0 / norm(a))
}

/// Area of a flat triangle.
pub(crate) fn area([a, b, c]: [Vec3; 3]) -> f64 {
    0.5 * norm(cross(sub(b, a), sub(c, a)))
}

/// The orientation of a triangle seen from the origin, exactly for the numbers as they are: positive where it is
/// counter-clockwise seen from outside, 0 where its plane holds the origin (J. Shewchuk, Discrete Comput. Geom. 18, 1997).
pub(crate) fn orientation([a, b, c]: [Vec3; 3]) -> f64 {
    let coord = |[x, y, z]: Vec3| robust::Coord3D { x, y, z };
    robust::orient3d(coord(a), coord(b), coord(c), coord([0.0; 3]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_octant_is_positive() {
        let octant = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        assert!(orientation(octant) > 0.0);
        let [a, b, c] = octant;
        assert!(orientation([b, a, c]) < 0.0);
    }

    #[test]
    fn orientation_is_exact_where_rounding_decides() {
        // c = a + b up to one unit in the last place, on either side of the plane of a, b and the origin.
        let (a, b) = ([0.6, 0.8, 0.1], [0.3, -0.2, 0.7]);
        let c = [0.6 + 0.3, 0.8 - 0.2, 0.1 + 0.7];
        let side = |z: f64| orientation([a, b, [c[0], c[1], z]]);
        assert!(side(f64::from_bits(c[2].to_bits() + 2)) * side(f64::from_bits(c[2].to_bits() - 2)) < 0.0);
        let (a, b) = ([0.5, 0.25, 1.0], [0.125, 2.0, 0.75]);
        assert_eq!(orientation([a, b, add(a, b)]), 0.0);
    }
}
