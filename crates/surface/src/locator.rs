//! Finds the triangle of a sphere that a direction meets, and interpolates values within the triangle.
//!
//! A surface over its sphere is a function on the sphere that is known at the sphere's vertices. [`SphereLocator`]
//! evaluates the function in every direction. It finds the triangle with corners a, b, c that the ray along a direction
//! d meets, and the weights w_a, w_b, w_c of the corners at the point of intersection,
//!
//! > w_a : w_b : w_c = det(d, b, c) : det(a, d, c) : det(a, b, d),  w_a + w_b + w_c = 1,
//!
//! which are the point's barycentric coordinates in the flat triangle (a gnomonic projection). If d is a vertex, the
//! weights are exactly 1, 0, 0.
//!
//! # Robustness
//!
//! The signs of the three determinants decide whether d is inside a triangle. They are exact for the given numbers
//! (Shewchuk's adaptive predicate, crate `robust`), so a sphere without flipped triangles has no gaps at edges or
//! vertices. For a direction on an edge, the triangle with the smaller index is returned. Triangles that are flipped or
//! without area are ignored, which does no harm if other triangles cover their part of the sphere. A direction that no
//! triangle covers, as in a hole of the sphere, is assigned to the nearest triangle if the distance to this triangle is
//! at most [`TOLERANCE`]. Otherwise no triangle is found.
//!
//! # Cost
//!
//! A bounding-volume hierarchy (parry3d's) has a box around each *spherical* triangle, and is searched for the boxes
//! that contain the unit vector d. The hierarchy adapts to the triangles' density, however uneven it is. A spherical
//! triangle rises above the plane of its corners by at most 1 - sqrt(1 - e^2 / 3), with e the longest edge of the flat
//! triangle. The box of a spherical triangle is therefore the box of its corners, enlarged by this height.
//!
//! If slivers share a pole, each of them lies in the boxes of nearly all others, and these boxes are enlarged
//! considerably. For spheres made of slivers, such as fans, each flat triangle therefore has a box in its own
//! orientation, and all triangles whose boxes meet the segment from the origin to d are tested (`sliver_tree.rs`).

use ndarray::{Array2, ArrayView2, Axis};
use parry3d_f64::bounding_volume::Aabb;
use parry3d_f64::math::Vector;
use parry3d_f64::partitioning::{Bvh, BvhBuildStrategy};
use rayon::prelude::*;
use spharm_harmonics::Directions;

use crate::error::SurfaceError;
use crate::geometry::{Vec3, bounds, cross, dot, orientation, sub};
use crate::mesh::Mesh;
use crate::sliver_tree::{SliverTree, is_of_slivers};

/// A direction that meets no triangle is treated as covered if its distance from the nearest triangle, in radians, is
/// at most this value.
pub const TOLERANCE: f64 = 1e-9;

/// The point where a direction meets a sphere's triangles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Index of the triangle, counted from 0.
    pub triangle: u32,
    /// Weights of the triangle's corners, in the order of the corners: nonnegative, with sum 1.
    pub barycentric: [f64; 3],
}

/// A search tree over a sphere's triangles.
pub struct SphereLocator {
    tree: Tree,
    /// The corners of each triangle as unit vectors, counter-clockwise seen from outside except in flipped triangles.
    corners: Vec<[Vec3; 3]>,
    /// Whether the sphere's triangles are clockwise seen from outside. If so, corners 1 and 2 are swapped in `corners`.
    inward: bool,
    faces: Vec<[u32; 3]>,
    vertices: usize,
    flipped: usize,
}

/// A tree of bounding boxes of triangles.
enum Tree {
    /// Axis-aligned boxes around the spherical triangles.
    Boxes(Bvh),
    /// Boxes around the flat triangles. Each box is rotated with its triangle.
    Slivers(SliverTree),
}

impl SphereLocator {
    /// Builds the locator of a sphere around the origin, which can have any radius and either winding. Takes O(n log
    /// n) time for n triangles.
    ///
    /// # Errors
    ///
    /// [`Argument`](SurfaceError::Argument) for a mesh without triangles, a vertex at the origin or not finite, or an
    /// index out of range.
    pub fn new(sphere: &Mesh) -> Result<Self, SurfaceError> {
        let wrong = |found: String| SurfaceError::Argument {
            what: "sphere to interpolate over",
            expected: "triangles whose vertices are finite and not at the origin",
            found,
        };
        let directions = Directions::from_vertices(&sphere.vertices).map_err(|error| wrong(error.to_string()))?;
        let vertices = directions.len();
        if sphere.faces.is_empty() {
            return Err(wrong("no triangles".to_owned()));
        }
        if let Some(face) = sphere.faces.iter().position(|f| f.iter().any(|&v| v as usize >= vertices)) {
            return Err(wrong(format!(
                "triangle {face} with vertices {:?} (counted from 0), but the sphere has only {vertices} vertices",
                sphere.faces[face]
            )));
        }
        let corner = |v: u32| directions.as_slice()[v as usize];
        let mut corners: Vec<[Vec3; 3]> = sphere.faces.iter().map(|face| face.map(corner)).collect();
        let positive = |corners: &[[Vec3; 3]]| corners.iter().filter(|c| orientation(**c) > 0.0).count();
        let mut upright = positive(&corners);
        // If the sphere's triangles wind inwards, they are reversed here. `locate` restores the order of the weights.
        let inward = 2 * upright < corners.len();
        if inward {
            corners.iter_mut().for_each(|c| c.swap(1, 2));
            upright = positive(&corners);
        }
        let tree = if is_of_slivers(&corners) {
            Tree::Slivers(SliverTree::new(&corners))
        } else {
            let boxes: Vec<Aabb> = corners.iter().map(spherical_box).collect();
            Tree::Boxes(Bvh::from_leaves(BvhBuildStrategy::Binned, &boxes))
        };
        let flipped = corners.len() - upright;
        Ok(Self { tree, corners, inward, faces: sphere.faces.clone(), vertices, flipped })
    }

