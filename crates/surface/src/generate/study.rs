//! Generates the surfaces for a study: subjects in two groups, which differ by a bump of known position and height.
//!
//! A subject is an elongated body, about 40 mm long. Before the body is stretched, its radius in direction u is `r(u) =
//! 1 + sum a_k cos(k . u + p_k)`, with wave vectors k, amplitudes a_k and phases p_k that differ from subject to
//! subject. The body is stretched along its axes, bent, and moved by a random rotation and translation. In the second
//! group, the surface is moved outwards by `bump exp(-angle^2 / (2 width^2))`, with `angle` the angle between u and the
//! bump's fixed direction. The triangles are those of an icosphere and don't depend on the pose. No sphere is returned.

use super::icosphere;
use super::random::SplitMix64;
use crate::geometry::{Vec3, add, dot, scale};
use crate::mesh::Mesh;

/// Parameters of a study.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Study {
    /// Number of subdivisions of the icosahedron, see [`icosphere`]; 4 gives 2,562 vertices.
    pub subdivisions: u32,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Height of the second group's bump, in mm.
    pub bump: f64,
}

impl Default for Study {
    fn default() -> Self {
        Self { subdivisions: 4, seed: 0, bump: 2.0 }
    }
}

/// Half axes of the body, in mm. All three differ, so that the pose is unique.
const AXES: Vec3 = [20.0, 11.0, 8.0];
/// Amplitude of the waves that distinguish subjects, relative to the radius.
const VARIATION: f64 = 0.012;
/// Number of waves per subject.
const WAVES: usize = 12;
/// Displacement of the body's ends by bending, in mm.
const BEND: f64 = 5.0;
/// Width of the bump, as an angle on the sphere in radians.
const WIDTH: f64 = 0.35;
/// Direction of the bump's centre on the sphere.
const PLACE: Vec3 = [0.48, 0.64, 0.6];
/// Largest translation of a pose along an axis, in mm.
const SHIFT: f64 = 50.0;

impl Study {
    /// Returns subject `index` of the first group, or of the second group if `second` is true, wound outwards. Results
    /// are reproducible bit for bit.
    pub fn subject(&self, index: u64, second: bool) -> Mesh {
        let sphere = icosphere(self.subdivisions);
        // Each subject has its own seed, so that the random sequences of different subjects don't overlap.
        let mut random =
            SplitMix64::new(self.seed.wrapping_mul(0x1_0000_0001).wrapping_add(2 * index + u64::from(second)));
        let waves: Vec<(Vec3, f64, f64)> = (0..WAVES)
            .map(|_| {
                let length = random.between(0.5, 3.0);
                let k = scale(random.direction(), length);
                (k, random.between(0.0, std::f64::consts::TAU), random.between(-1.0, 1.0))
            })
            .collect();
        let rotation = rotation(&mut random);
        let shift: Vec3 = std::array::from_fn(|_| random.between(-SHIFT, SHIFT));
        let height = if second { self.bump } else { 0.0 };
        let vertices = sphere.vertices.iter().map(|&u| {
            let wave: f64 = waves.iter().map(|(k, phase, size)| size * (dot(*k, u) + phase).cos()).sum();
            let radius = 1.0 + VARIATION * wave;
            let mut x: Vec3 = std::array::from_fn(|i| AXES[i] * radius * u[i]);
            let angle = dot(PLACE, u).clamp(-1.0, 1.0).acos();
            let outwards: Vec3 = std::array::from_fn(|i| u[i] / AXES[i]);
            let length = dot(outwards, outwards).sqrt();
            x = add(x, scale(outwards, height * (-angle * angle / (2.0 * WIDTH * WIDTH)).exp() / length));
            let along = x[0] / AXES[0];
            x[2] += BEND * along * along;
            add(std::array::from_fn(|i| dot(rotation[i], x)), shift)
        });
        Mesh::new(vertices.collect(), sphere.faces.clone())
    }
}

/// Returns a rotation matrix, by rows, drawn uniformly from all rotations.
fn rotation(random: &mut SplitMix64) -> [Vec3; 3] {
    let third = random.direction();
    let first = random.square_to(third);
    [first, crate::geometry::cross(third, first), third]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume(mesh: &Mesh) -> f64 {
        let corner = |face: &[u32; 3], k: usize| mesh.vertices[face[k] as usize];
        let sixth = |face: &[u32; 3]| dot(corner(face, 0), crate::geometry::cross(corner(face, 1), corner(face, 2)));
        mesh.faces.iter().map(sixth).sum::<f64>() / 6.0
    }

    #[test]
    fn groups_differ_by_the_bump_and_subjects_by_their_waves() {
        let study = Study::default();
        let (first, second) = (study.subject(0, false), study.subject(0, true));
        assert_eq!(first.vertices, study.subject(0, false).vertices);
        assert_ne!(first.vertices, study.subject(1, false).vertices);
        assert_ne!(first.vertices, second.vertices);
        // The volume is positive, so the winding is outward. It is close to the ellipsoid's volume of 4/3 pi a b c.
        let body = 4.0 / 3.0 * std::f64::consts::PI * AXES.iter().product::<f64>();
        assert!((volume(&first) / body - 1.0).abs() < 0.2, "{}", volume(&first) / body);
        let mean = |second: bool| (0..20).map(|i| volume(&study.subject(i, second))).sum::<f64>() / 20.0;
        assert!(mean(true) > mean(false));
    }
}
