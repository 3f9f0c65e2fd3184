//! The energies that maps minimise.
//!
//! A triangle of the surface with area A (all of them sum to 4 pi) goes to a spherical triangle of solid angle W. With
//! s1 >= s2 the singular values of the linear map between the flat triangles,
//!
//! ```text
//! q = (s1^2 + s2^2) / 2 = sum over corners of cot(angle) |opposite edge on the sphere|^2 / (4 A)
//! r = W / A,                                        about s1 s2 for small triangles
//! ```
//!
//! and each energy is the sum over triangles of A F(q, r), where
//!
//! | energy | F(q, r) | least where |
//! |---|---|---|
//! | [`Energy::balanced`] | a (r + 1/r) / 2 + b q / r | areas are equal (a), angles are kept (b) |
//! | [`Energy::bounded`] | the same + c (q / r)^3 | and no triangle is much longer than the others (c) |
//! | [`Energy::CONFORMAL`] | q / r | angles are kept (the MIPS of Hormann and Greiner, 2000) |
//! | [`Energy::STRETCH`] | q / r^2 + e q | L2 stretch is least (Sander et al. 2001) |
//!
//! Each goes to infinity as a triangle loses its area, so that a descent that starts from a map without flips stays one.
//! Cotangents are scale-free, so a triangle of a coarsened mesh can carry more area than it has.

use crate::geometry::{Vec3, add, cross, dot, norm, scale, sub};

/// Least slack in the triangle inequality, in mean edge lengths. Thinner triangles are taken as a little less thin (N.
/// Sharp and K. Crane, SGP 2020, intrinsic mollification): their cotangents would drown all others.
const SLACK: f64 = 1e-3;

/// A triangle of the surface, reduced to what the energies need.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    /// A, its share of 4 pi.
    pub(crate) area: f64,
    /// Cotangents of the angles at its corners.
    pub(crate) cotangents: [f64; 3],
}

impl Shape {
    pub(crate) fn new([a, b, c]: [Vec3; 3], area: f64) -> Self {
        Self::of_lengths([norm(sub(b, c)), norm(sub(c, a)), norm(sub(a, b))], area)
    }

    /// From the lengths of the edges, each across from its corner.
    pub(crate) fn of_lengths(mut l: [f64; 3], area: f64) -> Self {
        let mean = (l[0] + l[1] + l[2]) / 3.0;
        let slack = l[0] + l[1] + l[2] - 2.0 * l[0].max(l[1]).max(l[2]);
        let missing = (SLACK * mean - slack).max(0.0);
        l.iter_mut().for_each(|length| *length += missing);
        let [x, y, z] = l;
        // Heron's formula, as W. Kahan orders it.
        let mut s = l;
        s.sort_unstable_by(|p, q| q.total_cmp(p));
        let product = (s[0] + (s[1] + s[2])) * (s[2] - (s[0] - s[1])) * (s[2] + (s[0] - s[1])) * (s[0] + (s[1] - s[2]));
        let four_areas = product.max(f64::MIN_POSITIVE).sqrt();
        let cotangents = [
            (y * y + z * z - x * x) / four_areas,
            (z * z + x * x - y * y) / four_areas,
            (x * x + y * y - z * z) / four_areas,
        ];
        Self { area, cotangents }
    }
}

/// Least area of a triangle, as a share of the mean: thinner ones are too small to steer anything.
const LEAST_AREA: f64 = 1e-7;

/// The least area that counts of so many triangles.
pub(crate) fn least_area(triangles: usize) -> f64 {
    LEAST_AREA * 4.0 * std::f64::consts::PI / triangles as f64
}

/// Sets the area of each triangle.
pub(crate) fn set_areas(shapes: &mut [Shape], areas: &[f64]) {
    let least = least_area(shapes.len());
    shapes.iter_mut().zip(areas).for_each(|(shape, area)| shape.area = area.max(least));
}

/// One of the energies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Energy {
    /// a (r + 1/r) / 2 + b q / r + c (q / r)^3.
    Balanced {
        /// a
        area: f64,
        /// b
        shape: f64,
        /// c
        bound: f64,
    },
    /// q / r^2 + `shrink` q.
    Stretch {
        /// Weight of the term that keeps parts from growing without bound where there is nothing to stretch.
        shrink: f64,
    },
}

impl Energy {
    pub(crate) const CONFORMAL: Self = Self::balanced(0.0, 1.0);
    pub(crate) const STRETCH: Self = Self::Stretch { shrink: 1e-3 };

    pub(crate) const fn balanced(area: f64, shape: f64) -> Self {
        Self::Balanced { area, shape, bound: 0.0 }
    }

    pub(crate) const fn bounded(area: f64, shape: f64, bound: f64) -> Self {
        Self::Balanced { area, shape, bound }
    }

    /// F of an isometry.
    pub(crate) fn least(self) -> f64 {
        self.density(1.0, 1.0)[0]
    }

    /// F, dF/dq and dF/dr.
    fn density(self, q: f64, r: f64) -> [f64; 3] {
        let s = 1.0 / r;
        match self {
            Self::Balanced { area, shape, bound } => {
                // Of shape x + bound x^3 by x = q / r.
                let x = q * s;
                let slope = shape + 3.0 * bound * x * x;
                let value = 0.5 * area * (r + s) + shape * x + bound * x * x * x;
                [value, slope * s, 0.5 * area * (1.0 - s * s) - slope * x * s]
            }
            Self::Stretch { shrink } => [q * s * s + shrink * q, s * s + shrink, -2.0 * q * s * s * s],
        }
    }

