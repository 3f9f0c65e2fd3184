//! Splits polygons into triangles.

/// Adds the fan of triangles around a polygon's first corner.
///
/// The fan keeps the winding and adds no vertex. For a polygon that isn't convex it may fold over, which affects the
/// geometry but not the topology. Returns `false` for fewer than three corners.
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