    /// Returns the number of triangles that have no area, or whose winding differs from that of the majority. The
    /// number is 0 for a one-to-one parameterisation.
    #[must_use]
    pub fn flipped(&self) -> usize {
        self.flipped
    }

    /// Returns the sphere's number of vertices.
    #[must_use]
    pub fn vertices(&self) -> usize {
        self.vertices
    }

    /// Returns the vertices of the triangle of a [`Place`], in the order of its weights.
    ///
    /// # Panics
    ///
    /// Panics if the place belongs to another sphere.
    #[must_use]
    pub fn corners(&self, place: &Place) -> [u32; 3] {
        self.faces[place.triangle as usize]
    }

    /// Returns the triangle that the ray along a unit vector meets, and the weights of the corners at the intersection.
    /// Returns `None` if no triangle is met.
    #[must_use]
    pub fn locate(&self, direction: [f64; 3]) -> Option<Place> {
        let mut inside: Option<u32> = None;
        self.each_near(direction, 0.0, |t| {
            if inside.is_none_or(|least| t < least) && contains(&self.corners[t as usize], direction) {
                inside = Some(t);
            }
        });
        let triangle = inside.or_else(|| self.nearest(direction))?;
        let mut barycentric = weights(&self.corners[triangle as usize], direction)?;
        if self.inward {
            barycentric.swap(1, 2);
        }
        Some(Place { triangle, barycentric })
    }

    /// Locates many unit vectors in parallel, as [`locate`](Self::locate) does for one.
    ///
    /// # Errors
    ///
    /// [`NotCovered`](SurfaceError::NotCovered) if some directions meet no triangle. The error gives their number.
    pub fn locate_all(&self, directions: &[[f64; 3]]) -> Result<Vec<Place>, SurfaceError> {
        let found: Vec<Option<Place>> = directions.par_iter().with_min_len(256).map(|&d| self.locate(d)).collect();
        let missed = found.iter().filter(|place| place.is_none()).count();
        if missed == 0 {
            return Ok(found.into_iter().flatten().collect());
        }
        let first = found.iter().position(Option::is_none).unwrap_or_default();
        Err(SurfaceError::NotCovered { missed, directions: directions.len(), first, flipped: self.flipped })
    }

    /// Interpolates values at the sphere's vertices, an (n, c) array with c values for each of the n vertices, to m
    /// unit vectors. Returns an (m, c) array.
    ///
    /// # Errors
    ///
    /// The errors of [`locate_all`](Self::locate_all); [`LengthMismatch`](SurfaceError::LengthMismatch) if `values`
    /// doesn't have a row for each vertex.
    pub fn interpolate(
        &self,
        values: ArrayView2<'_, f64>,
        directions: &[[f64; 3]],
    ) -> Result<Array2<f64>, SurfaceError> {
        if values.nrows() != self.vertices {
            return Err(SurfaceError::LengthMismatch {
                what: "values at the sphere's vertices",
                expected: self.vertices,
                found: values.nrows(),
            });
        }
        let places = self.locate_all(directions)?;
        let mut result = Array2::zeros((places.len(), values.ncols()));
        result.axis_iter_mut(Axis(0)).into_par_iter().zip(&places).with_min_len(256).for_each(|(mut row, place)| {
            for (vertex, weight) in self.corners(place).into_iter().zip(place.barycentric) {
                // Corners of weight 0 are skipped, since 0 times an infinite or NaN value is NaN.
                if weight != 0.0 {
                    row.scaled_add(weight, &values.row(vertex as usize));
                }
            }
        });
        Ok(result)
    }

    /// Calls `visit` for all triangles that a direction meets or that are within `slack` of it, and possibly for
    /// others.
    fn each_near(&self, direction: Vec3, slack: f64, mut visit: impl FnMut(u32)) {
        match &self.tree {
            Tree::Boxes(tree) => {
                let point = Vector::from(direction);
                let (low, high) = (point - slack, point + slack);
                let leaves = tree.leaves(move |node| node.mins().cmple(high).all() && node.maxs().cmpge(low).all());
                leaves.for_each(visit);
            }
            Tree::Slivers(tree) => tree.along(direction, slack, &mut visit),
        }
    }