    /// One triangle's energy; infinite where it is flipped or flat, up to rounding.
    pub(crate) fn value(self, shape: &Shape, p: [Vec3; 3]) -> f64 {
        let [a, b, c] = p;
        let (ab, bc, ca) = (sub(b, a), sub(c, b), sub(a, c));
        let volume = -dot(a, cross(ab, ca));
        if volume <= 0.0 {
            return f64::INFINITY;
        }
        let angle = 2.0 * volume.atan2(1.0 + dot(a, b) + dot(b, c) + dot(c, a));
        let [x, y, z] = shape.cotangents;
        let q = (x * dot(bc, bc) + y * dot(ca, ca) + z * dot(ab, ab)) / (4.0 * shape.area);
        shape.area * self.density(q, angle / shape.area)[0]
    }

    /// One triangle's energy and its gradient by its corners, in space: the caller projects it to the sphere.
    pub(crate) fn gradient(self, shape: &Shape, p: [Vec3; 3]) -> (f64, [Vec3; 3]) {
        let [a, b, c] = p;
        let (ab, bc, ca) = (sub(b, a), sub(c, b), sub(a, c));
        let volume = -dot(a, cross(ab, ca));
        if volume <= 0.0 {
            return (f64::INFINITY, [[0.0; 3]; 3]);
        }
        let rest = 1.0 + dot(a, b) + dot(b, c) + dot(c, a);
        let [x, y, z] = shape.cotangents;
        let q = (x * dot(bc, bc) + y * dot(ca, ca) + z * dot(ab, ab)) / (4.0 * shape.area);
        let [f, fq, fr] = self.density(q, 2.0 * volume.atan2(rest) / shape.area);

        // A dq/da = (z (a - b) + y (a - c)) / 2.
        let half = 0.5 * fq;
        // dW = 2 (rest d(volume) - volume d(rest)) / (volume^2 + rest^2), d(volume)/da = b x c, d(rest)/da = b + c.
        let w = 2.0 * fr / (volume * volume + rest * rest);
        let corner = |normal: Vec3, sum: Vec3, lengths: Vec3| {
            add(scale(lengths, half), scale(sub(scale(normal, rest), scale(sum, volume)), w))
        };
        // b x c = b x (c - b), which keeps the digits of short edges.
        let gradient = [
            corner(cross(b, bc), add(b, c), sub(scale(ca, y), scale(ab, z))),
            corner(cross(c, ca), add(c, a), sub(scale(ab, z), scale(bc, x))),
            corner(cross(a, ab), add(a, b), sub(scale(bc, x), scale(ca, y))),
        ];
        (shape.area * f, gradient)
    }
}

/// Two unit vectors that span the plane across p, chosen by p alone.
pub(crate) fn frame(p: Vec3) -> [Vec3; 2] {
    let least = (0..3).min_by(|&i, &j| p[i].abs().total_cmp(&p[j].abs())).unwrap_or(0);
    let mut axis = [0.0; 3];
    axis[least] = 1.0;
    let u = crate::geometry::unit(cross(p, axis));
    [u, cross(p, u)]
}

/// From p on the sphere along a tangent vector, back onto the sphere.
pub(crate) fn retract(p: Vec3, tangent: Vec3) -> Vec3 {
    crate::geometry::unit(add(p, tangent))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{solid_angle, unit};

    #[test]
    fn gradients_are_those_of_the_values() {
        let corners = [[0.0, 0.0, 0.0], [0.3, 0.05, 0.0], [0.1, 0.25, 0.1]];
        let shape = Shape::new(corners, 0.04);
        let p = [unit([1.0, 0.1, 0.0]), unit([1.0, 0.4, 0.1]), unit([1.0, 0.2, 0.5])];
        assert!(solid_angle(p) > 0.0);
        for energy in [Energy::bounded(1.0, 0.3, 0.1), Energy::CONFORMAL, Energy::STRETCH] {
            let (value, gradient) = energy.gradient(&shape, p);
            assert!((value - energy.value(&shape, p)).abs() < 1e-14 * value);
            for corner in 0..3 {
                // Along the sphere: the solid angle's formula is for unit vectors.
                for tangent in frame(p[corner]) {
                    let at = |h: f64| {
                        let mut moved = p;
                        moved[corner] = retract(p[corner], scale(tangent, h));
                        energy.value(&shape, moved)
                    };
                    let h = 1e-6;
                    let slope = (at(h) - at(-h)) / (2.0 * h);
                    assert!((slope - dot(gradient[corner], tangent)).abs() < 1e-7 * (1.0 + slope.abs()), "{energy:?}");
                }
            }
        }
    }

    #[test]
    fn an_isometry_of_a_small_triangle_costs_least() {
        let size = 1e-3;
        let p = [unit([1.0, 0.0, 0.0]), unit([1.0, size, 0.0]), unit([1.0, 0.3 * size, size])];
        let shape = Shape::new(p, solid_angle(p));
        let energy = Energy::balanced(1.0, 1.0);
        assert!((energy.value(&shape, p) / shape.area - 2.0).abs() < 1e-5);
        assert_eq!(energy.value(&shape, [p[1], p[0], p[2]]), f64::INFINITY);
    }

    #[test]
    fn a_line_still_has_finite_cotangents() {
        let shape = Shape::new([[0.0; 3], [1.0, 0.0, 0.0], [0.4, 1e-14, 0.0]], 1e-6);
        assert!(shape.cotangents.iter().all(|c| c.abs() < 1e4), "{shape:?}");
    }
}
