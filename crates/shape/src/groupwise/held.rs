//! Computes the energy that holds given points fixed during a refinement, such as landmarks that a registration has
//! moved to the same direction in all members.
//!
//! ```text
//! H(phi) = weight sum_p |phi(p) - p|^2
//! ```
//!
//! The sum is over the fixed points p, each within a triangle of the sphere; phi is linear in each triangle.

use spharm_surface::Place;
use spharm_surface::geometry::{Vec3, add, dot, scale, sub};

/// Points to hold fixed, with their positions on the sphere before the map.
pub(super) struct Held {
    places: Vec<(Place, Vec3)>,
    weight: f64,
}

impl Held {
    pub(super) fn new(places: &[Place], directions: &[Vec3], weight: f64) -> Self {
        Self { places: places.iter().map(|place| (*place, place.of(directions))).collect(), weight }
    }

    /// Returns the energy H.
    pub(super) fn energy(&self, at: &[Vec3]) -> f64 {
        let square = |(place, rest): &(Place, Vec3)| {
            let off = sub(place.of(at), *rest);
            dot(off, off)
        };
        self.weight * self.places.iter().map(square).sum::<f64>()
    }

    /// Adds the gradient of the energy H to the covectors.
    pub(super) fn add_gradient(&self, at: &[Vec3], covectors: &mut [Vec3]) {
        for (place, rest) in &self.places {
            let slope = scale(sub(place.of(at), *rest), 2.0 * self.weight);
            for (v, share) in place.corners.iter().zip(place.shares) {
                let g = &mut covectors[*v as usize];
                *g = add(*g, scale(slope, share));
            }
        }
    }
}
