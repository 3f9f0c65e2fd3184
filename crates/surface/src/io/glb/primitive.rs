//! Converts a primitive to triangles (section 3.7.2 of the glTF specification). The triangles' corners are given by
//! indices or, without indices, by the order of the positions.

use super::super::budget::Budget;
use super::super::flaw::Flaw;
use super::super::polygon::{fan, strip};
use super::accessor::Arrays;
use super::document::Primitive;
use crate::mesh::Mesh;

/// Adds the vertices and triangles of a primitive to a mesh. Points and lines are skipped.
pub(super) fn add(
    arrays: &Arrays<'_>,
    primitive: &Primitive,
    mesh: &mut Mesh,
    budget: &mut Budget,
) -> Result<(), Flaw> {
    let mode = primitive.mode.unwrap_or(4);
    match mode {
        0..=3 => return Ok(()),
        4..=6 => {}
        other => return Err(Flaw::new("a primitive with a mode from 0 to 6", other.to_string())),
    }
    // A primitive without positions is drawn by an extension, or not at all.
    let Some(&position) = primitive.attributes.get("POSITION") else { return Ok(()) };
    let vertices = arrays.positions(position, primitive, budget)?;
    let count = vertices.len();
    let first = mesh.vertices.len();
    if u32::try_from(first + count).is_err() {
        return Err(Flaw::new("fewer than 2^32 vertices", "more"));
    }
    let corners = match primitive.indices {
        Some(indices) => arrays.indices(indices, primitive, budget)?,
        None => (0..count as u32).collect(),
    };
    if let Some(corner) = corners.iter().find(|&&corner| corner as usize >= count) {
        return Err(Flaw::new(
            format!("indices below {count}, the primitive's number of vertices"),
            corner.to_string(),
        ));
    }
    // The checks above ensure that the sums don't overflow.
    let corners: Vec<u32> = corners.iter().map(|corner| corner + first as u32).collect();
    budget.spend(corners.len() as u64 * 12, "triangles of")?;
    mesh.vertices.extend(vertices);
    match mode {
        4 => {
            let (triangles, rest) = corners.as_chunks::<3>();
            if !rest.is_empty() {
                return Err(Flaw::new("three corners per triangle", format!("{} corners in total", corners.len())));
            }
            mesh.faces.extend_from_slice(triangles);
        }
        5 => {
            strip(&corners, &mut mesh.faces);
        }
        _ => {
            fan(&corners, &mut mesh.faces);
        }
    }
    Ok(())
}
