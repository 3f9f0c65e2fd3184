//! Converts an IndexedFaceSet to triangles (section 6.23 of the VRML standard). Its points are in a Coordinate node.
//! Its polygons are lists of point indices, each terminated by -1.

use super::super::flaw::Flaw;
use super::super::polygon::Triangles;
use crate::mesh::Mesh;

/// The fields of an IndexedFaceSet.
pub(super) struct FaceSet {
    /// Index of the first point among the mesh's vertices, and number of points.
    pub(super) points: Option<(usize, usize)>,
    pub(super) indices: Vec<i64>,
    /// Whether polygons are counterclockwise when seen from outside.
    pub(super) ccw: bool,
}

impl FaceSet {
    pub(super) fn new() -> Self {
        Self { points: None, indices: Vec::new(), ccw: true }
    }

    /// Adds the set's triangles to a mesh. A set without points has no triangles.
    pub(super) fn add_to(self, mesh: &mut Mesh) -> Result<(), Flaw> {
        let Some((first, count)) = self.points else { return Ok(()) };
        let mut faces = Triangles::default();
        let mut corners = Vec::new();
        // The -1 that ends the last polygon may be missing.
        for &index in self.indices.iter().chain([&-1]) {
            let corner = usize::try_from(index).ok().filter(|&index| index < count);
            match corner.and_then(|corner| u32::try_from(first + corner).ok()) {
                Some(corner) => corners.push(corner),
                None if index == -1 => {
                    if !corners.is_empty() && !faces.polygon(&corners) {
                        return Err(Flaw::new("polygons of at least three corners", corners.len().to_string()));
                    }
                    corners.clear();
                }
                None => {
                    return Err(Flaw::new(
                        format!("indices below {count}, the set's number of points, or -1"),
                        index.to_string(),
                    ));
                }
            }
        }
        let mut faces = faces.cut(&mesh.vertices);
        if !self.ccw {
            faces.iter_mut().for_each(|face| face.swap(1, 2));
        }
        mesh.faces.extend(faces);
        Ok(())
    }
}
