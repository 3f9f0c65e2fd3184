//! Merges vertices at equal positions, for formats whose files store the same vertex several times.

use std::collections::HashMap;

use super::flaw::Flaw;
use crate::mesh::Mesh;
use crate::room::check_room;

/// Collects the corners of triangles, and assigns the same vertex to corners at equal positions. Vertices are numbered
/// in the order of first appearance.
pub(super) struct Welder {
    numbers: HashMap<[u64; 3], u32>,
    vertices: Vec<[f64; 3]>,
    corners: Vec<u32>,
}

impl Welder {
    /// Returns a welder with room for `triangles` triangles. The caller must have compared this number with the size of
    /// the file.
    pub(super) fn with_capacity(triangles: usize) -> Self {
        Self {
            numbers: HashMap::with_capacity(triangles / 2),
            vertices: Vec::with_capacity(triangles / 2),
            corners: Vec::with_capacity(triangles * 3),
        }
    }

    /// Adds the next corner of a triangle.
    pub(super) fn corner(&mut self, position: [f64; 3]) -> Result<(), Flaw> {
        let number = self.vertex(position)?;
        self.corners.push(number);
        Ok(())
    }

    /// Returns the number of the vertex at a position, which is added if it is new.
    fn vertex(&mut self, position: [f64; 3]) -> Result<u32, Flaw> {
        // Adding 0 turns -0 into +0, so that both give the same key.
        let key = position.map(|x| (x + 0.0).to_bits());
        let next = u32::try_from(self.vertices.len()).map_err(|_| Flaw::new("fewer than 2^32 vertices", "more"))?;
        let number = *self.numbers.entry(key).or_insert(next);
        if number == next {
            self.vertices.push(position);
        }
        Ok(number)
    }

    /// Returns the mesh, in which every three successive corners form a triangle.
    pub(super) fn finish(self) -> Mesh {
        let (faces, _) = self.corners.as_chunks();
        Mesh::new(self.vertices, faces.to_vec())
    }
}

/// Merges the vertices of a mesh that lie at equal positions. The first of several vertices at the same position keeps
/// its place in the order. A mesh without equal positions is unchanged.
///
/// Triangles are kept even if two of their corners become the same vertex, as in the STL reader. Indices must be in
/// range.
pub(super) fn welded(mesh: Mesh) -> Result<Mesh, Flaw> {
    // The 72 bytes per vertex are for a position, its key and its number in the table, and the table's unused entries.
    check_room(mesh.vertices.len() as u64 * 72)?;
    let mut welder = Welder::with_capacity(0);
    let numbers = mesh.vertices.iter().map(|&position| welder.vertex(position)).collect::<Result<Vec<u32>, Flaw>>()?;
    if welder.vertices.len() == mesh.vertices.len() {
        return Ok(mesh);
    }
    let number = |&corner: &u32| {
        let number = numbers.get(corner as usize).copied();
        number.ok_or_else(|| Flaw::new(format!("a vertex number below {}", numbers.len()), corner.to_string()))
    };
    welder.corners = mesh.faces.as_flattened().iter().map(number).collect::<Result<_, _>>()?;
    Ok(welder.finish())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::generate::icosphere;

    #[test]
    fn a_mesh_without_equal_positions_is_unchanged() {
        let mesh = icosphere(2);
        assert_eq!(welded(mesh.clone()).unwrap(), mesh);
    }

    #[test]
    fn a_split_mesh_becomes_whole_in_the_order_of_first_appearance() {
        let mesh = icosphere(1);
        let mut split = mesh.clone();
        split.faces.clear();
        for (i, face) in mesh.faces.iter().enumerate() {
            split.faces.push(if i % 2 == 0 { *face } else { face.map(|v| v + mesh.vertices.len() as u32) });
        }
        split.vertices.extend(mesh.vertices.iter().map(|v| v.map(|x| if x == 0.0 { -x } else { x })));
        let whole = welded(split).unwrap();
        assert_eq!((whole.vertices, whole.faces), (mesh.vertices, mesh.faces));
    }
}
