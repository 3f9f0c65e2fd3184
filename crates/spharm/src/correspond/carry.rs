//! Points carried from one member of a group to another.

use spharm_surface::geometry::Vec3;
use spharm_surface::nearest::TriangleTree;

use super::Group;
use super::together::mesh_of;
use crate::Error;

/// A point that was carried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Carried {
    /// Its place on the target, in the target's own frame.
    pub point: Vec3,
    /// How far the point was from the source's surface.
    pub off: f64,
    /// Whether the place has counterparts on both; else it is a guess.
    pub reached: bool,
}

impl Group {
    /// Carries points on member `source`, in its own frame, to the same places of member `target`, in its own.
    ///
    /// # Errors
    ///
    /// [`Error::Setting`] for a member that isn't there, or a point that isn't finite.
    pub fn carry(&self, points: &[Vec3], source: usize, target: usize) -> Result<Vec<Carried>, Error> {
        for found in [source, target] {
            if found >= self.places.len() {
                let expected = "one of the group's members, counted from 0";
                return Err(Error::Setting { what: "carrying points", expected, found: found.to_string() });
            }
        }
        let faces = &self.template.sphere.faces;
        let tree = TriangleTree::new(&mesh_of(self.places[source].clone(), faces));
        let (there, back) = (&self.similarities[source], self.similarities[target].inverse());
        let carried = points.iter().map(|point| {
            let found = tree.nearest(there.apply(*point)).ok_or_else(|| Error::Setting {
                what: "carrying points",
                expected: "finite coordinates",
                found: format!("{point:?}"),
            })?;
            let corners = faces[found.triangle as usize].map(|v| v as usize);
            let place = std::array::from_fn(|k| {
                (0..3).map(|i| found.barycentric[i] * self.places[target][corners[i]][k]).sum()
            });
            let reached = corners.iter().all(|v| self.reached[source][*v] && self.reached[target][*v]);
            Ok(Carried { point: back.apply(place), off: found.distance / there.scale, reached })
        });
        carried.collect()
    }
}
