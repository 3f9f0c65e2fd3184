//! Defines the energies that maps minimise.
//!
//! A triangle of the surface with area A (the areas sum to 4 pi) maps to a spherical triangle of solid angle W. Let
//! s1 and s2, with s1 >= s2, be the singular values of the linear map from the flat triangle on the surface to the flat
//! triangle with the same corners as the spherical triangle, and let
//!
//! ```text
//! q = (s1^2 + s2^2) / 2 = sum over corners of cot(angle) |opposite edge on the sphere|^2 / (4 A)
//! r = W / A,                                        about s1 s2 for small triangles
//! ```
//!
//! Each energy is the sum over triangles of A F(q, r), where
//!
//! | energy | F(q, r) | minimal if |
//! |---|---|---|
//! | [`Energy::balanced`] | a (r + 1/r) / 2 + b q / r | areas are equal (a), angles are kept (b) |
//! | [`Energy::bounded`] | F of `balanced` + c (q / r)^3 | also no triangle is much longer than the others (c) |
//! | [`Energy::CONFORMAL`] | q / r | angles are kept (the MIPS of Hormann and Greiner, 2000) |
//! | [`Energy::STRETCH`] | q / r^2 + e q | L2 stretch is least (Sander et al. 2001) |
//!
//! a, b, c and e are the fields `area`, `shape`, `bound` and `shrink` of [`Energy`]. Each energy goes to infinity as a
//! triangle's area on the sphere goes to zero, so a descent from a map without flipped triangles never flips one.
//! Cotangents don't depend on scale, so in a coarsened mesh, a triangle can be assigned a larger area than its own
//! without changing its cotangents.

use crate::density::Density;
use crate::geometry::{Vec3, add, norm, sub};

/// Smallest slack in the triangle inequality, relative to the mean edge length. The edges of thinner triangles are
/// lengthened to reach this slack (N. Sharp and K. Crane, SGP 2020, intrinsic mollification); otherwise the large
/// cotangents of such triangles would dominate the energy.
const SLACK: f64 = 1e-3;

/// The area and the cotangents of a triangle of the surface.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shape {
    /// A, the triangle's target area on the sphere; the areas of all triangles sum to 4 pi.
    pub(crate) area: f64,
    /// Cotangents of the angles at the corners.
    pub(crate) cotangents: [f64; 3],
}

impl Shape {
    pub(crate) fn new([a, b, c]: [Vec3; 3], area: f64) -> Self {
        Self::of_lengths([norm(sub(b, c)), norm(sub(c, a)), norm(sub(a, b))], area)
    }

    /// Computes the cotangents from the lengths of the edges; edge k is opposite corner k.
    pub(crate) fn of_lengths(mut l: [f64; 3], area: f64) -> Self {
        let mean = (l[0] + l[1] + l[2]) / 3.0;
        let slack = l[0] + l[1] + l[2] - 2.0 * l[0].max(l[1]).max(l[2]);
        let missing = (SLACK * mean - slack).max(0.0);
        l.iter_mut().for_each(|length| *length += missing);
        let [x, y, z] = l;
        // Heron's formula in W. Kahan's stable order.
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

/// Smallest area assigned to a triangle, relative to the mean area. A smaller area would have no effect on the map.
const LEAST_AREA: f64 = 1e-7;

/// Returns the smallest area assigned to a triangle in a mesh of `triangles` triangles.
pub(crate) fn least_area(triangles: usize) -> f64 {
    LEAST_AREA * 4.0 * std::f64::consts::PI / triangles as f64
}

/// Sets the target area of each triangle.
pub(crate) fn set_areas(shapes: &mut [Shape], areas: &[f64]) {
    let least = least_area(shapes.len());
    shapes.iter_mut().zip(areas).for_each(|(shape, area)| shape.area = area.max(least));
}

/// An energy, given by its integrand F(q, r).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Energy {
    /// The energy with integrand F(q, r) = a (r + 1/r) / 2 + b q / r + c (q / r)^3; q and r are defined in the
    /// [module](self).
    Balanced {
        /// Coefficient a, the weight of equal areas.
        area: f64,
        /// Coefficient b, the weight of equal angles.
        shape: f64,
        /// Coefficient c, the weight of the bound on lengths.
        bound: f64,
    },
    /// The energy with integrand q / r^2 + `shrink` q.
    Stretch {
        /// Coefficient e, the weight of the term that limits how much parts of the surface are enlarged on the sphere.
        shrink: f64,
    },
}

/// Evaluates an expression with the [`Density`](crate::density::Density) of an energy.
macro_rules! with_density {
    ($energy:expr, $density:ident => $body:expr) => {
        match $energy {
            $crate::energy::Energy::Balanced { area, shape, bound } => {
                let $density = $crate::density::Balanced { area, shape, bound };
                $body
            }
            $crate::energy::Energy::Stretch { shrink } => {
                let $density = $crate::density::Stretch { shrink };
                $body
            }
        }
    };
}
pub(crate) use with_density;

impl Energy {
    pub(crate) const CONFORMAL: Self = Self::balanced(0.0, 1.0);
    pub(crate) const STRETCH: Self = Self::Stretch { shrink: 1e-3 };

    pub(crate) const fn balanced(area: f64, shape: f64) -> Self {
        Self::Balanced { area, shape, bound: 0.0 }
    }

    pub(crate) const fn bounded(area: f64, shape: f64, bound: f64) -> Self {
        Self::Balanced { area, shape, bound }
    }

    /// Returns F(1, 1), the value of F for an isometry.
    pub(crate) fn least(self) -> f64 {
        with_density!(self, density => density.at(1.0, 1.0)[0])
    }
}

/// Returns p + tangent, projected back onto the unit sphere.
pub(crate) fn retract(p: Vec3, tangent: Vec3) -> Vec3 {
    crate::geometry::unit(add(p, tangent))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_still_has_finite_cotangents() {
        let shape = Shape::new([[0.0; 3], [1.0, 0.0, 0.0], [0.4, 1e-14, 0.0]], 1e-6);
        assert!(shape.cotangents.iter().all(|c| c.abs() < 1e4), "{shape:?}");
    }
}
