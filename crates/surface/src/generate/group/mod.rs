//! Generates groups of surfaces with known correspondence: families of shapes with one or two parameters. Each member
//! is meshed separately and gets a random pose, unless [`Group::upright`] is set. Its parameters and its corresponding
//! points ("places") are returned with its mesh.
//!
//! | family | members, lengths in mm | parameters, mm | modes of variation if places correspond |
//! |---|---|---|--:|
//! | [`MovingBump`] | a tapered box of 30 x 18 x 14, with a gentle bump | the bump's position along x, -7 to 7 | |
//! | [`SharpBump`] | a box of 30 x 10 x 10, with a sharp bump | the bump's position along x, -9 to 9 | |
//! | [`GrowingBump`] | the tapered box | the bump's height, 0.5 to 4 | 1 |
//! | [`Ellipsoids`] | ellipsoids of half axes a, b, 8 | a from 17 to 23, b from 10 to 14 | 2 |
//! | [`Rods`] | flattened rods with a knob at one end | the shaft's length, 20 to 50 | 1 |
//! | [`Tori`] | warped rings with one handle | the ring's radius, 17 to 23; the tube's radius, 5 to 7 | 2 |
//!
//! [`MovingBump`]: Family::MovingBump
//! [`SharpBump`]: Family::SharpBump
//! [`GrowingBump`]: Family::GrowingBump
//! [`Ellipsoids`]: Family::Ellipsoids
//! [`Rods`]: Family::Rods
//! [`Tori`]: Family::Tori
//!
//! The members of `SharpBump` at positions t and -t are congruent. A single parameter varies evenly from member to
//! member; two parameters are drawn at random. No rotation maps a member to itself, except half turns of ellipsoids and
//! symmetries of the sharp bump's box. The places of a member are therefore determined by its shape alone, not by its
//! mesh. A mesh is made from a randomly rotated icosphere or, for rings, from a grid of random size and phase, and the
//! order of its vertices and triangles is shuffled. Therefore neither the vertices nor the triangles of two members
//! correspond.

mod boxes;
mod shapes;

use super::icosphere;
use super::random::SplitMix64;
use crate::geometry::{Vec3, add, cross, dot};
use crate::mesh::Mesh;

/// A family of shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Family {
    /// Tapered boxes with a gentle bump whose position varies.
    MovingBump,
    /// Boxes with a sharp bump whose position varies.
    SharpBump,
    /// Tapered boxes with a bump whose height varies.
    GrowingBump,
    /// Ellipsoids with two half axes that vary.
    Ellipsoids,
    /// Rods of varying length with a knob at one end.
    Rods,
    /// Warped rings whose two radii vary.
    Tori,
}

impl Family {
    /// All families.
    pub const ALL: [Self; 6] =
        [Self::MovingBump, Self::SharpBump, Self::GrowingBump, Self::Ellipsoids, Self::Rods, Self::Tori];

    /// Returns the family's name, in lower case with hyphens.
    pub fn name(self) -> &'static str {
        match self {
            Self::MovingBump => "moving-bump",
            Self::SharpBump => "sharp-bump",
            Self::GrowingBump => "growing-bump",
            Self::Ellipsoids => "ellipsoids",
            Self::Rods => "rods",
            Self::Tori => "tori",
        }
    }

    /// Returns the names of the family's parameters.
    pub fn parameters(self) -> &'static [&'static str] {
        match self {
            Self::MovingBump | Self::SharpBump => &["place"],
            Self::GrowingBump => &["height"],
            Self::Ellipsoids => &["a", "b"],
            Self::Rods => &["length"],
            Self::Tori => &["ring", "tube"],
        }
    }

    /// Returns the ranges of the family's parameters, in mm.
    fn ranges(self) -> &'static [[f64; 2]] {
        match self {
            Self::MovingBump => &[[-7.0, 7.0]],
            Self::SharpBump => &[[-9.0, 9.0]],
            Self::GrowingBump => &[[0.5, 4.0]],
            Self::Ellipsoids => &[[17.0, 23.0], [10.0, 14.0]],
            Self::Rods => &[[20.0, 50.0]],
            Self::Tori => &[[17.0, 23.0], [5.0, 7.0]],
        }
    }
}

/// The settings of a group of shapes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Group {
    /// The family of the members.
    pub family: Family,
    /// Number of members.
    pub members: u64,
    /// Seed of the poses, meshes and random parameters.
    pub seed: u64,
    /// Number of subdivisions of the icosphere that a mesh is made from; 5 gives 10,242 vertices. Meshes of rings have
    /// at most as many vertices as this icosphere.
    pub subdivisions: u32,
    /// Whether members are left in the family's own frame, without a random pose.
    pub upright: bool,
}

