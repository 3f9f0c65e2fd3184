//! Carries points from one member of a group to another.

use spharm_surface::geometry::{Vec3, add, cross, dot, sub, unit};
use spharm_surface::nearest::TriangleTree;

use super::Group;
use super::together::mesh_of;
use crate::Error;

/// A point that was carried from one member of a group, the source, to another, the target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Carried {
    /// Position on the target, in the target's own frame.
    pub point: Vec3,
    /// Distance of the original point from the surface of the source.
    pub off: f64,
    /// Whether both the source and the target have a counterpart of the template at this point. If either of them lacks
    /// a counterpart, the position is a guess.
    pub reached: bool,
}

impl Group {
    /// Carries points on member `source` to the corresponding positions on member `target`. Each position is in the
    /// frame of the member that it lies on. The source's surface is approximated by the triangles between its
    /// corresponding points. A point's offset from these triangles is kept on the target.
    ///
    /// # Errors
    ///
    /// [`Error::Setting`] if a member doesn't exist, or a point isn't finite.
    pub fn carry(&self, points: &[Vec3], source: usize, target: usize) -> Result<Vec<Carried>, Error> {
        for found in [source, target] {
            if found >= self.places.len() {
                let expected = "the index of a member of the group, counted from 0";
                return Err(Error::Setting { what: "carrying points", expected, found: found.to_string() });
            }
        }
        let faces = &self.template.sphere.faces;
        let tree = TriangleTree::new(&mesh_of(self.places[source].clone(), faces));
        let (to_group, back) = (&self.similarities[source], self.similarities[target].inverse());
        let carried = points.iter().map(|point| {
            let own = to_group.apply(*point);
            let found = tree.nearest(own).ok_or_else(|| Error::Setting {
                what: "carrying points",
                expected: "finite coordinates",
                found: format!("{point:?}"),
            })?;
            let corners = faces[found.triangle as usize].map(|v| v as usize);
            let [here, there] = [source, target].map(|member| corners.map(|v| self.places[member][v]));
            let off = sub(own, found.point);
            let foot = std::array::from_fn(|k| (0..3).map(|i| found.barycentric[i] * there[i][k]).sum());
            let place = add(foot, transported(off, &here, &there));
            let reached = corners.iter().all(|v| self.reached[source][*v] && self.reached[target][*v]);
            Ok(Carried { point: back.apply(place), off: found.distance / to_group.scale, reached })
        });
        carried.collect()
    }
}

/// Transports a vector from one triangle to another. Its components in the triangles' frames (see [`frame`]) stay the
/// same.
fn transported(vector: Vec3, from: &[Vec3; 3], to: &[Vec3; 3]) -> Vec3 {
    let ([a, b, c], to) = (frame(from), frame(to));
    let parts = [a, b, c].map(|axis| dot(axis, vector));
    std::array::from_fn(|k| (0..3).map(|i| parts[i] * to[i][k]).sum())
}

/// Returns a triangle's orthonormal frame: the direction of its first edge, the direction perpendicular to that edge in
/// the triangle's plane, and the normal.
fn frame([a, b, c]: &[Vec3; 3]) -> [Vec3; 3] {
    let along = unit(sub(*b, *a));
    let normal = unit(cross(sub(*b, *a), sub(*c, *a)));
    [along, cross(normal, along), normal]
}
