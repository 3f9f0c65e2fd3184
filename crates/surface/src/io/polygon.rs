//! Polygons into triangles.

/// Adds the fan of triangles around the polygon's first corner.
///
/// It keeps the winding and adds no vertex; of a polygon that isn't convex it may fold over, which is the geometry's
/// loss and leaves the topology right. Fewer than three corners are no polygon: `false`.
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