/// A member of a group, in its pose.
#[derive(Debug, Clone, PartialEq)]
pub struct Member {
    /// The surface, with outward winding.
    pub mesh: Mesh,
    /// Values of the family's parameters.
    pub parameters: Vec<f64>,
    /// The rotation R of the pose `x -> R x + t` from the family's frame, by rows.
    pub rotation: [Vec3; 3],
    /// The translation t of the pose, in mm.
    pub translation: Vec3,
    /// Names of the places (corresponding points), in the same order for all members.
    pub names: Vec<&'static str>,
    /// Positions of the places, in the member's pose.
    pub places: Vec<Vec3>,
}

/// Largest translation of a pose along an axis, in mm.
const SHIFT: f64 = 50.0;
const IDENTITY: [Vec3; 3] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

impl Group {
    /// Returns member `index`. Results are reproducible bit for bit.
    pub fn member(&self, index: u64) -> Member {
        // Each member has its own seed, so that the random sequences of different members don't overlap.
        let mut random = SplitMix64::new(self.seed.wrapping_mul(0x1_0000_0001).wrapping_add(index));
        let ranges = self.family.ranges();
        let parameters: Vec<f64> = ranges
            .iter()
            .map(|&[low, high]| match ranges.len() {
                1 => low + (high - low) * index as f64 / (self.members.max(2) - 1) as f64,
                _ => random.between(low, high),
            })
            .collect();
        let mut mesh = match self.family {
            Family::Tori => shapes::ring(&parameters, self.subdivisions, &mut random),
            _ => {
                let (sphere, turn) = (icosphere(self.subdivisions), rotation(&mut random));
                let on = |u: &Vec3| self.point(&parameters, turn.map(|row| dot(row, *u)));
                sphere.with_vertices(sphere.vertices.iter().map(on).collect())
            }
        };
        shuffle(&mut mesh, &mut random);
        let (names, mut places) = self.places(&parameters).into_iter().unzip::<_, _, Vec<_>, Vec<_>>();
        let (rotation, translation) = if self.upright {
            (IDENTITY, [0.0; 3])
        } else {
            (rotation(&mut random), std::array::from_fn(|_| random.between(-SHIFT, SHIFT)))
        };
        let pose = |x: &mut Vec3| *x = add(rotation.map(|row| dot(row, *x)), translation);
        mesh.vertices.iter_mut().for_each(pose);
        places.iter_mut().for_each(pose);
        Member { mesh, parameters, rotation, translation, names, places }
    }

    /// Returns the point of the shape in direction u, in the family's frame. Points of rings don't correspond to
    /// directions, so rings are meshed by another function.
    fn point(&self, parameters: &[f64], u: Vec3) -> Vec3 {
        match self.family {
            Family::MovingBump => boxes::tapered(u, [parameters[0], 0.0], boxes::HEIGHT),
            Family::GrowingBump => boxes::tapered(u, boxes::PLACE, parameters[0]),
            Family::SharpBump => boxes::sharp(u, parameters[0]),
            Family::Rods => shapes::rod(u, parameters[0]),
            Family::Ellipsoids | Family::Tori => shapes::ellipsoid(parameters, u),
        }
    }

    fn places(&self, parameters: &[f64]) -> Vec<(&'static str, Vec3)> {
        match self.family {
            Family::MovingBump => boxes::places(|u| self.point(parameters, u), [parameters[0], 0.0], boxes::HEIGHT),
            Family::GrowingBump => boxes::places(|u| self.point(parameters, u), boxes::PLACE, parameters[0]),
            Family::SharpBump => boxes::sharp_places(parameters[0]),
            Family::Ellipsoids => shapes::ellipsoid_places(parameters),
            Family::Rods => shapes::rod_places(parameters[0]),
            Family::Tori => shapes::ring_places(parameters),
        }
    }
}

/// Returns a rotation matrix, by rows, drawn uniformly from all rotations.
fn rotation(random: &mut SplitMix64) -> [Vec3; 3] {
    let third = random.direction();
    let first = random.square_to(third);
    [first, cross(third, first), third]
}

/// Shuffles the order of vertices and triangles.
fn shuffle(mesh: &mut Mesh, random: &mut SplitMix64) {
    let mut order = |count: usize| {
        let mut order: Vec<usize> = (0..count).collect();
        for last in (1..count).rev() {
            order.swap(last, (random.between(0.0, (last + 1) as f64) as usize).min(last));
        }
        order
    };
    let (vertices, faces) = (order(mesh.vertices.len()), order(mesh.faces.len()));
    let mut new = vec![0; vertices.len()];
    vertices.iter().zip(0..).for_each(|(&old, now)| new[old] = now);
    mesh.vertices = vertices.iter().map(|&old| mesh.vertices[old]).collect();
    mesh.faces = faces.iter().map(|&old| mesh.faces[old].map(|v| new[v as usize])).collect();
}

#[cfg(test)]
mod tests;
