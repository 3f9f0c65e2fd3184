//! Computes the elastic energy of a map phi of a triangulated sphere to itself, which is the cost of stretching the
//! sphere, and the energy's gradient.
//!
//! ```text
//! E(phi) = sum_T share_T (1 + e^s) / 2 psi(s),    s = log(a_T(phi) / a_T)
//! psi(s) = s^2 + BARRIER max(|s| - FREE, 0)^2
//! ```
//!
//! The sum is over the triangles T. share_T is the triangle's fraction of the sphere's area. a_T is six times the
//! volume between the triangle and the origin before the map, and a_T(phi) the same after the map. This volume is
//! positive if and only if the triangle is counter-clockwise seen from outside, so the logarithm becomes infinite
//! before a triangle is inverted. The square of the logarithm gives shrinking and stretching equal weight; beyond a
//! factor of `exp(FREE)` a barrier is added. The energy is the mean of two energies, weighted by the triangles' areas
//! before and after the map. If it were weighted by the areas before the map alone, a few triangles could stretch over
//! a whole anatomical process of a member at almost no cost, and the member's model would lose the process.
//!
//! Cost: about 60 flops per triangle.

use spharm_surface::geometry::{Vec3, add, cross, dot, face_normal, scale};

/// Absolute logarithm of a triangle's change of area above which a barrier is added to the triangle's energy.
const FREE: f64 = 1.386;
/// Factor of the barrier in psi; see the [module](self).
const BARRIER: f64 = 20.0;

/// Triangles of the sphere, with their areas before the map.
pub(super) struct Elastic<'a> {
    faces: &'a [[u32; 3]],
    /// Value of a_T for each triangle on the undeformed sphere.
    rest: Vec<f64>,
    /// Fraction of the sphere's area in each triangle.
    shares: Vec<f64>,
}

impl<'a> Elastic<'a> {
    /// Prepares the triangles, which must be counter-clockwise seen from outside.
    pub(super) fn new(faces: &'a [[u32; 3]], at: &[Vec3]) -> Self {
        let rest: Vec<f64> = faces.iter().map(|face| volume(*face, at)).collect();
        let total: f64 = rest.iter().sum();
        let shares = rest.iter().map(|volume| volume / total).collect();
        Self { faces, rest, shares }
    }

    /// Returns the energy; infinity if a triangle is inverted.
    pub(super) fn energy(&self, at: &[Vec3]) -> f64 {
        let terms = self.logarithms(at).zip(&self.shares).map(|(s, share)| share * density(s).0);
        terms.sum()
    }

    /// Adds `weight` times the energy's gradient with respect to the directions `at` to the covectors.
    pub(super) fn add_gradient(&self, at: &[Vec3], weight: f64, covectors: &mut [Vec3]) {
        for ((face, s), share) in self.faces.iter().zip(self.logarithms(at)).zip(&self.shares) {
            let [a, b, c] = face.map(|v| at[v as usize]);
            let factor = weight * share * density(s).1 / volume(*face, at);
            for (v, (p, q)) in face.iter().zip([(b, c), (c, a), (a, b)]) {
                let g = &mut covectors[*v as usize];
                *g = add(*g, scale(cross(p, q), factor));
            }
        }
    }

    /// Returns the logarithm of the change of area, log(a_T(phi) / a_T), of each triangle; infinity for an inverted
    /// triangle.
    pub(super) fn logarithms(&self, at: &[Vec3]) -> impl Iterator<Item = f64> {
        self.faces.iter().zip(&self.rest).map(|(face, rest)| {
            let ratio = volume(*face, at) / rest;
            if ratio > 0.0 { ratio.ln() } else { f64::INFINITY }
        })
    }

    /// Returns pairs of neighbouring vertices; an edge shared by two triangles occurs twice.
    pub(super) fn edges(&self) -> impl Iterator<Item = [u32; 2]> + '_ {
        self.faces.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
    }

    /// Returns the fraction of the sphere's area in each triangle.
    pub(super) fn shares(&self) -> &[f64] {
        &self.shares
    }
}

/// Returns the energy per unit of area before the map, and its derivative with respect to s, the logarithm of the
/// change of area.
fn density(s: f64) -> (f64, f64) {
    let (over, stretched) = ((s.abs() - FREE).max(0.0), s.exp());
    let (value, slope) = (s * s + BARRIER * over * over, 2.0 * (s + BARRIER * over.copysign(s)));
    let half = 0.5 * (1.0 + stretched);
    (half * value, half * slope + 0.5 * stretched * value)
}

/// Returns six times the volume between a triangle and the origin, computed from its edges to avoid cancellation for
/// small triangles.
fn volume(face: [u32; 3], at: &[Vec3]) -> f64 {
    let corners = face.map(|v| at[v as usize]);
    dot(corners[0], face_normal(corners))
}
