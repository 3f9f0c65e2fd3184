//! Splits polygons into triangles.

/// Splits a polygon into triangles that share its first corner, and adds them to `faces`.
///
/// The triangles have the polygon's winding, and no vertex is added. If the polygon isn't convex, triangles may
/// overlap, which affects the geometry but not the topology. Returns `false` for fewer than three corners.
pub(super) fn fan(corners: &[u32], faces: &mut Vec<[u32; 3]>) -> bool {
    let [first, second, rest @ ..] = corners else {
        return false;
    };
    if rest.is_empty() {
        return false;
    }
    let mut previous = *second;
    for &corner in rest {
        faces.push([*first, previous, corner]);
        previous = corner;
    }
    true
}