    /// Returns the triangle nearest to a direction that meets no triangle; `None` if this triangle is farther away than
    /// [`TOLERANCE`].
    fn nearest(&self, direction: Vec3) -> Option<u32> {
        let outside = |t: u32| {
            let [a, b, c] = self.corners[t as usize];
            // Sine of the angle by which the direction lies outside of the plane through the edge u v and the origin.
            let beyond = |u: Vec3, v: Vec3| {
                let normal = cross(u, v);
                -dot(normal, direction) / dot(normal, normal).sqrt()
            };
            let most = beyond(a, b).max(beyond(b, c)).max(beyond(c, a));
            (orientation([a, b, c]) > 0.0 && most <= TOLERANCE).then_some((most, t))
        };
        let mut near: Option<(f64, u32)> = None;
        self.each_near(direction, TOLERANCE, |t| {
            let found = outside(t);
            let is_nearer = |&(most, t): &(f64, u32)| {
                near.is_none_or(|(least, other)| most.total_cmp(&least).then(t.cmp(&other)).is_lt())
            };
            near = found.filter(is_nearer).or(near);
        });
        near.map(|(_, t)| t)
    }
}

fn contains(corners: &[Vec3; 3], d: Vec3) -> bool {
    let [a, b, c] = *corners;
    orientation([a, b, d]) >= 0.0
        && orientation([b, c, d]) >= 0.0
        && orientation([c, a, d]) >= 0.0
        && orientation(*corners) > 0.0
}

/// Returns the weights of a triangle's corners at the point where the ray along d meets the triangle's plane; `None`
/// for a triangle without area.
fn weights([a, b, c]: &[Vec3; 3], d: Vec3) -> Option<[f64; 3]> {
    let [a, b, c] = [a, b, c].map(|&corner| sub(corner, d));
    // Computed relative to d, the determinants are exactly 0 if d is a corner, and keep their digits in small
    // triangles. d is known to be inside, so determinants that are negative by rounding are set to 0.
    let sizes = [(b, c), (c, a), (a, b)].map(|(u, v)| dot(cross(u, v), d).max(0.0));
    let sum: f64 = sizes.iter().sum();
    (sum > 0.0).then(|| sizes.map(|size| size / sum))
}

/// Returns a box around a spherical triangle.
fn spherical_box(corners: &[Vec3; 3]) -> Aabb {
    let [a, b, c] = *corners;
    let square = |u: Vec3, v: Vec3| dot(sub(u, v), sub(u, v));
    let longest = square(a, b).max(square(b, c)).max(square(c, a));
    // A point p of the flat triangle with corners v_i, weights w_i and longest edge e satisfies |p|^2 = 1 - sum w_i w_j
    // |v_i - v_j|^2 >= 1 - e^2 / 3, with the sum over the three pairs i < j. 1e-15 is added for rounding.
    let bulge = 1.0 - (1.0 - longest / 3.0).max(0.0).sqrt() + 1e-15;
    let (low, high) = bounds(corners.iter().copied());
    Aabb::new(Vector::from(low.map(|x| x - bulge)), Vector::from(high.map(|x| x + bulge)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::{SplitMix64, bipyramid};
    use crate::geometry::{add, unit};

    /// Returns a double pyramid that isn't aligned with the axes.
    fn fan(sides: u32) -> Mesh {
        let turned = |[x, y, z]: Vec3| unit([0.8 * x + 0.6 * z, y, 0.8 * z - 0.6 * x]);
        let mesh = bipyramid(sides);
        mesh.with_vertices(mesh.vertices.iter().map(|&place| turned(place)).collect())
    }

    #[test]
    fn few_triangles_of_a_fan_are_looked_at_however_many_there_are_and_the_right_one_is_found() {
        let mut looked_at = Vec::new();
        for sides in [500, 16_000] {
            let sphere = fan(sides);
            let locator = SphereLocator::new(&sphere).unwrap();
            assert!(matches!(locator.tree, Tree::Slivers(_)));
            let mut random = SplitMix64::new(7);
            let (mut count, points) = (0_usize, 1000_usize);
            for k in 0..points {
                // The directions tested are vertices of the rim, points on edges of the rim and on other edges, and
                // random directions.
                let [a, b, c] = locator.corners[k * 29 % sides as usize];
                let direction = match k % 10 {
                    0 => a,
                    1 => unit(add(a, b)),
                    2 => unit(add(a, c)),
                    _ => unit([(); 3].map(|()| random.between(-1.0, 1.0))),
                };
                locator.each_near(direction, 0.0, |_| count += 1);
                let place = locator.locate(direction).unwrap();
                if k < 100 {
                    let all =
                        (0..locator.corners.len() as u32).find(|&t| contains(&locator.corners[t as usize], direction));
                    assert!(all.is_none_or(|first| first == place.triangle), "{direction:?} {place:?} {all:?}");
                }
            }
            looked_at.push(count as f64 / points as f64);
        }
        assert!(looked_at[1] < 20.0 && looked_at[1] < 1.5 * looked_at[0], "{looked_at:?}");
    }
}
